"""A whole run of the simulated arm: physics, truth, signals, and what it reports."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from groundtruth import (
    PLANT_MODELS,
    Motion,
    Move,
    PlantError,
    PlantModelError,
    Run,
    Scenario,
    TICK_s,
    chain_strokes,
    gel,
    simulate,
)
from residual import MomentumObserver
from tests.insertion_run import same
from tests.residual.guarded_sensor import feed, rows_of

GAIN_PER_S = 50.0
GRAVITY = 9.80665


def short_scenario(exit_force_N):
    """One thin gel and little air: 7 s in all."""
    moves = [
        Move("rest", 0.5, 0.0),
        Move("quintic", 1.0, 0.01),
        Move("cruise", 2.0, 0.016),
        Move("rest", 0.5, 0.0),
        Move("cruise", 2.0, -0.016),
        Move("rest", 0.5, 0.0),
    ]
    motion = Motion(
        strokes=chain_strokes(-0.014, moves, ramp_fraction=0.2),
        tare_end_s=1.5,
        insertion_end_s=3.5,
        withdrawal_start_s=4.0,
        withdrawal_end_s=6.0,
    )
    layer = replace(gel(70), thickness_m=8e-3, exit_force_N=exit_force_N)
    return Scenario(id="short", title="one thin gel", layers=(layer,), motion=motion)


SCENARIO = short_scenario(1.4)


@pytest.fixture(scope="module")
def runs() -> dict[str, Run]:
    return {name: simulate(SCENARIO, plant=name, seed=1) for name in PLANT_MODELS}


def momentum_residual(run: Run):
    """Observer's residual by the rigid model and the true signals."""
    truth = run.truth
    observer = MomentumObserver(run.robot, GAIN_PER_S, alignment="hold")
    rows = rows_of(truth.q_rad, truth.dq_rad_s, truth.tau_Nm)
    return np.array(feed(observer, rows, TICK_s))[1:]


def filtered(torque_Nm):
    """What an ideal observer gives for an external torque."""
    decay = np.exp(-GAIN_PER_S * TICK_s)
    return lfilter([1.0 - decay], [1.0, -decay], torque_Nm, axis=0)


def test_residual_is_ideal_filter_on_ideal_arm_only(runs, monkeypatch):
    def error(run):
        return momentum_residual(run) - filtered(run.truth.external_torque_Nm[:-1])

    assert np.sqrt((error(runs["ideal"]) ** 2).mean(axis=0)).max() < 1e-6
    assert np.abs(runs["ideal"].truth.external_torque_Nm).max() > 0.1
    assert 0.05 < np.abs(error(runs["clean"])[1000:]).max() < 1.0

    monkeypatch.setattr("groundtruth.arm_motion.FREE_MOTION_s", 10.0)
    free = simulate("free-motion")

    assert np.abs(free.truth.dq_rad_s).max() > 0.3
    assert np.sqrt((error(free) ** 2).mean(axis=0)).max() < 2e-6
    assert not free.truth.axial_N.any()


@pytest.mark.slow
def test_bearing_friction_looks_like_an_external_torque(
    monkeypatch,
):
    ideal = replace(PLANT_MODELS["ideal"], joint_coulomb=2e-4)
    monkeypatch.setitem(PLANT_MODELS, "ideal", ideal)
    run = simulate(SCENARIO)
    truth = run.truth
    power = truth.joint_friction_Nm * truth.dq_rad_s
    friction = filtered(truth.joint_friction_Nm[:-1])
    external = filtered(truth.external_torque_Nm[:-1])

    # around a reversal the bristles give back what they stored
    assert power.sum(axis=0).max() < 0.0
    assert np.mean(power[np.abs(truth.speed_m_s) > 1e-3] <= 0.0) > 0.95
    assert np.abs(truth.depth_m - SCENARIO.motion.position_m(truth.t_s)).max() < 1e-4
    assert np.abs(friction).max() > 0.02
    np.testing.assert_allclose(momentum_residual(run), external + friction, atol=1e-4)


@pytest.mark.parametrize("name", PLANT_MODELS)
def test_needle_follows_its_motion_and_truth_adds_up(runs, name):
    run = runs[name]
    truth = run.truth
    sums_N = truth.tip_N + truth.friction_N, truth.layer_friction_N.sum(axis=1)
    is_moving = np.abs(truth.speed_m_s) > 1e-4
    resisting_N = truth.friction_N * np.sign(truth.speed_m_s)
    (rupture_s,) = truth.rupture_s
    instants_s = run.tare_end_s, truth.contact_s, rupture_s, truth.withdrawn_s

    np.testing.assert_allclose(
        truth.depth_m, run.scenario.motion.position_m(truth.t_s), atol=1e-4, rtol=0
    )
    np.testing.assert_allclose(sums_N, (truth.axial_N, truth.friction_N), atol=1e-12)
    assert resisting_N[is_moving].min() > -0.2
    assert truth.axial_N.max() > 0.2
    assert (np.diff([*instants_s, truth.t_s[-1]]) > 0.0).all()
    assert not truth.axial_N[truth.t_s < truth.contact_s].any()


def test_the_sensor_reads_weight_and_tissue(runs):
    run = runs["ideal"]
    reading = run.tool.beyond_sensor.mass_kg * GRAVITY - run.signals.ft_wrench[:, 2]

    # what remains is the needle's inertia: 0.068 kg at less than 0.1 m/s^2
    np.testing.assert_allclose(reading, run.truth.axial_N, atol=0.01)


@pytest.mark.slow
def test_equal_arguments_give_equal_runs(runs):
    progress: list[float] = []
    run = runs["degraded"]
    again = simulate(SCENARIO, "degraded", 1, progress.append)
    other = simulate(SCENARIO, plant="degraded", seed=2)

    assert 0.0 == progress[0] < progress[5] <= progress[-1] == 1.0
    assert progress == sorted(progress)
    assert same((run.signals, run.truth), (again.signals, again.truth))
    assert not run.truth.axial_N.flags.writeable
    assert abs(other.signals.tau_Nm[:50] - again.signals.tau_Nm[:50]).mean() > 0.05


def test_plant_models_give_what_they_promise(runs):
    clean = runs["clean"].signals
    degraded = runs["degraded"].signals
    ideal = runs["ideal"]

    np.testing.assert_array_equal(ideal.signals.tau_Nm, ideal.truth.tau_Nm)
    assert [run.signals.dq_rad_s is None for run in runs.values()] == [
        *(False, False, True, True),
    ]
    assert [run.truth.joint_friction_Nm.any() for run in runs.values()] == [
        *(False, False, True, True),
    ]
    assert np.ptp(np.diff(clean.t_s)) < 1e-9
    assert np.diff(degraded.t_s).max() > 1.5e-3
    assert (np.diff(degraded.t_s) > 0.0).all()
    assert len(degraded.t_s) == len(degraded.tau_Nm) == len(runs["degraded"].truth.t_s)

    # The robot is the nominal one, whatever the arm.
    robots = [list(run.robot.model.inertias) for run in runs.values()]
    assert all(robot == robots[0] for robot in robots)


@pytest.mark.slow
def test_unknown_names_and_lost_motions_are_refused():
    with pytest.raises(PlantModelError, match="no-such"):
        simulate("gel-70-constant", plant="no-such")
    with pytest.raises(PlantError, match="softer tissue"):
        simulate(short_scenario(4e5))
