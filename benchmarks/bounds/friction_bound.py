"""How well any estimator can know the friction of a layer: the Cramér-Rao bound.

Once the geometry is known the axial force is linear in what is unknown of it: a scale of each
layer's friction, and slope, bend and cutting force of each layer's tip. The bound is that of an
estimator which is told the law, the depths of all ruptures, the colour of the noise, and how large
slopes, bends and cutting forces may be. No estimator is told as much.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular, toeplitz

from benchmarks.bounds.noise_colour import autocovariance
from benchmarks.signals.insertion_truth import InsertionTruth
from groundtruth import Rupture
from identification import DEFAULT

Array = NDArray[np.float64]

LOOK_m = DEFAULT.second_look_m
"""Travel after a rupture by which its layer is identified for good."""
BLOCK_s = 0.02
MOST_BLOCKS = 1000
ONSET_m = DEFAULT.cutting_onset_m
"""Travel over which the cutting force of a layer builds up."""
CUTTING_SHARE = 0.12
"""Root mean square share of cutting in the tip force of drawn layers (0 to 0.2)."""
BEND_SHARE = 0.15
"""The same of the bent part of their elastic force (stiffening 0 to 0.3)."""
VAGUE = 0.8
"""Prior standard deviation, as a share of the true value, of friction and tip force: both are drawn
within a factor of 10 or so, equally likely per octave."""


class _Tip(NamedTuple):
    """Where the tip cuts one layer: from the end of the release above to the boundary below."""

    onset_m: float
    from_m: float
    to_m: float
    exit_N: float


def friction_bounds(
    truth: InsertionTruth,
    error_N: Array,
    *,
    is_white: bool,
    cutting_share: float = CUTTING_SHARE,
) -> list[float]:
    """Relative standard deviation of each layer's friction, by `LOOK_m` after its rupture.

    Args:
        truth: Of the run.
        error_N: Of the reading at the samples of `truth.is_insertion`, see `noise_colour`.
        is_white: Take the noise of the samples as white, whatever its colour is.
        cutting_share: Root mean square share of cutting in the tip force; 0 when there is none.

    Returns:
        One value for each layer that ruptured, in order.
    """
    exits = [rupture for rupture in truth.ruptures if rupture.layer > 0]
    tips = _tips(truth, exits)
    inside = truth.is_insertion
    depth = truth.depth_m[inside]
    frictions = truth.layer_friction_N[inside][:, [rupture.layer - 1 for rupture in exits]]
    columns = np.column_stack([depth, frictions, *(_tip_columns(depth, tip) for tip in tips)])
    size = max(round(BLOCK_s / _tick_s(truth)), -(-len(depth) // MOST_BLOCKS))
    blocks = _means(columns, size)
    depth, columns = blocks[:, 0], blocks[:, 1:]
    if is_white:
        covariance = np.var(error_N) / size * np.eye(len(depth))
    else:
        covariance = toeplitz(autocovariance(_means(error_N[:, None], size)[:, 0], len(depth)))
    kept = _is_modelled(depth, tips, exits)
    factor = cholesky(covariance[np.ix_(kept, kept)], lower=True)
    white = np.asarray(solve_triangular(factor, columns[kept], lower=True))
    prior = np.diag(_prior_std(tips, cutting_share) ** -2.0)
    found = []
    for number, rupture in enumerate(exits):
        rows = white[depth[kept] <= rupture.onset_m + LOOK_m]
        variances = np.diag(np.linalg.inv(rows.T @ rows + prior))
        found.append(float(np.sqrt(variances[number])))
    return found


def _tips(truth: InsertionTruth, exits: list[Rupture]) -> list[_Tip]:
    """One per layer that ruptured."""
    found, onset, begin = [], 0.0, 0.0
    for rupture in truth.ruptures:
        if rupture in exits:
            ends = truth.boundaries_m
            end = ends[rupture.layer - 1] if ends else rupture.onset_m
            found.append(_Tip(onset, begin, end, rupture.drop_N))
        onset = rupture.onset_m
        begin = float(np.interp(rupture.end_s, truth.t_s, truth.depth_m))
    return found


def _tip_columns(depth_m: Array, tip: _Tip) -> Array:
    """Slope, bend and cutting force, each 1 N at the far end, shape (n, 3)."""
    travel = np.maximum(depth_m - tip.onset_m, 0.0)
    share = travel / max(tip.to_m - tip.onset_m, 1e-6)
    onset = np.minimum(travel / ONSET_m, 1.0)
    columns = np.column_stack([share, share * (1.0 - share), onset * (2.0 - onset)])
    columns[(depth_m < tip.from_m) | (depth_m > tip.to_m)] = 0.0
    return columns


def _prior_std(tips: list[_Tip], cutting_share: float) -> Array:
    """Of the scales of friction, then of slope, bend and cutting force of each tip."""
    shares = np.array([VAGUE, BEND_SHARE, max(cutting_share, 1e-6)])
    return np.concatenate(
        [np.full(len(tips), VAGUE), *(max(tip.exit_N, 1e-3) * shares for tip in tips)]
    )


def _is_modelled(depth_m: Array, tips: list[_Tip], exits: list[Rupture]) -> NDArray[np.bool_]:
    """Without releases and membranes being pushed in: what they do is no part of the model."""
    kept = np.zeros(len(depth_m), dtype=bool)
    for tip in tips:
        kept |= (depth_m >= tip.from_m) & (depth_m <= tip.to_m)
    return kept | (depth_m >= exits[-1].onset_m + LOOK_m / 6.0)


def _means(columns: Array, size: int) -> Array:
    """Means of `size` rows each; what is left over at the end is dropped."""
    count = len(columns) // size
    return columns[: count * size].reshape(count, size, -1).mean(axis=1)


def _tick_s(truth: InsertionTruth) -> float:
    return float(np.median(np.diff(truth.t_s)))
