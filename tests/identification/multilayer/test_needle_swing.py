"""The tremor of a hand: ruptures are found although the needle swings."""

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from groundtruth import insert_needle, scenario
from groundtruth.motion import Motion, constant_motion
from identification import Identifier

TREMOR_BEGINS_S = 0.2
"""After the tare."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TremblingMotion(Motion):
    """A motion with a sinusoidal tremor of some mm and Hz, faded in within a second."""

    tremor_m: float = 0.0
    tremor_hz: float = 9.0

    def _fade(self, t_s):
        begin_s = self.tare_end_s + TREMOR_BEGINS_S
        return np.clip(np.asarray(t_s, float) - begin_s, 0.0, 1.0)

    def position_m(self, t_s):
        wave = np.sin(2.0 * math.pi * self.tremor_hz * np.asarray(t_s, float))
        swing_m = self.tremor_m * self._fade(t_s) * wave
        return Motion.position_m(self, t_s) + swing_m

    def speed_m_s(self, t_s):
        rate = 2.0 * math.pi * self.tremor_hz
        t_s = np.asarray(t_s, float)
        fade = self._fade(t_s)
        is_fading = (fade > 0.0) & (fade < 1.0)
        change = rate * fade * np.cos(rate * t_s) + is_fading * np.sin(rate * t_s)
        return Motion.speed_m_s(self, t_s) + self.tremor_m * change


def insert_trembling(tremor_m, speed_m_s=3e-3):
    """Ruptures reported and true of an insertion into a gel, and blocks of swings."""
    even = constant_motion(speed_m_s=speed_m_s, depth_m=36e-3, standoff_m=5e-3)
    names = even.__dataclass_fields__
    motion = TremblingMotion(
        **{name: getattr(even, name) for name in names}, tremor_m=tremor_m
    )
    chosen = replace(scenario("gel-25-constant"), motion=motion)
    run = insert_needle(chosen, seed=4, rate_hz=500.0)
    rows = (run.t_s > run.tare_end_s) & (run.t_s < motion.withdrawal_start_s)
    columns = zip(
        run.depth_m[rows].tolist(),
        run.speed_m_s[rows].tolist(),
        run.force_N[rows].tolist(),
        run.t_s[rows].tolist(),
        strict=True,
    )
    identifier = Identifier()
    ruptures = []
    swings = 0
    for k, (depth_m, speed_m_s, force_N, t_s) in enumerate(columns):
        estimate = identifier.update(depth_m, speed_m_s, force_N, 2e-3, t_s)
        ruptures += [estimate.rupture] if estimate.rupture else []
        if k % 50 == 0:
            swings += identifier.snapshot().state.block.is_swing
    return ruptures, run.truth.ruptures[0].onset_s, swings


@pytest.mark.parametrize("tremor_m", [0.05e-3, 0.12e-3])
def test_a_rupture_is_found_by_a_needle_that_trembles(tremor_m):
    [rupture], onset_s, swings = insert_trembling(tremor_m)

    assert 0.0 < rupture.alarm_s - onset_s < 0.6
    assert swings > 20


def test_a_steady_needle_does_not_swing():
    [rupture], onset_s, swings = insert_trembling(0.0)

    assert 0.0 < rupture.alarm_s - onset_s < 0.1
    assert swings == 0
