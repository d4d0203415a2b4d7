"""A source slower than the clock repeats its samples, then jumps: that is no spike."""

import numpy as np
import pytest
from residual_signals import BIAS, swing

from residual import SensorWarning, Status, VirtualForceSensor

MILLISECONDS = (2, 3, 5, 8, 10, 20)


def held(values, samples, rng=None):
    """Every value comes several times; with a generator, one time more or less."""
    lengths = np.full(len(values), samples)
    if rng is not None:
        lengths += rng.integers(-1, 2, size=len(values))
    first = np.concatenate(([0], np.cumsum(lengths)))
    return values[first[np.searchsorted(first, np.arange(len(values)), side="right") - 1]]


def moving(robot, noise_rad, seconds=1.5):
    """Positions, velocities and torques of a brisk motion, up to half a radian a second."""
    _, q, dq, tau = swing(robot, seconds=seconds)
    rng = np.random.default_rng(0)
    tau = tau - BIAS + 0.03 * rng.normal(size=q.shape)
    dq = dq + 1e-3 * rng.normal(size=q.shape)
    return q + noise_rad * rng.normal(size=q.shape), dq, tau


def spikes(estimates):
    return [k for k, e in enumerate(estimates) if SensorWarning.SPIKE in e.warnings]


def estimates(sensor, q, dq, tau):
    rows = zip(q, [None] * len(q) if dq is None else dq, tau, strict=True)
    return [sensor.update(*row, 1e-3) for row in rows]


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("noise_rad", [0.0, 1e-5, 1e-4])
@pytest.mark.parametrize("samples", MILLISECONDS)
def test_positions_held_from_50_to_500_hz_are_no_spikes(lwr, samples, noise_rad, with_velocity):
    q, dq, tau = moving(lwr, noise_rad)
    for rng in (None, np.random.default_rng(1)):
        sent = (held(q, samples, rng), dq if with_velocity else None, tau)
        found = estimates(VirtualForceSensor(lwr), *sent)
        assert not any(e.warnings for e in found)
        assert found[-1].status is Status.NOT_TARED


@pytest.mark.parametrize("which", [1, 2])
def test_velocities_or_torques_held_at_100_hz_are_no_spikes(lwr, which):
    signals = list(moving(lwr, 1e-5))
    signals[1] = signals[1] + 0.01 * np.random.default_rng(2).normal(size=signals[1].shape)
    signals[which] = held(signals[which], 10)
    assert not spikes(estimates(VirtualForceSensor(lwr), *signals))


@pytest.mark.parametrize("samples", MILLISECONDS)
def test_a_spike_of_a_held_position_is_still_held_back(lwr, samples):
    q, dq, tau = moving(lwr, 1e-5)
    q = held(q, samples)
    q[1000 : 1000 + 4, 2] += 0.05
    found = estimates(VirtualForceSensor(lwr), q, dq, tau)
    assert spikes(found)[0] == 1000
    assert all(e.status is Status.REJECTED for e in found[1000:1004])
    assert len(spikes(found)) <= 5
    assert found[-1].status is Status.NOT_TARED


def test_a_rest_of_any_length_makes_no_gate_wide(lwr):
    q, dq, tau = moving(lwr, 0.0)
    q = np.repeat(q[:1], 4000, axis=0)
    rng = np.random.default_rng(3)
    dq, tau = 1e-3 * rng.normal(size=q.shape), tau[0] + 0.03 * rng.normal(size=q.shape)
    q[3990, 4] += 1e-3
    assert spikes(estimates(VirtualForceSensor(lwr), q, dq, tau)) == [3990]


def test_a_hold_is_remembered_by_a_snapshot(lwr):
    q, dq, tau = moving(lwr, 1e-5)
    q = held(q, 20)
    sensor, other = VirtualForceSensor(lwr), VirtualForceSensor(lwr)
    estimates(sensor, q[:1015], dq[:1015], tau[:1015])
    state = sensor.snapshot()
    assert state.joints.guard.held_s == pytest.approx(0.014)
    other.restore(state)
    assert not spikes(estimates(other, q[1015:], dq[1015:], tau[1015:]))
