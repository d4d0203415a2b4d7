"""A force that no hypothesis explains is said, and is in the deviations."""

import math

import numpy as np

from identification import TissueWarning
from identification.mixture.innovation_watch import InnovationWatch
from tests.identification.mixture.test_method import run, straight

COUGH_S = 6.0


def cough_m(time_s):
    """Tissue that jumps towards the needle by 4 mm, within a tenth of a second."""
    return -4e-3 * math.exp(-0.5 * ((time_s - COUGH_S) / 0.05) ** 2)


def unexplained(estimates):
    return np.array([TissueWarning.UNEXPLAINED in e.warnings for e in estimates])


def watched(innovations_N, std_N=0.05, tip_std_N=0.1):
    """The doubt after each innovation of a block of 10 ms."""
    watch = InnovationWatch()
    doubts_N = []
    for k, innovation_N in enumerate(innovations_N):
        time_s = 0.01 * k
        watch = watch.with_innovation(innovation_N, std_N**2, time_s, 0.01, tip_std_N)
        doubts_N.append(watch.doubt_at(time_s))
    return np.array(doubts_N)


def test_innovations_as_predicted_are_explained():
    rng = np.random.default_rng(1)
    assert not watched(0.05 * rng.standard_normal(20_000)).any()


def test_unexplained_force_is_held_for_three_seconds():
    doubts_N = watched([0.0] * 100 + [0.6] * 50 + [0.0] * 1_000)

    assert 0 < np.argmax(doubts_N[100:] > 0.0) < 10
    assert doubts_N.max() > 0.5
    assert doubts_N[400] > 0.5
    assert doubts_N[-1] == 0.0


def test_a_cough_is_said_and_an_ordinary_insertion_is_not():
    _, ordinary = run(straight(seed=3))
    _, estimates = run(straight(seed=3, motion_m=cough_m))
    warned = unexplained(estimates)

    assert not unexplained(ordinary).any()
    assert not warned[: round(1e3 * (COUGH_S - 0.3))].any()
    assert warned[round(1e3 * (COUGH_S + 0.5))]
    after, before = round(1e3 * (COUGH_S + 1.0)), round(1e3 * (COUGH_S - 1.0))
    assert estimates[after].tip_force_std_N > 3.0 * estimates[before].tip_force_std_N
