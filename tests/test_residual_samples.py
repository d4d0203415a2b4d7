"""What is no sample of real numbers is refused by every estimator alike, without a warning."""

import warnings
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from residual_signals import MIDDLE, swing

from needleforce.jit import COMPILER
from needleforce.session import tip_motion
from residual import (
    DEFAULT,
    ConfigurationError,
    JointFriction,
    MomentumObserver,
    SampleError,
    SnapshotError,
    VelocityEstimator,
    VirtualForceSensor,
    WrenchEstimator,
)
from residual.fault_detection import fresh_distance
from residual.momentum_observer import momentum_step
from residual.wrench_estimator import wrench_step
from urdf import load_lwr

STILL = np.zeros(7)
NO_NUMBERS = {
    "complex": STILL + 0j,
    "text": np.array(["0.1"] * 7),
    "list of text": ["0.1"] * 7,
    "bytes": np.array([b"1"] * 7),
    "truth values": np.zeros(7, dtype=bool),
    "list of truth values": [True] * 7,
    "objects": np.array([None] * 7),
    "truth values as objects": np.array([False] * 7, dtype=object),
    "masked": np.ma.array(STILL, mask=[True] + [False] * 6),
    "dates": np.array(["2026"] * 7, dtype="datetime64[Y]"),
    "beyond all floats": [10**400] * 7,
    "ragged": [[0.0], [0.0, 1.0]],
}
BEYOND = {
    "NaN": np.r_[np.nan, STILL[1:]],
    "infinite": np.r_[STILL[1:], np.inf],
    "not plausible": STILL + 1e10,
    "hardly a number": STILL + 1e300,
}


UPDATES = {
    "velocity, q": lambda robot, bad: VelocityEstimator(7).update(bad, STILL, 1e-3),
    "velocity, tau": lambda robot, bad: VelocityEstimator(7).update(STILL, bad, 1e-3),
    "momentum, q": lambda robot, bad: MomentumObserver(robot).update(bad, STILL, STILL, 1e-3),
    "momentum, dq": lambda robot, bad: MomentumObserver(robot).update(STILL, bad, STILL, 1e-3),
    "momentum, tau": lambda robot, bad: MomentumObserver(robot).update(STILL, STILL, bad, 1e-3),
    **{
        f"{mode} wrench, {name}": lambda robot, bad, mode=mode, name=name: WrenchEstimator(
            robot, mode
        ).estimate(**({"q": MIDDLE, "residual": STILL} | {name: bad}))
        for mode in ("axial", "point", "full")
        for name in ("q", "residual")
    },
}


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("kind", NO_NUMBERS)
def test_what_is_no_real_number_is_refused(lwr, update, kind):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(SampleError, match=update.split()[-1]):
            UPDATES[update](lwr, NO_NUMBERS[kind])


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize("kind", BEYOND)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_what_no_sensor_measures_is_refused(lwr, update, kind):
    with pytest.raises(SampleError, match=update.split()[-1]):
        UPDATES[update](lwr, BEYOND[kind])


@pytest.mark.parametrize("update", UPDATES)
@pytest.mark.parametrize(
    "valid",
    [
        [0.0] * 7,
        [0] * 7,
        STILL.astype(np.float32),
        STILL.astype(int),
        [Fraction(0)] * 7,
        np.ma.array(STILL),
    ],
)
def test_real_numbers_of_any_type_are_welcome(lwr, update, valid):
    assert str(UPDATES[update](lwr, valid)) == str(UPDATES[update](lwr, STILL))


# What is unusual and valid is taken; what is damaged is refused before compiled code reads it.


STEPS = [1e-3, np.float32(1e-3), np.longdouble(1e-3), Fraction(1, 1000)]


@pytest.mark.parametrize("dt_s", STEPS, ids=[type(one).__name__ for one in STEPS])
def test_a_time_step_may_be_any_real_number(lwr, dt_s):
    _, q, dq, tau = swing(lwr, seconds=0.02)
    sensor, observer, velocity = (
        VirtualForceSensor(lwr),
        MomentumObserver(lwr),
        VelocityEstimator(7),
    )
    for one in zip(q, dq, tau, strict=True):
        wrench, residual = sensor.update(*one, dt_s), observer.update(*one, dt_s)
        matched = velocity.update(one[0], one[2], dt_s)
    assert sensor.rejected == 0
    assert sensor.elapsed_s == pytest.approx(1e-3)
    assert type(wrench.axial) is float
    assert np.isfinite(residual).all()
    assert np.isfinite(matched.dq).all()


def test_a_residual_with_gaps_in_memory_is_read_like_another(lwr):
    q, torques = np.full(7, 0.3), np.random.default_rng(0).normal(size=(7, 5))
    estimator = WrenchEstimator(lwr)
    expected = estimator.estimate(q, torques[:, 3].copy())
    assert estimator.estimate(q, torques[:, 3]).axial == expected.axial != 0.0


def test_nobody_can_write_into_the_samples_that_the_sensor_keeps(lwr):
    class Careless(JointFriction):
        def torque(self, dq_rad_s):
            dq_rad_s *= 2.0
            return super().torque(dq_rad_s)

    _, q, dq, tau = swing(lwr, seconds=0.01)
    sensor = VirtualForceSensor(lwr)
    sensor.update(q[0], dq[0], tau[0], 1e-3)
    assert not sensor.velocity_rad_s.flags.writeable
    nothing = np.zeros(7)
    careless = Careless(coulomb_Nm=nothing, viscous_Nms=nothing, offset_Nm=nothing)
    observer = MomentumObserver(lwr, friction=careless)
    with pytest.raises(ValueError, match="read-only"):
        observer.update(q[0], dq[0], tau[0], 1e-3)


