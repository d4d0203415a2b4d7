"""How well any estimator can know the friction of a layer, and how soon a rupture.

Friction, the Cramér-Rao bound: once the geometry is known the axial force is linear in
what is unknown of it, a scale of each layer's friction, and slope, bend and cutting
force of each layer's tip. The bound is that of an estimator which knows the law, the
depths of all ruptures, the noise spectrum, and how large slopes, bends and cutting
forces may be. No estimator knows as much.

Delay, Lorden's bound: a detector whose false alarms are a time T apart must not alarm
before it has gathered log(T / d) nats of evidence within the delay d (Lorden 1971, with
T / d independent trials between two false alarms). Evidence is the Kullback-Leibler
divergence between the force with and without the release. The bound is that of a
detector which knows size and course of the release, the force there would be without
it, and the noise spectrum.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import cholesky, solve_triangular, toeplitz

from benchmarks.insertion.signals import InsertionTruth, NeedleSignal, lagging
from foundation.arrays import Array
from groundtruth import Rupture

AROUND_s = 0.15
"""Left out from the onset of a release to so long after its end: there a lag looks
like noise."""
_FLOOR = 1e-6


def reading_error_N(
    signal: NeedleSignal, truth: InsertionTruth, lag_s: float = 0.0
) -> Array:
    """Return reading less true force over the insertion.

    Straight lines lie across the releases. The truth goes through the sensor's lag
    before it is taken off. One value for each sample of `truth.is_insertion`, shape
    (m,).
    """
    inside = truth.is_insertion
    error = (signal.force_N - lagging(truth.axial_N, truth.t_s, lag_s))[inside]
    t_s = truth.t_s[inside]
    quiet = np.ones(len(t_s), dtype=bool)
    for rupture in truth.ruptures:
        quiet &= (t_s < rupture.onset_s) | (t_s > rupture.end_s + AROUND_s)
    return np.interp(t_s, t_s[quiet], error[quiet])


def autocovariance(error_N: Array, length: int) -> Array:
    """Return the autocovariance of (m,) samples at lags 0 to length - 1 [N^2].

    It is about zero. The biased estimate: it is positive definite, and about zero
    because a force is judged against its free-air zero, so that a constant error is an
    error. Lags the data do not reach are 0.
    """
    count = len(error_N)
    spectrum = np.abs(np.fft.rfft(error_N, 2 * count)) ** 2
    lags = np.fft.irfft(spectrum)[: min(length, count)] / count
    return np.concatenate((lags, np.zeros(length - len(lags))))


MEASURED_m = 3e-3
"""Travel after a rupture by which its layer is identified for good."""
BLOCK_s = 0.02
MAX_BLOCKS = 1000
ONSET_m = 1e-3
"""Travel over which the cutting force of a layer builds up."""
CUTTING_FRACTION = 0.12
"""Root mean square fraction of cutting in the tip force of drawn layers (0 to 0.2)."""
BEND_FRACTION = 0.15
"""The same of the bent part of their elastic force (stiffening 0 to 0.3)."""
VAGUE = 0.8
"""Prior standard deviation, relative to the true value, of friction and tip force: both
are drawn within a factor of 10 or so, equally likely per octave."""


_Tip = tuple[float, float, float, float]
"""Where the tip cuts one layer: its onset, from the release above to the boundary below
[m], and the force at the exit [N]."""


def friction_bounds(
    truth: InsertionTruth,
    error_N: Array,
    *,
    is_white: bool,
    cutting_fraction: float = CUTTING_FRACTION,
) -> list[float]:
    """Return the least relative deviation of each layer's friction.

    It is that by `MEASURED_m` after the layer's rupture. The error of the reading is as
    `reading_error_N` returns it; its noise can be taken as white, whatever its spectrum
    is. The fraction is the root mean square one of cutting in the tip force. One value
    for each layer that ruptured, in order.
    """
    exits = [rupture for rupture in truth.ruptures if rupture.layer > 0]
    tips = _tips(truth, exits)
    depth, columns, size = block_columns(truth, exits, tips)
    covariance = block_covariance(error_N, size, len(depth), is_white=is_white)
    # Without releases and membranes being pushed in: what they do is no part of the
    # model.
    is_modelled = depth >= exits[-1].onset_m + MEASURED_m / 6.0
    for _, from_m, to_m, _ in tips:
        is_modelled |= (depth >= from_m) & (depth <= to_m)
    factor = cholesky(covariance[np.ix_(is_modelled, is_modelled)], lower=True)
    white = np.asarray(solve_triangular(factor, columns[is_modelled], lower=True))
    # Of the scales of friction, then of slope, bend and cutting force of each tip.
    fractions = np.array([VAGUE, BEND_FRACTION, max(cutting_fraction, 1e-6)])
    of_tips = [max(exit_N, 1e-3) * fractions for *_, exit_N in tips]
    prior = np.diag(np.concatenate([np.full(len(tips), VAGUE), *of_tips]) ** -2.0)
    deviations = []
    for number, rupture in enumerate(exits):
        rows = white[depth[is_modelled] <= rupture.onset_m + MEASURED_m]
        variances = np.diag(np.linalg.inv(rows.T @ rows + prior))
        deviations.append(float(np.sqrt(variances[number])))
    return deviations


def block_columns(
    truth: InsertionTruth, exits: Sequence[Rupture], tips: Sequence[_Tip]
) -> tuple[Array, Array, int]:
    """Return what the force depends on, as means over blocks of samples.

    Depth of m blocks, shape (m,); friction of each of L layers, then slope, bend and
    cutting force of each tip, shape (m, 4 L); samples of a block.
    """
    inside = truth.is_insertion
    depth = truth.depth_m[inside]
    layers = [rupture.layer - 1 for rupture in exits]
    frictions = truth.layer_friction_N[inside][:, layers]
    columns = np.column_stack(
        [depth, frictions, *(_tip_columns(depth, tip) for tip in tips)]
    )
    size = max(round(BLOCK_s / truth.period_s), -(-len(depth) // MAX_BLOCKS))
    blocks = _means(columns, size)
    return blocks[:, 0], blocks[:, 1:], size


def block_covariance(
    error_N: Array, size: int, blocks: int, *, is_white: bool
) -> Array:
    """Return the covariance of the error's means over blocks, shape (m, m)."""
    if is_white:
        return np.var(error_N) / size * np.eye(blocks)
    means = _means(error_N[:, None], size)[:, 0]
    return toeplitz(autocovariance(means, blocks))


