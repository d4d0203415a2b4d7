"""What is compiled gives the same numbers as plain Python."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from residual_signals import swing

from needleforce.jit import COMPILER
from needleforce.session import tip_motion
from residual import DEFAULT, VirtualForceSensor
from residual.fault_detection import fresh_distance
from residual.momentum_observer import momentum_step
from residual.wrench_estimator import axial_force
from urdf import load_lwr

pytestmark = pytest.mark.skipif(not COMPILER, reason="numba (the extra `fast`) is not installed")
seeds = st.integers(0, 10_000)


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


@settings(deadline=None)
@given(seed=seeds, damping=st.sampled_from([0.0, 1e-4]))
def test_force_and_motion_of_the_needle(seed, damping):
    rng = np.random.default_rng(seed)
    residual, offset, weighted, advance, dq = rng.normal(size=(5, 7))
    axis, pose = rng.normal(size=(3, 3))[:, 1], rng.normal(size=(4, 4))
    forces, motions = [], []
    for force_of, motion_of in (
        (axial_force, tip_motion),
        (axial_force.py_func, tip_motion.py_func),
    ):
        corrected, force = np.empty(7), np.empty(3)
        given_ = (residual, offset, weighted, advance, axis, damping, corrected, force)
        forces.append([force_of(*given_), *corrected, *force])
        motions.append(motion_of(axis.copy(), pose, advance, dq))
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
