"""A low-passed speed is brought back to the depth, and no stop of the needle is a rupture."""

import numpy as np
import pytest
from scipy.signal import lfilter

from identification import Identifier
from identification.resampling import Block
from identification.speed_lag import SpeedLag, lag_step

DT_S = 1e-3


def low_passed(signal, time_constant_s):
    if time_constant_s == 0.0:
        return signal
    keep = np.exp(-DT_S / time_constant_s)
    return lfilter([1.0 - keep], [1.0, -keep], signal, zi=[keep * signal[0]])[0]


def motion(n=14_000, ramp_s=0.3):
    """Rest, constant speed, rest."""
    time = DT_S * np.arange(n)
    speed = 3e-3 * np.clip((time - 1.0) / ramp_s, 0.0, 1.0)
    speed *= np.clip((time[-1] - 1.5 - time) / ramp_s, 0.0, 1.0)
    return speed, np.cumsum(speed) * DT_S


def learned(speed, depth, block=5):
    state, out = SpeedLag(), []
    for k in range(0, len(speed) - block + 1, block):
        part = slice(k, k + block)
        state, handed = lag_step(
            state,
            Block(k * DT_S, block * DT_S, depth[part].mean(), speed[part].mean(), 0.0, 1.0),
        )
        out.append(handed.speed_m_s)
    return state.lag_s, np.array(out)


@pytest.mark.parametrize("time_constant_s", [0.02, 0.05, 0.1])
@pytest.mark.parametrize("noise_m", [0.0, 6e-6])
def test_the_time_constant_is_learned_and_the_speed_restored(time_constant_s, noise_m):
    speed, depth = motion()
    rng = np.random.default_rng(5)
    given = low_passed(speed, time_constant_s)
    found, restored = learned(given, depth + noise_m * rng.standard_normal(len(depth)))
    assert found == pytest.approx(time_constant_s, rel=0.1)
    blocks = speed.reshape(-1, 5).mean(axis=1)
    late = len(blocks) // 2
    assert np.max(np.abs(restored - blocks)[late:]) < 0.15e-3
    assert np.max(np.abs(given.reshape(-1, 5).mean(axis=1) - blocks)[late:]) > 0.15e-3


@pytest.mark.parametrize("seed", range(10))
def test_a_speed_without_lag_is_left_as_it_is(seed):
    speed, depth = motion()
    rng = np.random.default_rng(seed)
    noisy = speed + 1.2e-4 * rng.standard_normal(len(speed))
    found, restored = learned(noisy, depth + 6e-6 * rng.standard_normal(len(depth)))
    assert found == 0.0
    assert np.allclose(restored, noisy.reshape(-1, 5).mean(axis=1))


@pytest.mark.parametrize("time_constant_s", [0.0, 0.02, 0.05])
@pytest.mark.parametrize("ramp_s", [0.1, 0.5])
def test_no_alarm_when_the_needle_stops(time_constant_s, ramp_s):
    """All force is viscous friction: it falls at once, the speed as given only later."""
    speed, depth = motion(ramp_s=ramp_s)
    rng = np.random.default_rng(int(1e3 * (time_constant_s + ramp_s)))
    force = 12_000.0 * np.maximum(depth - 2e-3, 0.0) * speed
    force += 0.01 * rng.standard_normal(len(force))
    given = low_passed(speed + 1.2e-4 * rng.standard_normal(len(speed)), time_constant_s)
    measured = depth + 6e-6 * rng.standard_normal(len(depth))
    identifier = Identifier()
    rows = zip(measured.tolist(), given.tolist(), force.tolist(), strict=True)
    assert all(identifier.update(*row, DT_S).rupture is None for row in rows)
