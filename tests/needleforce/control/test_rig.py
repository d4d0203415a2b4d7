"""The arm in closed loop: its physics, contacts, latency, sensors and faults."""

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth import (
    PLANT_MODELS,
    HandOnArm,
    PlantError,
    PlantModelError,
    PointMotion,
    SimulatedArm,
    TICK_s,
    Tissue,
    Trocar,
    Wall,
    sensors,
)
from groundtruth.arm_plant import ArmPlant, TissueContact, lwr_bodies
from needleforce.control import ToolState
from tests.residual.residual_signals import jacobian_of
from urdf import NeedleTool

IDEAL, CLEAN, FRI, DEGRADED = PLANT_MODELS.values()
DOWN = np.array([0.0, 0.0, -1.0])
REST = np.zeros(7)


def run(rig, seconds, velocity=lambda t_s, rig: REST):
    """Samples of some time, each answered by a joint velocity."""
    samples = []
    for sample in rig:
        samples.append(sample)
        if rig.time_s >= seconds:
            break
        rig.send(velocity(rig.time_s, rig))

    return samples


def down(speed_m_s):
    """Commands that move the tip down, by the Jacobian at home."""
    rig = SimulatedArm(plant=IDEAL)
    inverse = np.linalg.pinv(jacobian_of(rig.robot, rig.home_rad, "needle_tip"))
    return lambda t_s, rig: inverse[:, :3] @ (speed_m_s * DOWN)


@cache
def arm_after_push(servo, at=None, push_N=(0.0, 0.0, 0.0)):
    """Return an arm after 0.4 s, in which a hand has pushed it unless it is free."""
    contacts = () if at is None else [HandOnArm(at=at, force_N=lambda t_s: push_N)]
    rig = SimulatedArm(plant=IDEAL, servo=servo, contacts=contacts)
    run(rig, 0.4)
    return rig


@pytest.mark.parametrize("servo", ["stiff", "impedance"])
@pytest.mark.parametrize(("at", "joint"), [("hub", 7), ("wrist", 6), ("elbow", 4)])
def test_a_hand_loads_joints_by_its_jacobian(servo, at, joint):
    """A hand loads the joints by its Jacobian, and not the F/T sensor."""
    push_N = (8.0, -4.0, 3.0)
    free = arm_after_push(servo)
    held = arm_after_push(servo, at, push_N)
    truth = held.truth
    robot = held.robot
    frame = robot.flange_frame if at == "hub" else robot.model.names[joint]
    gravity = pin.rnea(robot.model, robot.create_data(), truth.q_rad, REST, REST)
    expected = gravity - jacobian_of(robot, truth.q_rad, frame)[:3].T @ push_N

    np.testing.assert_allclose(truth.tau_Nm, expected, atol=2e-3)
    np.testing.assert_allclose(held.ft_wrench, free.ft_wrench, atol=0.02)


def test_a_tip_force_bends_the_arm_as_expected():
    """A tip force reaches joints and F/T sensor, and bends the arm by its servo."""
    push_N = (2.0, 1.0, -3.0)
    free = arm_after_push("stiff")
    held = arm_after_push("stiff", "tip", push_N)
    truth = held.truth
    measured_N = truth.rotation @ (held.ft_wrench - free.ft_wrench)[:3]
    rows = jacobian_of(held.robot, truth.q_rad, "needle_tip")[:3]
    mass = pin.crba(held.robot.model, held.robot.create_data(), truth.q_rad)
    bent_m = rows @ np.linalg.solve(200.0**2 * mass, rows.T) @ push_N

    np.testing.assert_allclose(measured_N, push_N, atol=0.02)
    np.testing.assert_allclose(truth.tip_m - free.truth.tip_m, bent_m, atol=2e-6)


WALL_N_per_m = 20e3
TROCAR_N_per_m = 1000.0


def test_elastic_contacts_conserve_energy():
    """Of an arm without motors, whose needle meets a wall and a trocar."""
    wall = Wall(distance_m=2e-3, damping_Ns_per_m=0.0)
    trocar = Trocar(behind_tip_m=0.05, damping_Ns_per_m=0.0)
    bodies = lwr_bodies(NeedleTool(), IDEAL, np.random.default_rng(0))
    air = TissueContact(
        law=Tissue(()), surface_in_base_m=np.zeros(3), axis_in_base=DOWN
    )
    plant = ArmPlant(bodies, air, touching=[wall, trocar])
    rig = SimulatedArm(plant=IDEAL)
    towards = np.linalg.pinv(jacobian_of(rig.robot, rig.home_rad, "needle_tip"))
    plant.place(rig.home_rad, towards[:, :3] @ (0.1 * DOWN))
    model = bodies.model()
    data = model.createData()
    start_m = plant.tip_m.copy()
    axis = plant.tip_axes[:, 2].copy()
    walls_J = []
    energies_J = []
    for _ in range(100):
        energy_J = pin.computeKineticEnergy(model, data, plant.q_rad, plant.dq_rad_s)
        energy_J += pin.computePotentialEnergy(model, data, plant.q_rad)
        pressed_m = max((plant.tip_m - start_m) @ axis - wall.distance_m, 0.0)
        walls_J.append(0.5 * WALL_N_per_m * pressed_m**2)
        aside_m = np.cross(trocar.point_m - plant.tip_m, plant.tip_axes[:, 2])
        energy_J += walls_J[-1] + 0.5 * TROCAR_N_per_m * aside_m @ aside_m
        energies_J.append(energy_J)
        plant.tick(np.zeros(7))

    assert max(walls_J) > 0.05
    assert np.ptp(energies_J) < 0.01 * max(walls_J)


