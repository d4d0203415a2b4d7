"""The arm: its link tables, its path and control, and its physics in MuJoCo."""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from groundtruth import (
    PLANT_MODELS,
    SCENARIOS,
    MotionError,
    TICK_s,
    TissueForce,
)
from groundtruth.arm_motion import (
    LWR_POSTURE_rad,
    insertion_path,
    joint_excitation,
    needle_down,
    scenario_motion,
    scenario_path,
)
from groundtruth.arm_plant import (
    ArmPlant,
    TissueContact,
    arm_model,
    blended_links,
    lwr_bodies,
)
from tests.residual.residual_signals import (
    external_torque_of,
    gravity_of,
    jacobian_of,
    pose_of,
)
from urdf import NeedleTool, load_lwr

DEGRADED = PLANT_MODELS["degraded"]
EVERY_PLANT = pytest.mark.parametrize("name", PLANT_MODELS)
GRAVITY = 9.80665
REACH_M = 0.24
BARE = load_lwr()
ROBOT = load_lwr(payload=NeedleTool())
START = needle_down(ROBOT, np.array(LWR_POSTURE_rad))
# Fact sheet, section 2.6: static force bias at the flange in this posture, per CAD
# fraction.
POSTURE = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0])
FLANGE_BIAS_N = {0.1: 0.31, 0.2: 0.61, 0.3: 0.92, 1.0: 3.07}


def test_blend_ends_at_the_two_tables():
    nominal, between, cad = (blended_links(BARE.model, f) for f in (0.0, 0.3, 1.0))
    pseudo = [pin.PseudoInertia.FromInertia(link).toMatrix() for link in between]

    assert np.linalg.eigvalsh(pseudo).min() > 0.0
    assert all(map(pin.Inertia.isApprox, nominal, BARE.model.inertias[1:]))
    assert [link.mass for link in cad] == pytest.approx([2.7] * 4 + [1.7, 1.6, 0.3])
    assert cad[0].lever == pytest.approx([0.00134, 0.02622, 0.11222], abs=1e-15)
    assert cad[5].inertia[2, 2] == pytest.approx(0.003413)


@pytest.mark.parametrize(("fraction", "bias_N"), FLANGE_BIAS_N.items())
def test_blend_biases_the_flange_force_as_published(fraction, bias_N):
    (known,) = gravity_of(BARE, [POSTURE])
    model = BARE.model.copy()
    for i, link in enumerate(blended_links(BARE.model, fraction), start=1):
        model.inertias[i] = link
    gravity = pin.computeGeneralizedGravity(model, model.createData(), POSTURE)
    wrench = np.linalg.pinv(jacobian_of(BARE, POSTURE).T) @ (gravity - known)

    assert abs(wrench[2]) == pytest.approx(bias_N, abs=0.011)


def test_degraded_arm_has_the_stated_errors():
    tool = NeedleTool()
    rng = np.random.default_rng(0)
    shifts = [lwr_bodies(tool, DEGRADED, rng).needle.lever for _ in range(60)]
    spread = np.std(np.array(shifts) - tool.beyond_sensor.com_m)

    # 180 draws: 5 % standard error of the standard deviation
    assert spread == pytest.approx(DEGRADED.payload_com_spread_m, rel=0.2)


def test_every_path_is_straight_and_well_conditioned():
    start = pose_of(ROBOT, START)
    in_place = pose_of(ROBOT, LWR_POSTURE_rad).translation
    motions = [scenario.motion for scenario in SCENARIOS.values()]
    path = insertion_path(ROBOT, START, (0.0, REACH_M))

    np.testing.assert_allclose(start.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-10)
    np.testing.assert_allclose(start.translation, in_place, atol=1e-10)
    for travel in np.linspace(0.0, REACH_M, 97):
        q = path.posture_rad(travel)
        moved = path.start.actInv(pose_of(ROBOT, q)).homogeneous
        along = pin.SE3(np.eye(3), np.array([0.0, 0.0, travel])).homogeneous
        margin = np.minimum(ROBOT.position_upper_rad - q, q - ROBOT.position_lower_rad)
        np.testing.assert_allclose(moved, along, atol=2e-9)
        assert margin.min() > np.radians(20.0)
        assert np.linalg.cond(jacobian_of(ROBOT, q)) < 12.0
    assert all(0.0 < each.deepest_m - each.start_m <= REACH_M for each in motions)


