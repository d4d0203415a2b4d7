"""The tremor of a hand: ruptures are found although the needle swings."""

from dataclasses import replace

import pytest

from groundtruth import insert_needle, scenario
from groundtruth.motion import Tremor, constant_motion
from identification import Identifier


def insert_trembling(tremor_m, speed_m_s=3e-3):
    """Ruptures reported and true of an insertion into a gel, and blocks of swings."""
    motion = constant_motion(speed_m_s=speed_m_s, depth_m=36e-3, standoff_m=5e-3)
    if tremor_m > 0.0:
        tremor = Tremor(amplitude_m=tremor_m, frequency_hz=9.0)
        motion = replace(motion, tremor=tremor)
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


@pytest.mark.parametrize("tremor_m", [0.022e-3, 0.05e-3, 0.12e-3])
def test_a_rupture_is_found_by_a_needle_that_trembles(tremor_m):
    [rupture], onset_s, swings = insert_trembling(tremor_m)

    assert 0.0 < rupture.alarm_s - onset_s < 0.6
    assert swings > 20


def test_a_steady_needle_does_not_swing():
    [rupture], onset_s, swings = insert_trembling(0.0)

    assert 0.0 < rupture.alarm_s - onset_s < 0.1
    assert swings == 0
