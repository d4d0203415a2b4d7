from dataclasses import fields, replace

import numpy as np
import pinocchio as pin
import pytest
from scipy.signal import lfilter

import groundtruth
from groundtruth import Run, Scenario, Signals, simulate
from groundtruth.errors import PlantError, PlantModelError, ScenarioError
from groundtruth.materials import gel
from groundtruth.motion import Motion, Stroke
from groundtruth.scenarios import SCENARIOS

GAIN_PER_S = 50.0
TICK_s = 1e-3
GRAVITY = 9.80665


def short_scenario(thickness_m=8e-3, factor=1.0):
    """One thin gel and little air: 7 s in all."""
    layer = replace(gel(70), thickness_m=thickness_m)
    layer = replace(layer, exit_force_N=factor * layer.exit_force_N)
    rows = [
        ("rest", 0.5, 0.0),
        ("quintic", 1.0, 0.01),
        ("cruise", 2.0, 0.016),
        ("rest", 0.5, 0.0),
        ("cruise", 2.0, -0.016),
        ("rest", 0.5, 0.0),
    ]
    strokes, time, place = [], 0.0, -0.014
    for profile, duration, travel in rows:
        strokes.append(
            Stroke(
                profile=profile,
                start_s=time,
                duration_s=duration,
                start_m=place,
                travel_m=travel,
                ramp_share=0.2,
            )
        )
        time, place = strokes[-1].end_s, strokes[-1].end_m
    motion = Motion(
        strokes=tuple(strokes),
        tare_end_s=1.5,
        insertion_end_s=3.5,
        withdrawal_start_s=4.0,
        withdrawal_end_s=6.0,
    )
    return Scenario(id="short", title="one thin gel", layers=(layer,), motion=motion)


SCENARIO = short_scenario()


@pytest.fixture(scope="module")
def runs() -> dict[str, Run]:
    return {arm: simulate(SCENARIO, plant=arm, seed=1) for arm in ("ideal", "clean", "degraded")}


def observer_error(run: Run, model: pin.Model):
    """Exact-step momentum residual of true signals against the ideal filter of the true torque."""
    truth, data = run.truth, model.createData()
    rows = list(zip(truth.q_rad, truth.dq_rad_s, strict=True))
    momentum = np.array([pin.crba(model, data, q) @ dq for q, dq in rows])
    rate = np.array(
        [
            pin.computeCoriolisMatrix(model, data, q, dq).T @ dq
            - pin.computeGeneralizedGravity(model, data, q)
            for q, dq in rows
        ]
    )
    seen = np.diff(momentum, axis=0) / TICK_s - truth.tau_Nm[:-1] - 0.5 * (rate[1:] + rate[:-1])
    decay = np.exp(-GAIN_PER_S * TICK_s)
    return lfilter([1.0 - decay], [1.0, -decay], seen - truth.external_torque_Nm[:-1], axis=0)


def test_momentum_observer_on_the_textbook_arm_is_the_ideal_filter(runs):
    run = runs["ideal"]
    error = observer_error(run, run.robot.model)
    assert np.sqrt((error**2).mean(axis=0)).max() < 1e-6
    assert np.abs(run.truth.external_torque_Nm).max() > 0.1


def test_momentum_observer_in_free_motion_is_the_ideal_filter(monkeypatch):
    monkeypatch.setattr("groundtruth.arm_control.FREE_MOTION_s", 10.0)
    run = simulate("free-motion")
    assert np.abs(run.truth.dq_rad_s).max() > 0.3
    error = observer_error(run, run.robot.model)
    assert np.sqrt((error**2).mean(axis=0)).max() < 2e-6
    assert not run.truth.axial_N.any()
    assert np.isnan(run.contact_s)
    assert np.isnan(run.withdrawn_s)


def test_realistic_arm_disagrees_with_the_estimators_model(runs):
    run = runs["clean"]
    error = observer_error(run, run.robot.model)
    assert 0.05 < np.abs(error[1000:]).max() < 1.0


def test_needle_follows_its_motion(runs):
    for run in runs.values():
        wanted = run.scenario.motion.position_m(run.truth.t_s)
        assert np.abs(run.truth.depth_m - wanted).max() < 1e-4