def test_a_clock_of_nanoseconds_does_not_fill_the_memory(lwr):
    _, q, dq, tau = swing(lwr, seconds=0.01)
    sensor = VirtualForceSensor(lwr, DEFAULT)
    for k in range(2500):
        sensor.update(q[0], dq[0], tau[0] + 1e-6 * k, 1e-9)
    assert len(sensor._offset._torques) <= 1000
    assert sensor.snapshot().offset.summed == 2499  # the first sample renews


@pytest.mark.parametrize("noise", [np.ones(3), np.ones(8), np.zeros(7), np.full(7, np.nan)])
def test_noise_of_another_arm_is_refused(lwr, noise):
    _, q, dq, tau = swing(lwr, seconds=0.7)
    observer, sensor = MomentumObserver(lwr), VirtualForceSensor(lwr)
    for one in zip(q, dq, tau, strict=True):
        observer.update(*one, 1e-3)
        sensor.update(*one, 1e-3)
    before = observer.residual
    with pytest.raises(ConfigurationError, match="noise"):
        observer.restore(observer.state._replace(noise=noise))
    np.testing.assert_array_equal(observer.residual, before)
    state = sensor.snapshot()
    damaged = state.joints.observer._replace(noise=noise)
    with pytest.raises(SnapshotError, match="noise"):
        sensor.restore(state._replace(joints=state.joints._replace(observer=damaged)))


# What is compiled gives the same numbers as plain Python.


needs_numba = pytest.mark.skipif(not COMPILER, reason="numba (the extra `fast`) is not installed")
seeds = st.integers(0, 10_000)


@needs_numba
@pytest.mark.parametrize("gains", [1, 7])
@pytest.mark.parametrize("dt_s", [0.0, 1e-3])
@pytest.mark.parametrize("is_quiet", [False, True])
def test_the_momentum_step(gains, dt_s, is_quiet):
    rng = np.random.default_rng(0)
    rows, given_ = rng.normal(size=(9, 7)), rng.normal(size=(3, 7))
    dynamics = (rng.normal(size=(7, 7)), rng.normal(size=(7, 7)), given_[0])
    threshold = rng.uniform(0.5, 2.0, 7) if is_quiet else np.zeros(0)
    found = []
    for step in (momentum_step, momentum_step.py_func):
        own = rows.copy()
        step(own, dynamics, given_[1], given_[2], np.full((gains, 9), 0.3), threshold, dt_s)
        found.append(own)
    assert np.array_equal(found[0][0], rows[0]) == (dt_s == 0.0)
    np.testing.assert_allclose(*found, rtol=1e-9, atol=1e-12)


@needs_numba
@settings(deadline=None)
@given(seed=seeds, repeats=st.sampled_from(["nothing", "first", "positions", "torques", "nan"]))
def test_the_distance_of_two_samples(seed, repeats):
    rng = np.random.default_rng(seed)
    last, weight = rng.normal(size=21), rng.uniform(0.1, 1.0, 21)
    now = last + rng.uniform(1e-3, 1.0, 21)
    same = {"first": [0], "positions": range(7), "torques": range(14, 21)}.get(repeats, [])
    now[list(same)] = last[list(same)]
    if repeats == "nan":
        now[3] = np.nan
    compiled, plain = (f(now, last, weight, 7) for f in (fresh_distance, fresh_distance.py_func))
    assert compiled == pytest.approx(plain, rel=1e-12, nan_ok=True)
    assert np.isinf(compiled) == (repeats in ("positions", "torques"))


@needs_numba
@settings(deadline=None)
@given(seed=seeds, size=st.sampled_from([3, 6]), share=st.sampled_from([0.1, 1.0]))
def test_force_and_motion_of_the_needle(seed, size, share):
    rng = np.random.default_rng(seed)
    q, residual, offset, advance, dq = rng.normal(size=(5, 7))
    rows, axis, pose = rng.normal(size=(1 + size, 7)), rng.random(5), rng.normal(size=(4, 4))
    rows[0] = q
    forces, motions = [], []
    for force_of, motion_of in (
        (wrench_step, tip_motion),
        (wrench_step.py_func, tip_motion.py_func),
    ):
        found, followed_N = np.empty(size + 7), np.ones(3)
        given_ = (q, residual, offset, rows, axis, share, followed_N, found)
        forces.append([*force_of(*given_), *found, *followed_N])
        motions.append(motion_of(axis[:3], pose, advance, dq))
    np.testing.assert_allclose(*forces, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(*motions, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("has_velocity", [True, False])
def test_arrays_of_any_layout_are_taken(has_velocity):
    robot = load_lwr()
    _, q, dq, tau = swing(robot, seconds=0.1)
    plain, strange = VirtualForceSensor(robot, DEFAULT), VirtualForceSensor(robot, DEFAULT)
    for one in zip(q, dq, tau, strict=True):
        gaps = [np.repeat(row, 2)[::2] for row in one]
        if not has_velocity:
            one, gaps = (one[0], None, one[2]), (gaps[0], None, gaps[2])
        wrench, same = plain.update(*one, 1e-3), strange.update(*gaps, 1e-3)
    assert wrench.axial == same.axial != 0.0
    np.testing.assert_array_equal(wrench.residual, same.residual)