POINT = st.floats(-0.1, 0.1)


@given(st.tuples(POINT, POINT, POINT), st.floats(-1.0, 1.0))
def test_a_trocar_pulls_across_the_needle_only(offset_m, along_m_s):
    trocar = Trocar(behind_tip_m=0.03)
    axis = np.array([0.0, 0.6, -0.8])
    trocar.begin(PointMotion((0.1, 0.2, 0.3), axis, (0, 0, 0), (0, 0, 0)))
    tip_m = np.add((0.1, 0.2, 0.3), offset_m)
    sliding = PointMotion(tip_m, axis, along_m_s * axis, (0, 0, 0))
    force_N, place_m = trocar.force(0.0, sliding)
    away_m = trocar.point_m - tip_m
    across_m = away_m - (away_m @ axis) * axis

    np.testing.assert_allclose(force_N, 1000.0 * across_m, atol=1e-9)
    np.testing.assert_allclose(place_m, trocar.point_m - across_m, atol=1e-12)


@given(st.floats(-0.01, 0.01), st.floats(-2.0, 2.0))
def test_a_wall_never_pulls(beyond_m, speed_m_s):
    wall = Wall(distance_m=0.02)
    wall.begin(PointMotion((0, 0, 0.5), (0, 0, -1), (0, 0, 0), (0, 0, 0)))
    motion = PointMotion(
        (0, 0, 0.48 - beyond_m), (0, 0, -1), (0, 0, -speed_m_s), (0, 0, 0)
    )
    push = wall.force(0.0, motion)[0][2]

    assert push >= 0.0

    if beyond_m > 1e-9:
        assert push == pytest.approx(
            max(20e3 * beyond_m + 50.0 * speed_m_s, 0.0), abs=1e-6
        )


def test_a_hand_leads_along_its_path():
    hand = HandOnArm(
        at="hub", path_m=lambda t_s: (0.01 * t_s, 0, 0), stiffness_N_per_m=400.0
    )
    hand.begin(PointMotion((1, 2, 3), (0, 0, 1), (0, 0, 0), (0, 0, 0)))
    motion = PointMotion((1, 2, 3), (0, 0, 1), (0.1, 0, 0), (0, 0, 0))
    force_N, place_m = hand.force(2.0, motion)

    assert place_m == (1, 2, 3)
    assert force_N == pytest.approx((400.0 * 0.02 - 8.0 * 0.1, 0.0, 0.0))


def test_a_command_acts_after_the_latency():
    step = np.array([0.0, 0.02, 0.0, 0.0, 0.0, 0.03, 0.0])
    q_rad = {}
    for ticks in (1, 6):
        rig = SimulatedArm(plant=IDEAL, latency_s=ticks * TICK_s)
        q_rad[ticks] = np.array([s.q_rad for s in run(rig, 0.1, lambda t_s, rig: step)])

    np.testing.assert_allclose(q_rad[1][:-5], q_rad[6][5:], atol=1e-9)

    moved = np.abs(q_rad[6] - q_rad[6][0]).max(axis=1)

    assert moved[6] < 1e-12 < 1e-7 < moved[8]


def test_without_commands_the_arm_brakes_at_once():
    rig = SimulatedArm(plant=IDEAL, servo="impedance")
    run(rig, 0.3, down(0.02))
    start = rig.truth.tip_m
    rig.lose("command", 1.0)
    run(rig, 0.6, down(0.02))

    assert np.abs(rig.truth.dq_rad_s).max() < 1e-3
    assert 0.05e-3 < np.linalg.norm(rig.truth.tip_m - start) < 0.5e-3


def test_the_arm_refuses_commands_as_asked():
    """The arm refuses commands that are not finite, and those it is told to refuse."""
    rig = SimulatedArm(plant=IDEAL)
    next(rig)

    assert not rig.send(np.full(7, np.nan))
    assert rig.send(REST)

    rig.refuse_commands(0.003)
    answers = [rig.send(REST) for _, sample in zip(range(5), rig, strict=False)]

    assert answers == [False] * 3 + [True] * 2


