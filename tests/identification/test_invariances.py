"""What is identified does not depend on how a recording happens to be written down."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from groundtruth import insert_needle
from identification import replay

RATE_HZ = 250.0


class Recording(NamedTuple):
    """Times, depths, forces and, where it is measured, speeds, shape (n,)."""

    t_s: np.ndarray
    depth_m: np.ndarray
    force_N: np.ndarray
    speed_m_s: np.ndarray


@cache
def record():
    """One gel, from 10 mm in front of it until the needle has left it."""
    run = insert_needle("gel-25-constant", seed=3, rate_hz=RATE_HZ)
    begin = np.searchsorted(run.depth_m[run.t_s > run.tare_end_s], -10e-3)
    begin += np.searchsorted(run.t_s, run.tare_end_s)
    rows = slice(begin, np.searchsorted(run.t_s, run.truth.rupture_s[0] + 3.0))
    columns = (run.t_s, run.depth_m, run.force_N, run.speed_m_s)
    return Recording(*(column[rows] for column in columns))


def still(recording, seconds):
    """The same with a needle that rests in front of the tissue first."""
    count = round(seconds * RATE_HZ)
    noise_N = np.random.default_rng(1).normal(0.0, 0.01, count)
    return Recording(
        np.arange(count + len(recording.t_s)) / RATE_HZ,
        np.append(np.full(count, recording.depth_m[0]), recording.depth_m),
        np.append(noise_N, recording.force_N),
        np.append(np.zeros(count), recording.speed_m_s),
    )


def cut_approach(recording):
    """The same from 1 mm in front of the tissue on."""
    begin = int(np.argmax(recording.depth_m > -1e-3))
    return Recording(*(column[begin:] for column in recording))


CHANGES = {
    "depth begins 0.2 m in front": lambda r: r._replace(depth_m=r.depth_m - 0.2),
    "depth begins at 1 m": lambda r: r._replace(depth_m=r.depth_m + 1.0),
    "time begins at 1.7e9 s": lambda r: r._replace(t_s=r.t_s + 1.7e9),
    "a still second in front": lambda r: still(r, 1.0),
    "no approach": cut_approach,
    "half the rate": lambda r: Recording(*(column[::2] for column in r)),
}


def find_layers(recording, *, has_speed):
    speed_m_s = recording.speed_m_s if has_speed else None
    return replay(recording.t_s, recording.depth_m, recording.force_N, speed_m_s).layers


@cache
def original_layers(*, has_speed):
    return find_layers(record(), has_speed=has_speed)


@pytest.mark.slow
@pytest.mark.parametrize("has_speed", [False, True])
@pytest.mark.parametrize("change", CHANGES)
def test_the_same_insertion_has_the_same_layers(change, has_speed):
    layers = original_layers(has_speed=has_speed)
    changed = find_layers(CHANGES[change](record()), has_speed=has_speed)

    assert len(changed) == len(layers) == 1
    for before, after in zip(layers, changed, strict=True):
        std_N = np.hypot(before.friction_std_N, after.friction_std_N)
        assert abs(after.friction_N - before.friction_N) < std_N
        assert after.thickness_m == pytest.approx(before.thickness_m, abs=3e-4)


@pytest.mark.slow
def test_speeds_that_are_measured_change_no_layer():
    estimated = original_layers(has_speed=False)
    measured = original_layers(has_speed=True)

    assert len(estimated) == len(measured) == 1
    for before, after in zip(estimated, measured, strict=True):
        std_N = np.hypot(before.friction_std_N, after.friction_std_N)
        assert abs(after.friction_N - before.friction_N) < std_N
