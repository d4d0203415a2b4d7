"""Offset removal that lasts: what a tare learns from free motion, and what it
refuses."""

import copy
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foundation.steps import finish
from groundtruth import PLANT_MODELS
from groundtruth.arm_plant import BearingFriction
from residual import (
    BiasPrior,
    SensorConfig,
    Status,
    TareError,
    VirtualForceSensor,
)
from residual.bias.coloured_noise import NoiseRoot
from residual.bias.joint_states import joint_states_step, play_operator
from tests.insertion_run import same
from tests.residual.guarded_sensor import feed, feed_external, pushed, rows_of, signals
from tests.residual.residual_signals import (
    BIAS,
    MIDDLE,
    gravity_of,
    pose_of,
)

DT_S = 4e-3
TOWARDS = np.array([0.0, 0.12, 0.01, 0.15, 0.0, 0.1, 0.0])
TURNS = np.linspace(0.0, 3 * np.pi, 2250)
STROKE_RAD = MIDDLE + 0.5 * (-1 - np.cos(TURNS))[:, None] * TOWARDS
"""There, back and there again in 9 s."""
AHEAD_RAD = STROKE_RAD[-1] + np.linspace(0.0, 0.8, 500)[:, None] * TOWARDS


def after_stroke(robot, torque_of, q_rad=AHEAD_RAD, noise_Nm=0.005, **settings):
    """A sensor that was tared on external torques which depend on the posture, and
    its residuals on another way, shape (n, 7)."""
    sensor = VirtualForceSensor(robot, SensorConfig(**settings))
    rng = np.random.default_rng(0)
    for way in (STROKE_RAD, q_rad):
        torque = torque_of(way) + noise_Nm * rng.normal(size=way.shape)
        found = feed_external(sensor, rows_of(way, None, torque), DT_S)
        if not sensor.tared:
            sensor.tare(ignore_contact="tare" in settings)
    return sensor, np.array([e.residual for e in found])


def heavier(robot):
    """Torque of a link that weighs more than its model, by posture."""
    model = robot.model.copy()
    link = model.inertias[5]
    model.inertias[5] = pin.Inertia(link.mass + 0.1, link.lever, link.inertia)
    data = model.createData()
    return lambda way: (
        [pin.computeGeneralizedGravity(model, data, q).copy() for q in way]
        - gravity_of(robot, way)
    )


RATIO = (160.0,) * 4 + (100.0,) * 3


def ripple_of(way):
    return 0.02 * np.sin(2 * np.array(RATIO) * way) * (TOWARDS > 0.05) + BIAS


@pytest.mark.parametrize(
    ("cause", "prior"),
    [(heavier, BiasPrior()), (lambda _: ripple_of, BiasPrior(gear_ratio=RATIO))],
)
def test_a_known_cause_is_subtracted_where_the_stroke_never_was(lwr, cause, prior):
    known, unknown = (
        np.abs(after_stroke(lwr, cause(lwr), noise_Nm=1e-3, **kinds)[1][100:])
        for kinds in ({"prior": prior}, {"tare": "constant"})
    )

    assert known.max() < 0.5 * unknown.max()
    assert np.mean(known[:, 1:4:2]) < 0.012


def test_a_constant_tare_is_the_mean_residual(lwr):
    _, residuals_Nm = after_stroke(
        lwr, lambda way: BIAS + 0.1 * way, noise_Nm=0.0, tare="constant"
    )
    expected_Nm = 0.1 * (AHEAD_RAD - STROKE_RAD.mean(axis=0))

    np.testing.assert_allclose(residuals_Nm, expected_Nm, atol=2e-3)


def test_a_tare_looks_back_as_far_as_it_is_told_and_memory_is_bounded(lwr):
    def early(way):
        return BIAS + 0.5 * (np.arange(len(way)) < 1700)[:, None] * (len(way) == 2250)

    kinds = {"noise_Nm": 0.0, "tare": "constant", "contact_force_N": 50.0}
    sensor, residuals_Nm = after_stroke(lwr, early, tare_window_s=1.5, **kinds)

    assert np.abs(residuals_Nm[-1]).max() < 1e-3
    assert 150 < len(sensor.snapshot().offset.recorder.sums) < 400


def test_waviness_makes_the_deviation_wider_and_not_the_slope(lwr):
    (smooth, _), (rough, errors_Nm) = (
        after_stroke(lwr, lambda way, wave=wave_Nm: wave * np.sin(320.0 * way + 1.0))
        for wave_Nm in (0.0, 0.02)
    )
    error_Nm = np.abs(errors_Nm[-100:].mean(axis=0))

    assert (rough.residual_std_Nm > 1.2 * smooth.residual_std_Nm)[1:4:2].all()
    assert (error_Nm < 3.0 * rough.residual_std_Nm)[1:4].all()