@pytest.mark.parametrize("plant", [CLEAN, FRI, replace(DEGRADED, drop_probability=0.0)])
def test_sensors_are_those_of_simulated_runs(plant):
    """Sensors in closed loop err as those of a run whose motion is given."""
    rig = SimulatedArm(plant=plant, seed=5, duration_s=200 * TICK_s)
    rows = []
    for sample in rig:
        rows.append((sample, rig.truth))
        rig.send(np.full(7, 0.05))
    samples, truths = zip(*rows, strict=True)
    seeds = np.random.SeedSequence(5).spawn(3)[1].spawn(5)
    clock, _, position, velocity, torque = map(np.random.default_rng, seeds)
    q, dq, tau = (
        np.array([getattr(truth, name) for truth in truths])
        for name in ("q_rad", "dq_rad_s", "tau_Nm")
    )
    stamps_s = sensors.time_stamps(np.arange(200) * TICK_s, plant, clock)
    torques_Nm = sensors.measured_torque(
        tau, q, rig.robot.effort_limit_Nm, plant, torque
    )
    speeds_rad_s = sensors.measured_velocity(dq, plant, velocity)
    speeds_rad_s = [None] * 200 if speeds_rad_s is None else list(speeds_rad_s)

    np.testing.assert_array_equal(
        [sample.q_rad for sample in samples],
        sensors.measured_position(q, plant, position),
    )
    np.testing.assert_array_equal([sample.tau_Nm for sample in samples], torques_Nm)
    np.testing.assert_allclose(
        [sample.dt_s for sample in samples[1:]], np.diff(stamps_s), atol=1e-15
    )
    np.testing.assert_equal([sample.dq_rad_s for sample in samples], speeds_rad_s)


def test_only_equal_seeds_give_equal_runs():
    first, again, other = (
        run(
            SimulatedArm("stack-glove-constant", FRI, seed, standoff_m=0.0),
            0.1,
            down(0.05),
        )
        for seed in (3, 3, 4)
    )
    for sample, repeated in zip(first, again, strict=True):
        np.testing.assert_array_equal(sample.tau_Nm, repeated.tau_Nm)

    assert not np.array_equal(first[-1].tau_Nm, other[-1].tau_Nm)


def test_samples_and_signals_are_lost_as_asked():
    rig = SimulatedArm(plant=IDEAL)
    next(rig)
    rig.lose("sample", 0.005)

    assert next(rig).dt_s == pytest.approx(6e-3)

    rig.lose("tau_Nm", 0.002)
    rig.inject(lambda sample: sample._replace(dt_s=-1.0), 0.001)
    lost = [next(rig) for _ in range(3)]

    assert [np.isnan(sample.tau_Nm).all() for sample in lost] == [True, True, False]
    assert [sample.dt_s for sample in lost] == pytest.approx([-1.0, 1e-3, 1e-3])

    seldom = SimulatedArm(plant=replace(IDEAL, ticks_per_sample=5), duration_s=0.1)
    assert [sample.dt_s for sample in seldom][1:] == pytest.approx([5e-3] * 19)


def test_tissue_lies_as_asked_and_ruptures_count():
    """Tissue lies where it was asked for and ruptures are counted."""
    rig = SimulatedArm("liver-constant", IDEAL, standoff_m=2e-3)
    run(rig, 0.5, down(0.04))

    assert rig.truth.depth_m == pytest.approx(0.04 * 0.5 - 2e-3, abs=1e-3)

    truth = rig.tissue_truth()

    assert truth.ruptures
    assert truth.axial_N[-1] == pytest.approx(rig.truth.tissue.axial_N)


def test_kinematic_error_displaces_the_true_needle_only():
    uncalibrated = replace(CLEAN, kinematic_error_m=2e-4, kinematic_error_rad=3e-4)
    offsets_m = []
    for seed in range(6):
        rig = SimulatedArm(plant=uncalibrated, seed=seed)
        tool = ToolState(rig.robot)
        tool.update(rig.home_rad)
        next(rig)
        offsets_m.append(rig.truth.tip_m - tool.tip_m)

    # Six joints at 0.2 mm and about 0.5 m x 0.3 mrad.
    assert 0.2e-3 < np.std(offsets_m) < 1.5e-3


@pytest.mark.parametrize(
    ("error", "build"),
    [
        (PlantError, lambda: SimulatedArm(servo="soft")),
        (PlantError, lambda: SimulatedArm(latency_s=0.0)),
        (PlantModelError, lambda: SimulatedArm(plant="perfect")),
        (PlantError, lambda: HandOnArm(at="knee")),
        (PlantError, lambda: SimulatedArm(plant=IDEAL).lose("courage", 1.0)),
        (PlantError, lambda: SimulatedArm(plant=IDEAL).tissue_truth()),
    ],
)
def test_unusable_settings_are_refused(error, build):
    with pytest.raises(error):
        build()
