"""The tremor of a hand: ruptures are found although the needle swings."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from groundtruth import insert_needle, scenario
from groundtruth.motion import Tremor, constant_motion
from identification import Identifier


class Trembling(NamedTuple):
    """What came of an insertion into a gel.

    Attributes:
        ruptures: That were reported.
        onset_s: Of the true one.
        swings: Samples of many that lie in a swing.
        covered: Fraction of the way in the gel in which the true tip force lies within
            two standard deviations.
    """

    ruptures: list
    onset_s: float
    swings: int
    covered: float


def insert_trembling(tremor_m, speed_m_s=3e-3):
    """Insert a needle that trembles into a gel."""
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
    true_tip_N = run.truth.tip_N[rows]
    ruptures = []
    is_covered = []
    swings = 0
    for k, (depth_m, speed_m_s, force_N, t_s) in enumerate(columns):
        estimate = identifier.update(depth_m, speed_m_s, force_N, 2e-3, t_s)
        ruptures += [estimate.rupture] if estimate.rupture else []
        if estimate.in_contact and t_s < motion.insertion_end_s:
            error_N = abs(estimate.tip_force_N - true_tip_N[k])
            is_covered.append(error_N < 2.0 * estimate.tip_force_std_N)
        if k % 50 == 0:
            swings += identifier.snapshot().state.learner.block.is_swing
    onset_s = run.truth.ruptures[0].onset_s
    return Trembling(ruptures, onset_s, swings, float(np.mean(is_covered)))


@pytest.mark.parametrize("tremor_m", [0.03e-3, 0.05e-3, 0.12e-3])
def test_a_rupture_is_found_by_a_needle_that_trembles(tremor_m):
    insertion = insert_trembling(tremor_m)
    [rupture] = insertion.ruptures

    assert 0.0 < rupture.alarm_s - insertion.onset_s < 0.6
    assert insertion.swings > 20
    assert insertion.covered > 0.85


@pytest.mark.slow
def test_a_steady_needle_does_not_swing():
    insertion = insert_trembling(0.0)
    [rupture] = insertion.ruptures

    assert 0.0 < rupture.alarm_s - insertion.onset_s < 0.1
    assert insertion.swings == 0