def test_uncertainty_grows_with_distance_and_time(lwr):
    near, far = (
        after_stroke(lwr, lambda way: BIAS + 0.0 * way, AHEAD_RAD[:count])[0]
        for count in (100, 500)
    )
    std_Nm = [near.residual_std_Nm.sum(), far.residual_std_Nm.sum()]
    for _ in range(10):
        far.update_external_torque(AHEAD_RAD[-1], None, BIAS, 59.0)

    assert std_Nm[0] < std_Nm[1] < far.residual_std_Nm.sum()


# Bearings that rub.

REACH_RAD = np.array([0.01, 0.1, 0.02, 0.13, 0.035, 0.22, 0.03])
NOISE_NM = np.array([0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011])
T_S = DT_S * np.arange(-1, 5301)


def place(t_s):
    """A second of rest, three strokes of 4 s, then on at a tenth of their speed, 0
    to 1.3."""
    stroke, s = np.divmod(np.clip((t_s - 1.0) / 4.0, 0.0, 3.0), 1.0)
    quintic = s**3 * (10.0 + s * (6.0 * s - 15.0))
    there = np.where(stroke % 2 == 0, quintic, 1.0 - quintic)
    return np.where(stroke == 3, 1.0 + 0.03 * (t_s - 13.0), there)


def rubbed_rows(robot, seed, factor=1.0, force_of=np.zeros_like):
    """Samples of an arm whose bearings rub: 0.02 to 0.1 Nm, equal chance per octave."""
    octaves = np.random.default_rng([seed, 1]).uniform(size=7)
    coulomb_Nm = 0.02 * factor * 5.0**octaves
    rng = np.random.default_rng(seed)
    viscous = (0.3 * coulomb_Nm.max(),) * 7
    clean = PLANT_MODELS["clean"]
    model = replace(clean, joint_coulomb=1.0, joint_viscous_Nms_per_rad=viscous)
    bearings = BearingFriction(model, coulomb_Nm, rng)
    q = MIDDLE + place(T_S)[:, None] * REACH_RAD
    dq = np.gradient(q, DT_S, axis=0)
    noise = NOISE_NM * rng.standard_normal(q.shape)
    tau = gravity_of(robot, q) - rng.uniform(-0.5, 0.5, 7) + noise
    tau -= [bearings.step(one, DT_S).copy() for one in dq]
    needle = pose_of(robot, MIDDLE).rotation[:, 2]
    return [
        pushed(robot, [row], -force_N * needle)[0] if force_N else row
        for row, force_N in zip(rows_of(q, dq, tau), force_of(T_S), strict=True)
    ][1:]


def read_after(robot, rows, taring):
    """Axial forces [N] after a tare on so many samples, and their deviations."""
    sensor = VirtualForceSensor(robot)
    feed(sensor, rows[:taring], DT_S)
    sensor.tare()
    return np.array([(e.axial, e.axial_std) for e in feed(sensor, rows[taring:], DT_S)])


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "most_N", "seed"), [(1.0, 0.06, 0), (3.0, 0.12, 1)])
def test_friction_is_learnt_from_strokes_both_ways(lwr, factor, most_N, seed):
    axial_N, std_N = read_after(lwr, rubbed_rows(lwr, seed, factor), 3250)[50:].T

    assert np.sqrt(np.mean(axial_N**2)) < most_N
    assert np.mean(np.abs(axial_N) < 2.0 * std_N) > 0.8
    assert std_N.max() < 5 * most_N


def test_a_short_tare_states_its_ignorance(lwr):
    axial_N, std_N = read_after(lwr, rubbed_rows(lwr, 5)[:750], 250).T

    assert std_N[-1] > 3.0 * std_N[0]
    assert np.mean(np.abs(axial_N) < 2.0 * std_N) > 0.85


