"""How soon any detector can know a rupture: Lorden's bound on the mean delay.

A detector whose false alarms are a time T apart must not alarm before it has gathered log(T / d)
nats of evidence within the delay d (Lorden 1971, with T / d independent trials between two false
alarms). Evidence is the Kullback-Leibler divergence between the force with and without the release.
The bound is that of a detector which is told size and course of the release, the force there would
be without it, and the colour of the noise.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from benchmarks.bounds.noise_colour import autocovariance, lagging, whitener
from benchmarks.signals.insertion_truth import InsertionTruth
from groundtruth import Rupture
from identification import DEFAULT

Array = NDArray[np.float64]

INTERVAL_s = DEFAULT.false_alarm_interval_s
"""Between false alarms."""
BEFORE_s = 0.3
"""Past of the noise that is known: what wanders slowly is taken off by it."""
WITHIN_s = 0.5
"""After so long every release is over."""
LINE_s = 0.1
"""Of the true force before the onset: continued, it is the force without the release."""


def delay_bounds_s(
    truth: InsertionTruth, ruptures: Sequence[Rupture], error_N: Array, lag_s: float = 0.0
) -> list[float]:
    """Least mean delay after the onset of each release; inf where too little is released.

    Args:
        truth: Of the run, sampled evenly.
        ruptures: Of it.
        error_N: Of the reading at the samples of `truth.is_insertion`, see `noise_colour`.
        lag_s: Time constant of the sensor.
    """
    tick = float(np.median(np.diff(truth.t_s)))
    before, within = round(BEFORE_s / tick), round(WITHIN_s / tick)
    factor = whitener(autocovariance(error_N, before + within))
    found = []
    for rupture in ruptures:
        course = np.concatenate((np.zeros(before), release_course_N(truth, rupture, within)))
        course = lagging(course, tick * np.arange(float(len(course))), lag_s)
        evidence = evidence_nats(course, factor)[before:]
        found.append(least_delay_s(evidence, tick * np.arange(1.0, within + 1.0)))
    return found


def release_course_N(truth: InsertionTruth, rupture: Rupture, count: int) -> Array:
    """True force from the onset on, less the line it had followed, shape (count,)."""
    line = (truth.t_s >= rupture.onset_s - LINE_s) & (truth.t_s < rupture.onset_s)
    begin = int(np.searchsorted(truth.t_s, rupture.onset_s))
    if np.count_nonzero(line) < 2:
        return np.zeros(count)
    slope, level = np.polyfit(truth.t_s[line] - rupture.onset_s, truth.axial_N[line], 1)
    inside = np.minimum(np.arange(begin, begin + count), len(truth.t_s) - 1)
    time = truth.t_s[inside] - rupture.onset_s
    return np.asarray(truth.axial_N[inside] - level - slope * time)


def evidence_nats(course_N: Array, factor: Array) -> Array:
    """Kullback-Leibler divergence gathered up to each sample, shape (n,).

    Args:
        course_N: Mean of the force with the release less that without, shape (n,).
        factor: Lower triangular, `factor @ factor.T` the covariance of the noise, shape (n, n).
    """
    white = np.asarray(solve_triangular(factor, course_N, lower=True))
    return np.asarray(0.5 * np.cumsum(white**2))


def least_delay_s(evidence: Array, delay_s: Array, interval_s: float = INTERVAL_s) -> float:
    """First delay by which the evidence is enough; inf if it never is.

    Args:
        evidence: Gathered by each delay [nats], shape (n,), not decreasing.
        delay_s: Shape (n,), positive.
        interval_s: Wanted between false alarms.
    """
    needed = np.log(np.maximum(interval_s / delay_s, math.e))
    enough = np.flatnonzero(evidence >= needed)
    return float(delay_s[enough[0]]) if len(enough) else math.inf