def test_truth_adds_up(runs):
    for run in runs.values():
        truth = run.truth
        np.testing.assert_allclose(truth.tip_N + truth.friction_N, truth.axial_N, atol=1e-12)
        np.testing.assert_allclose(truth.layer_friction_N.sum(axis=1), truth.friction_N, atol=1e-12)
        moving = np.abs(truth.speed_m_s) > 1e-4
        assert (truth.friction_N * np.sign(truth.speed_m_s))[moving].min() > -0.2
        assert truth.axial_N.max() > 0.2


def test_instants_come_in_order(runs):
    for run in runs.values():
        (rupture,) = run.truth.rupture_s
        assert run.tare_end_s < run.contact_s < rupture < run.withdrawn_s < run.truth.t_s[-1]
        before = run.truth.t_s < run.contact_s
        assert not run.truth.axial_N[before].any()


def test_ft_reading_is_weight_minus_the_axial_force_of_the_tissue(runs):
    run = runs["ideal"]
    weight = run.tool.beyond_sensor.mass_kg * GRAVITY
    reading = weight - run.signals.ft_wrench[:, 2]
    # what remains is the needle's inertia: 0.068 kg at less than 0.1 m/s^2
    np.testing.assert_allclose(reading, run.truth.axial_N, atol=0.01)


def test_static_torque_is_gravity(runs):
    run = runs["ideal"]
    q = run.signals.q_rad[100]
    gravity = pin.computeGeneralizedGravity(run.robot.model, run.robot.create_data(), q)
    np.testing.assert_allclose(run.signals.tau_Nm[100], gravity, atol=1e-6)


def test_equal_arguments_give_equal_runs_and_other_seeds_do_not(runs):
    again = simulate(SCENARIO, plant="degraded", seed=1)
    for part in ("signals", "truth"):
        for item in fields(getattr(again, part)):
            first = getattr(getattr(runs["degraded"], part), item.name)
            second = getattr(getattr(again, part), item.name)
            assert first is second is None or np.array_equal(first, second), item.name
    other = simulate(SCENARIO, plant="degraded", seed=2)
    assert abs(other.signals.tau_Nm[:50] - again.signals.tau_Nm[:50]).mean() > 0.05


def test_levels_give_what_they_promise(runs):
    ideal, clean, degraded = (runs[arm].signals for arm in ("ideal", "clean", "degraded"))
    np.testing.assert_array_equal(ideal.tau_Nm, runs["ideal"].truth.tau_Nm)
    assert clean.dq_rad_s is not None
    assert degraded.dq_rad_s is None
    assert np.ptp(np.diff(clean.t_s)) < 1e-9
    assert np.diff(degraded.t_s).max() > 1.5e-3
    assert (np.diff(degraded.t_s) > 0.0).all()
    for signals, run in ((ideal, runs["ideal"]), (degraded, runs["degraded"])):
        assert len(signals.t_s) == len(signals.tau_Nm) == len(run.truth.axial_N)


def test_signals_hold_only_what_a_robot_gives():
    names = {item.name for item in fields(Signals)}
    assert names == {"t_s", "q_rad", "dq_rad_s", "tau_Nm", "ft_wrench"}


def test_estimators_robot_has_nominal_numbers_whatever_the_arm(runs):
    nominal = runs["ideal"].robot.model
    for run in runs.values():
        for mine, theirs in zip(run.robot.model.inertias, nominal.inertias, strict=True):
            np.testing.assert_array_equal(mine.toDynamicParameters(), theirs.toDynamicParameters())


def test_results_are_read_only(runs):
    for part in (runs["degraded"].signals, runs["degraded"].truth):
        for item in fields(part):
            value = getattr(part, item.name)
            if isinstance(value, np.ndarray):
                with pytest.raises(ValueError, match="read-only"):
                    value[0] = 0.0


def test_progress_rises_from_zero_to_one():
    shares: list[float] = []
    simulate(SCENARIO, progress=shares.append)
    assert shares[0] == 0.0
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    assert len(shares) > 5


def test_unknown_names_are_refused():
    with pytest.raises(ScenarioError, match="no-such"):
        simulate("no-such")
    with pytest.raises(PlantModelError, match="no-such"):
        simulate("gel-70-constant", plant="no-such")


def test_tissue_that_throws_the_arm_off_is_reported():
    with pytest.raises(PlantError, match="softer tissue"):
        simulate(short_scenario(factor=3e5))


def test_public_names_resolve():
    assert {"Run", "Signals", "Truth", "simulate", "PLANT_MODELS"} <= set(groundtruth.__all__)
    assert set(SCENARIOS) >= {"gel-70-constant", "free-motion"}