TOUCHES = {
    "late": lambda t: 0.5 * np.clip((t - 11.0) / 0.3, 0.0, 1.0),
    "early": lambda t: 0.5 * np.clip((t - 5.0) / 0.3, 0.0, 1.0),
    "passing": lambda t: 0.6 * (np.abs(t - 8.0) < 0.7),
    "a pull": lambda t: -0.5 * np.clip((t - 11.0) / 0.3, 0.0, 1.0),
    "growing": lambda t: 0.8 * np.clip((t - 5.0) / 8.0, 0.0, 1.0),
    "always": lambda t: 60.0 + 0.0 * t,
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", TOUCHES)
def test_a_contact_is_refused_and_changes_nothing_unless_ignored(lwr, kind):
    sensor = VirtualForceSensor(lwr)
    rows = rubbed_rows(lwr, 2, force_of=TOUCHES[kind])
    feed(sensor, rows[:3250], DT_S)
    twin = copy.deepcopy(sensor)
    with pytest.raises(TareError, match="contact"):
        sensor.tare()

    assert same(*(one.update(*rows[3250], DT_S) for one in (sensor, twin)))

    sensor.tare(ignore_contact=True)

    assert (twin.tared, sensor.tared) == (False, True)


@pytest.mark.slow
def test_a_touch_below_the_smallest_contact_is_accepted(lwr):
    rows = rubbed_rows(lwr, 2, force_of=lambda t: 0.05 * (t > 11.0))

    assert len(read_after(lwr, rows[:3251], 3250)) == 1


# A tare that is fitted beside the ticks of a loop.


def moved(robot, more=2.0):
    sensor = VirtualForceSensor(robot)
    rows = rows_of(*signals(robot, 1.0 + more))
    feed(sensor, rows[:1000])
    return sensor, rows[1000:]


AMID = {
    "itself": lambda sensor, _: sensor,
    "copy": lambda sensor, _: copy.deepcopy(sensor),
    "snapshot": lambda sensor, other: other.restore(sensor.snapshot()) or other,
}


@pytest.mark.parametrize("how", AMID)
def test_a_tare_in_steps_is_the_same_bit_for_bit(lwr, how):
    (at_once, rows), (sensor, _) = (moved(lwr) for _ in range(2))
    at_once.tare()
    sensor.start_tare(steps_per_tick=2)
    found = feed(sensor, rows[:100])
    sensor = AMID[how](sensor, VirtualForceSensor(lwr))
    sensor.start_tare()  # a second time, which does nothing
    while sensor.taring:
        found += feed(sensor, [rows[len(found)]])
    feed(at_once, rows[: len(found)])

    assert {e.status for e in found} == {Status.NOT_TARED}
    assert "fitted" in found[0].message
    assert same(*(one.snapshot().offset.tare for one in (sensor, at_once)))
    # Both renew the bias at the same ticks, every 20 ms, from the next one on.
    rest = rows[len(found) : len(found) + 22]
    ours, theirs = (feed(one, rest)[-1] for one in (sensor, at_once))
    assert (ours.status, ours.residual.tolist()) == (
        Status.OK,
        theirs.residual.tolist(),
    )


def test_a_refused_tare_in_steps_says_why_and_changes_nothing(lwr):
    sensor, free = moved(lwr)
    rows = pushed(lwr, free, [0.0, 0.0, 4.0])
    feed(sensor, rows[:500])
    with pytest.raises(TareError) as refused:
        copy.deepcopy(sensor).tare()
    sensor.start_tare(steps_per_tick=200)
    found = feed(sensor, rows[500:700])

    assert (sensor.taring, sensor.tared, str(sensor.tare_refusal)) == (
        False,
        False,
        str(refused.value),
    )
    assert str(refused.value) in found[-1].message

    sensor.start_tare_recording()

    assert sensor.tare_refusal is None


# Mathematics that stands alone.


@given(
    state=st.floats(-1.0, 1.0), change=st.floats(-1.0, 1.0), width=st.floats(1e-3, 1.0)
)
def test_a_play_follows_within_its_width(state, change, width):
    assert play_operator(state, change, width) == pytest.approx(
        np.clip(state + change / width, -1.0, 1.0)
    )


def test_a_sliding_bearing_rubs_more_at_low_speed():
    states = np.zeros((7, 1))  # three loops, two elements, more at low speed, speed
    written = np.zeros((5, 1)), np.zeros(1), np.zeros(1), states
    kinds = {"loops": 3, "stribeck_rad_s": 0.02, "dt_s": 1e-3}
    for k in range(1, 2001):
        q = np.array([0.02e-3 * k])  # 0.02 rad/s
        joint_states_step(*written, q, np.zeros(1), np.full((5, 1), 1e-3), **kinds)

    expected = [0, 0, 0, 1, 1, np.exp(-1.0), 0.02]
    assert states[:, 0] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("wave_Nm", [0.0, 0.02])
def test_noise_is_whitened_by_the_root_of_its_covariance(wave_Nm):
    q_rad = np.r_[np.linspace(0.0, 0.3, 100), np.linspace(0.3, 0.0, 100)]
    distance = (q_rad[:, None] - q_rad) / 0.02
    covariance = wave_Nm**2 * np.exp(-0.5 * distance**2) + 0.003**2 * np.eye(200)
    values = np.random.default_rng(0).normal(size=(200, 3))
    root = NoiseRoot(0.003**2, wave_Nm**2, q_rad, 0.02)
    finish(root.compute())

    np.testing.assert_allclose(
        finish(root.whiten(values)),
        np.linalg.solve(np.linalg.cholesky(covariance), values),
        rtol=1e-6,
        atol=1e-6,
    )