def _tips(truth: InsertionTruth, exits: list[Rupture]) -> list[_Tip]:
    """Return one per layer that ruptured."""
    tips = []
    onset = 0.0
    begin = 0.0
    for rupture in truth.ruptures:
        if rupture in exits:
            ends = truth.boundaries_m
            end = ends[rupture.layer - 1] if ends else rupture.onset_m
            tips.append((onset, begin, end, rupture.drop_N))
        onset = rupture.onset_m
        begin = float(np.interp(rupture.end_s, truth.t_s, truth.depth_m))
    return tips


def _tip_columns(depth_m: Array, tip: _Tip) -> Array:
    """Return slope, bend and cutting force, each 1 N at the far end, shape (n, 3)."""
    onset_m, from_m, to_m, _ = tip
    travel = np.maximum(depth_m - onset_m, 0.0)
    way = travel / max(to_m - onset_m, 1e-6)
    onset = np.minimum(travel / ONSET_m, 1.0)
    columns = np.column_stack([way, way * (1.0 - way), onset * (2.0 - onset)])
    columns[(depth_m < from_m) | (depth_m > to_m)] = 0.0
    return columns


def _means(columns: Array, size: int) -> Array:
    """Return means of `size` rows each; what remains at the end is dropped."""
    count = len(columns) // size
    return columns[: count * size].reshape(count, size, -1).mean(axis=1)


INTERVAL_s = 3600.0
"""Between false alarms."""
BEFORE_s = 0.3
"""Past of the noise that is known: slow drift is taken off by it."""
WITHIN_s = 0.5
"""After so long every release is over."""
LINE_s = 0.1
"""Of the true force before the onset: continued, it is the force without the
release."""


def delay_bounds_s(
    truth: InsertionTruth,
    ruptures: Sequence[Rupture],
    error_N: Array,
    lag_s: float = 0.0,
) -> list[float]:
    """Return the least mean delay after the onset of each release.

    Infinite where too little is released. The run is sampled evenly; `error_N` is as
    `reading_error_N` returns it, `lag_s` the sensor's.
    """
    tick = truth.period_s
    past = round(BEFORE_s / tick)
    within = round(WITHIN_s / tick)
    covariance = autocovariance(error_N, past + within)
    matrix = toeplitz(covariance) + _FLOOR * covariance[0] * np.eye(len(covariance))
    factor = cholesky(matrix, lower=True)
    delays = tick * np.arange(1.0, within + 1.0)
    needed_nats = np.log(np.maximum(INTERVAL_s / delays, math.e))
    bounds_s = []
    for rupture in ruptures:
        course = np.concatenate(
            (np.zeros(past), release_course_N(truth, rupture, within))
        )
        course = lagging(course, tick * np.arange(float(len(course))), lag_s)
        # Kullback-Leibler divergence gathered up to each sample, noise of that
        # covariance.
        nats = 0.5 * np.cumsum(np.square(solve_triangular(factor, course, lower=True)))
        enough = np.flatnonzero(nats[past:] >= needed_nats)
        bounds_s.append(float(delays[enough[0]]) if len(enough) else math.inf)
    return bounds_s


def release_course_N(truth: InsertionTruth, rupture: Rupture, count: int) -> Array:
    """Return the true force from the onset on, less the line before, shape (count,)."""
    line = (truth.t_s >= rupture.onset_s - LINE_s) & (truth.t_s < rupture.onset_s)
    begin = int(np.searchsorted(truth.t_s, rupture.onset_s))
    if np.count_nonzero(line) < 2:
        return np.zeros(count)
    slope, level = np.polyfit(truth.t_s[line] - rupture.onset_s, truth.axial_N[line], 1)
    inside = np.minimum(np.arange(begin, begin + count), len(truth.t_s) - 1)
    time = truth.t_s[inside] - rupture.onset_s
    return np.asarray(truth.axial_N[inside] - level - slope * time)
