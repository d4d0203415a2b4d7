"""Whether the identifier's innovations are white, with the variance that it expects.

An innovation is what a block's force differs by from the mixture's prediction. Over its
predicted deviation it has mean 0, variance 1 and no correlation from block to block, as
far as what the identifier assumes is right. It has none where nothing is learnt, as at
rest in tissue.
"""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.insertion.metrics import beyond_last_exit
from benchmarks.insertion.signals import InsertionTruth, insertion_truth
from benchmarks.insertion.simulated import identify_sources, read_sensors
from benchmarks.jobs import Figure, Job, make_figures
from foundation.arrays import Array
from groundtruth import Scenario, Tissue, simulate
from identification.mixture.learner import Learner

SCENARIO = "stack-glove-constant"
"""It has all regimes: a layer without a membrane and two with one."""
REGIMES = ("air", "membrane", "cutting", "after a release", "braking")


@contextmanager
def note_innovations() -> Iterator[list[tuple[float, float]]]:
    """Let every learner note time [s] and normalised innovation of its blocks."""
    noted: list[tuple[float, float]] = []
    correct = Learner.correct

    def correct_and_note(self: Learner, block: Any, **how: bool) -> tuple[float, float]:
        innovation_N, variance_N2 = correct(self, block, **how)
        if variance_N2 > 0.0:
            noted.append((block.time_s, innovation_N / math.sqrt(variance_N2)))
        return innovation_N, variance_N2

    with patch.object(Learner, "correct", correct_and_note):
        yield noted


def name_regimes(scenario: Scenario, truth: InsertionTruth) -> NDArray[np.str_]:
    """Return one of `REGIMES` for each sample, shape (n,); empty where there is none.

    After a release is within 2 mm of its onset: the longest in liver takes so much. The
    needle brakes behind the last layer, for some 30 blocks.
    """
    depth_m = truth.depth_m
    names = np.full(len(depth_m), "cutting", dtype="<U15")
    is_usual = truth.speed_m_s >= 0.95 * np.median(truth.speed_m_s[truth.is_insertion])
    names[~is_usual] = "braking"
    names[depth_m <= 0.0] = "air"
    for boundary in Tissue(scenario.layers).interfaces:
        past_m = depth_m - boundary.onset_m
        names[(depth_m > boundary.depth_m) & (past_m <= 0.0)] = "membrane"
        if boundary.drop_N > 0.0:
            names[(past_m > 0.0) & (past_m < 2e-3)] = "after a release"
    names[beyond_last_exit(truth) & (names == "cutting")] = ""
    return np.where(truth.t_s > truth.insertion_end_s, "", names)


def measure_whiteness(times_s: Array, scores: Array) -> dict[str, float]:
    """Return mean, variance and correlations of normalised innovations, shape (n,).

    A pair is so far apart as the lag says, but for half a block of 10 ms; there is no
    correlation of fewer than 50 pairs.
    """
    values = {
        "innovation_mean": float(np.mean(scores)),
        "innovation_variance": float(np.var(scores)),
    }
    centred = scores - np.mean(scores)
    for lag_ms in (10, 20, 50):
        sought_s = times_s + 1e-3 * lag_ms
        later = np.searchsorted(times_s, sought_s - 5e-3).clip(max=len(times_s) - 1)
        is_pair = np.abs(times_s[later] - sought_s) < 5e-3
        if np.count_nonzero(is_pair) >= 50:
            values[f"innovation_correlation_{lag_ms}ms"] = float(
                np.mean(centred[is_pair] * centred[later[is_pair]]) / np.var(scores)
            )
    return values


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of every regime, of the virtual force and of the F/T force."""
    run = simulate(SCENARIO, job.plant, job.seed)
    with note_innovations() as on_virtual:
        case = read_sensors(run, ["ours"])
    with note_innovations() as on_ft:
        sources = identify_sources(case)
    truth = insertion_truth(run)
    names = name_regimes(run.scenario, truth)
    for (item,), noted in zip(sources, (on_ft, on_virtual), strict=True):
        since_s, scores = np.array(noted).T
        times_s = truth.t_s[item.start] + since_s
        regimes = names[np.searchsorted(truth.t_s, times_s).clip(max=len(names) - 1)]
        for regime in REGIMES:
            chosen = regimes == regime
            if chosen.any():
                values = measure_whiteness(times_s[chosen], scores[chosen])
                yield from make_figures(values, f"{item.source}, {regime}")