STRETCHED_RAD = np.array([0.0, 1.57, 0.0, -0.02, 0.0, 1.57, 0.0])


@pytest.mark.parametrize(
    ("find_posture", "begin_rad", "arguments", "word"),
    [
        (insertion_path, START, [(0.0, 2.0)], "reaches"),
        (insertion_path, START, [(-0.3, 0.0)], "lwr_joint_6"),
        (needle_down, STRETCHED_RAD, [], "singular"),
    ],
)
def test_a_line_out_of_reach_is_refused(find_posture, begin_rad, arguments, word):
    with pytest.raises(MotionError, match=word):
        find_posture(ROBOT, begin_rad, *arguments)


def test_joint_speed_is_the_derivative_of_position():
    gel = SCENARIOS["gel-25-constant"]
    insertion = scenario_motion(scenario_path(ROBOT, gel), gel)
    free = joint_excitation(START, 20.0)
    for q_rad, dq_rad_s in (insertion, free):
        numeric = (q_rad[2:] - q_rad[:-2]) / (2.0 * TICK_s)
        np.testing.assert_allclose(dq_rad_s[1:-1], numeric, atol=2e-6)
    peak_rad_s = np.abs(free.dq_rad_s).max(axis=0)

    assert 0.3 < peak_rad_s.min() < peak_rad_s.max() < 0.6
    assert (np.abs(free.q_rad) < ROBOT.position_upper_rad).all()
    assert not free.dq_rad_s[[0, -1]].any()
    assert np.abs(np.diff(free.dq_rad_s, axis=0)).max() / TICK_s < 2.0


class Push:
    """Tissue that pushes back with a constant force, whatever the needle does."""

    layers = (object(),)
    is_air = False
    interfaces = ()

    def __init__(self, force_N):
        self.force_N = force_N

    def step(self, depth_m, speed_m_s, dt_s):
        return TissueForce(self.force_N, self.force_N, 0.0, 1, (0.0,))


def bodies_of(name):
    return lwr_bodies(NeedleTool(), PLANT_MODELS[name], np.random.default_rng(3))


def plant_in(law, bodies):
    down = np.array([0.0, 0.0, -1.0])
    contact = TissueContact(law=law, surface_in_base_m=np.zeros(3), axis_in_base=down)
    return ArmPlant(bodies, contact)


@EVERY_PLANT
def test_mujoco_and_pinocchio_agree_on_the_dynamics(name):
    bodies = bodies_of(name)
    model = bodies.model()
    physics = arm_model(bodies, TICK_s)
    state = mujoco.MjData(physics)
    rng = np.random.default_rng(1)

    assert physics.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    for _ in range(20):  # limits and losses of MuJoCo's own would show here
        motion = rng.uniform(-3.5, 3.5, (3, 7))
        state.qpos, state.qvel, state.qacc = motion
        mujoco.mj_inverse(physics, state)
        expected = pin.rnea(model, model.createData(), *motion)
        np.testing.assert_allclose(state.qfrc_inverse, expected, atol=1e-9)


@EVERY_PLANT
@pytest.mark.parametrize("push_N", [0.0, 2.5])
def test_sensor_at_rest_reads_weight_less_tissue_force(name, push_N):
    """The push is balanced at the joints through the tip, so nothing moves."""
    bodies = bodies_of(name)
    model = bodies.model()
    needle = bodies.needle
    rng = np.random.default_rng(2)
    for q in (START, *rng.uniform(-1.5, 1.5, (5, 7))):
        plant = plant_in(Push(push_N), bodies)
        plant.place(q, np.zeros(7))
        gravity = pin.computeGeneralizedGravity(model, model.createData(), q)
        sensor = pose_of(bodies.robot, q, "ft_sensor").rotation
        lever_m = external_torque_of(bodies.robot, q, sensor[:, 2])
        weight = sensor.T @ np.array([0.0, 0.0, -GRAVITY * needle.mass])
        expected = [*weight, *np.cross(needle.lever, weight)] - push_N * np.eye(6)[2]
        plant.tick(gravity + push_N * lever_m)
        np.testing.assert_allclose(
            np.r_[plant.axial_jacobian, plant.ft_wrench, plant.mean_axial_N],
            np.r_[lever_m, expected, push_N],
            atol=1e-9,
        )
        np.testing.assert_allclose(plant.dq_rad_s, 0.0, atol=1e-12)
