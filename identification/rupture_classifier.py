"""Whether a rupture ended a layer, was a partial one, or none: what is left at the tip afterwards.

At the end of a layer the tip force goes to nothing, and the force after the rupture is friction.
After a partial rupture the tissue keeps pushing at the tip; taken for friction, that force would
never leave the estimate again. The two differ in how far the needle travels while the force falls,
and in how much of it falls; neither is certain, so both are weighed.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.config import MultilayerConfig
from identification.estimate import Rupture
from identification.layer_model import MM
from identification.membrane import Boundary, MembraneSearch
from identification.resampling import BLOCKS, DEPTH, FORCE, SPEED

Array = NDArray[np.float64]

# Force on both sides of a rupture, extrapolated to the same instant.

_BEFORE_M = 2e-3
_MARGIN_M = 2e-5
_LEAST_POINTS = 4
_AGREEMENT = 2.5
_CHUNK = 4
_RIDGE = 1e-9


class ForceAfter(NamedTuple):
    """Axial force just after a rupture, and what follows it."""

    # Force at t_r without the tip force of the layer left, extrapolated from after the release; the
    # next layer's push is taken out
    force_N: float
    variance: float  # Its variance [N^2]
    slope_N_per_mm: float  # Growth of the force per travel after the release


def force_before(points: Array, depth_m: float, noise_N2: float) -> tuple[float, float] | None:
    """Force at a rupture extrapolated from the last millimetres before it, and its variance.

    Returns:
        Both, or None while too few points are at hand.
    """
    reach = points[:, DEPTH] - depth_m
    is_before = (reach > -_BEFORE_M) & (reach < -_MARGIN_M)
    side = points[is_before]
    if len(side) < 2:
        return None
    columns = np.ones((len(side), 2 if len(side) > 3 else 1))
    columns[:, 1:] = 1e3 * reach[is_before][:, None]
    weight = side[:, BLOCKS] / max(noise_N2, 1e-12)
    normal = columns.T @ (columns * weight[:, None])
    covariance = np.linalg.inv(normal + _RIDGE * np.eye(len(normal)))
    solution = covariance @ (columns.T @ (weight * side[:, FORCE]))
    return float(solution[0]), float(covariance[0, 0])


class AfterRows(NamedTuple):
    """Points after a rupture as rows of the law that their force obeys."""

    design: Array  # Friction, cutting force, slope; force; ones. Shape (n, 5).
    weight: Array  # Inverse variances, shape (n,)
    cutting_N: float  # Expected cutting force


def rows_after(
    points: Array, depth_m: float, speed_m_s: float, noise_N2: float, config: MultilayerConfig
) -> AfterRows | None:
    """What the force after a rupture is measured from.

    Returns:
        The rows, or None while too few points are at hand.
    """
    side = points[points[:, DEPTH] > depth_m]
    if len(side) < _LEAST_POINTS:
        return None
    design = _design(side, depth_m, speed_m_s, config)
    weight, half = side[:, BLOCKS] / max(noise_N2, 1e-12), len(side) // 2
    return AfterRows(design, weight, _cutting_prior(design[half:], weight[half:], config))


def force_after(rows: AfterRows) -> ForceAfter:
    """Force after a rupture: grow the window back towards it until the release is met.

    The release lifts two neighbouring chunks of points above what the later ones predict; the
    chunk before which that happens may hold its tail and is left out too.
    """
    weighted, count = rows.design * rows.weight[:, None], len(rows.weight)
    latest = max(count - max(_LEAST_POINTS, count // 2), 0)
    solutions, covariances = _windows(rows.design, weighted, rows.cutting_N, latest)
    begin = _first_undisturbed(solutions, covariances, weighted[latest % _CHUNK : latest])
    force, _, slope = solutions[begin]
    return ForceAfter(force, covariances[begin][0][0], max(slope, 0.0))


def _design(side: Array, depth_m: float, speed_m_s: float, config: MultilayerConfig) -> Array:
    """Friction at the rupture's speed, cutting force of the next layer, its slope; force; ones.

    The speed is smoothed by a line: noise in a regressor would let the other columns take over.
    """
    reach, speed = side[:, DEPTH] - depth_m, side[:, SPEED]
    coulomb = config.coulomb_fraction(speed_m_s)
    x = reach - reach.mean()
    change = float(x @ speed) / max(float(x @ x), 1e-18)
    smooth = speed.mean() + change * x
    onset = np.minimum(reach / config.cutting_onset_m, 1.0)
    design = np.empty((len(side), 5))
    design[:, 0] = coulomb + (1.0 - coulomb) * smooth / max(speed_m_s, 1e-6)
    design[:, 1] = onset * (2.0 - onset)
    design[:, 2], design[:, 3], design[:, 4] = 1e3 * reach, side[:, FORCE], 1.0
    return design


def _cutting_prior(design: Array, weight: Array, config: MultilayerConfig) -> float:
    """Expected cutting force of the next layer, from how fast its force grows.

    A layer that hardly pushes back hardly resists cutting either; free air does neither.
    """
    line, force = design[:, [0, 2]], design[:, 3]
    normal = line.T @ (line * weight[:, None]) + _RIDGE * np.eye(2)
    covariance = np.linalg.inv(normal)
    slope = float((covariance @ (line.T @ (weight * force)))[1])
    reach = 1e3 * config.cutting_reach_m
    return max(reach * slope, reach * math.sqrt(covariance[1, 1]), 1e-6)


def _windows(design: Array, weighted: Array, cutting_N: float, latest: int) -> tuple[Any, Any]:
    """Weighted least squares over the points from `latest` on, and from ever earlier ones on.

    Returns:
        Of every window: friction, cutting force (near `cutting_N`, never negative) and slope; and
        their covariance, row by row.
    """
    products = weighted[:, :3, None] * design[:, None, :4]
    sums = np.cumsum(products[::-1], axis=0)[len(design) - 1 - latest :: _CHUNK]
    normal = sums[:, :, :3] + np.diag([_RIDGE, cutting_N**-2, _RIDGE])
    target = sums[:, :, 3].copy()
    target[:, 1] += 1.0 / cutting_N
    covariance = np.asarray(np.linalg.inv(normal), dtype=float)
    solution = (covariance @ target[:, :, None])[:, :, 0]
    without = solution[:, 1] < 0.0
    if without.any():
        inner = np.linalg.inv(normal[without][:, ::2, ::2])
        part = (inner @ target[without][:, ::2, None])[:, :, 0]
        solution[without, 1] = 0.0
        solution[without, ::2] = part
    return solution.tolist(), covariance.tolist()


def _first_undisturbed(solutions: Any, covariances: Any, weighted: Array) -> int:
    """Which window is the longest that the release does not reach into."""
    chunks = weighted.reshape(-1, _CHUNK, 5).sum(axis=1)[::-1]
    used, lifted = 0, 0
    for k, (*sums, blocks) in enumerate(chunks.tolist()):
        # Plain floats: three numbers are too few for arrays to be worth it.
        x, y, z, force = (total / blocks for total in sums)
        a, b, c = solutions[used]
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = covariances[used]
        variance = x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + zz * z * z
        surprise = force - (x * a + y * b + z * c)
        limit = _AGREEMENT * math.sqrt(max(variance, 0.0) + 1.0 / blocks)
        lifted = lifted + 1 if surprise > limit else 0
        if lifted == 2:
            break
        used = used if lifted else k + 1
    return max(used - 1, 0)


# Whether the rupture ended a layer.

_TOP_BEFORE_M = 0.3e-3
_WITHIN_M = 2.5e-3
_LEAST_NEAR = 6
_TOP, _FOOT = 0.1, 0.8
"""Fractions of the fall between which it is measured."""
_SHARPNESS = 5.5
"""Log-odds per factor e of travel: both kinds scatter by a factor 1.65 about 0.25 and 1 mm."""
_MOST_LOG_ODDS = 6.0
_END_DROP, _END_DROP_STD = 0.5, 0.25
"""Fraction of the force that falls at the end of a layer: about half of it is at the tip."""
_PARTIAL_DROP = 0.2
"""Mean fraction that falls in a partial rupture; small ones are the most frequent."""
_RARE = 1e-4
_ENDS_SEEN = 4.0
"""Ends of layers assumed seen per partial rupture, before anything is known of the tissue."""


class ResidualTipForce(NamedTuple):
    """Tip force that a rupture leaves."""

    mean_N: float = 0.0  # Expected
    variance: float = 0.0  # Its variance [N^2]


NO_RESIDUAL_FORCE = ResidualTipForce()
"""A tip that is free."""


class RuptureMeasurement(NamedTuple):
    """Forces at the end of a layer and what they say about the next."""

    boundary: Boundary  # Where the layer ends, and the force there, tip force included
    is_one_law: bool  # Whether the layer's force obeyed one law up to the rupture
    # Force after the rupture less all tip force: friction up to this layer, and of the next one on
    # the length that was pushed in
    after_N: float
    after_var: float  # Its variance [N^2]
    drop_N: float  # Force released by the rupture, equation (10)
    drop_std_N: float  # Its standard deviation
    next_slope_N_per_mm: float  # Growth of the force in the next layer
    # Length of the next layer on the shaft when its membrane had been punctured
    pushed_in_mm: float
    end_probability: float  # How likely the rupture ended a layer
    residual: ResidualTipForce  # Tip force that it left if not

    @property
    def friction_N(self) -> float:
        """Force after the rupture less the expected tip force."""
        return self.after_N - self.residual.mean_N

    @property
    def friction_var(self) -> float:
        """Variance of that [N^2]."""
        return self.after_var + self.residual.variance


def measure_end(
    points: Array,
    search: MembraneSearch,
    rupture: Rupture,
    before: tuple[float, float],
    after: ForceAfter,
    earlier: Sequence[float],
    config: MultilayerConfig,
) -> RuptureMeasurement:
    """Measure the end of a layer, and what its rupture may have left at the tip."""
    before_N, before_var = before
    here = Boundary(rupture.depth_m, 0.0, before_N, before_var, rupture.speed_m_s)
    boundary, drop_N = search.boundary or here, before_N - after.force_N
    travel_m = release_travel_m(points, rupture.depth_m, after.force_N)
    fallen = drop_N / max(drop_N + after.force_N, 1e-6)
    probability = end_probability(travel_m, fallen, earlier, config)
    return RuptureMeasurement(
        boundary=boundary,
        is_one_law=search.is_one_law,
        after_N=after.force_N,
        after_var=after.variance,
        drop_N=drop_N,
        drop_std_N=math.sqrt(before_var + after.variance),
        next_slope_N_per_mm=after.slope_N_per_mm,
        pushed_in_mm=MM * (rupture.depth_m - boundary.depth_m),
        end_probability=probability,
        residual=residual_tip_force(after.force_N, probability, config),
    )


def release_travel_m(points: Array, depth_m: float, after_N: float) -> float:
    """Travel from a tenth to four fifths of the fall after a rupture; nan with too few points."""
    depth = points[:, DEPTH]
    near = (depth > depth_m - _TOP_BEFORE_M) & (depth < depth_m + _WITHIN_M)
    depth = depth[near]
    if len(depth) < _LEAST_NEAR or depth[-1] <= depth_m:
        return math.nan
    force = points[near, FORCE]
    padded = np.concatenate((force[:1], force, force[-1:]))
    force = (padded[:-2] + force + padded[2:]) / 3.0
    foot = int(np.argmin(np.where(depth > depth_m, force, np.inf)))
    force = force[: foot + 1]
    top = float(force.max())
    bottom = min(max(float(force[foot]), after_N), top)
    begin = int(np.flatnonzero(force >= top - _TOP * (top - bottom))[-1])
    end = begin + int(np.argmax(force[begin:] <= top - _FOOT * (top - bottom)))
    return float(depth[end] - depth[begin])


def end_probability(
    travel_m: float, drop_fraction: float, earlier: Sequence[float], config: MultilayerConfig
) -> float:
    """How likely a rupture ended a layer.

    Args:
        travel_m: Of its release, see `release_travel_m`; nan if not known.
        drop_fraction: Fraction of the force that fell.
        earlier: The same probability of the ruptures before: tissue that has ruptured partially
            does so again.
        config: Settings.
    """
    log_odds = _MOST_LOG_ODDS
    if math.isfinite(travel_m):
        log_odds = _SHARPNESS * math.log(config.partial_rupture_travel_m / max(travel_m, 1e-6))
    log_odds = min(max(log_odds, -_MOST_LOG_ODDS), _MOST_LOG_ODDS)
    off = (drop_fraction - _END_DROP) / _END_DROP_STD
    end = math.exp(-0.5 * off * off) / (_END_DROP_STD * math.sqrt(2.0 * math.pi))
    partial = math.exp(-max(drop_fraction, 0.0) / _PARTIAL_DROP) / _PARTIAL_DROP
    log_odds += math.log(max(end, _RARE) / max(partial, _RARE))
    ends = sum(earlier)
    log_odds += math.log((_ENDS_SEEN + ends) / (1.0 + len(earlier) - ends))
    return 1.0 / (1.0 + math.exp(-log_odds))


def residual_tip_force(
    after_N: float, probability: float, config: MultilayerConfig
) -> ResidualTipForce:
    """Tip force after a rupture that ended a layer with that probability."""
    force, partial = max(after_N, 0.0), 1.0 - probability
    rest = (1.0 - config.partial_rupture_friction_fraction) * force
    spread = config.partial_rupture_friction_fraction_std * force
    variance = partial * (spread * spread + probability * rest * rest)
    return ResidualTipForce(partial * rest, variance)


# Whether the force has come back to where it would be had nothing ruptured.

_LATE_FRACTION = 1.0 / 3.0
_LEAST_ON_A_LINE = 8
_CHANCE = 9.0
"""Squared deviations, of level and slope together, that chance reaches once in a hundred."""
_SLOPE_KNOWN = 0.2
"""How well the two slopes must be known, as a fraction of the larger: a fresh layer's cutting force
may also make up for a small fall, only its slope gives it away."""
_RECOVERED = 0.25
"""Fraction of the fall that may be missing at the most, whatever the noise."""


class Line(NamedTuple):
    """Level at zero offset and slope of a line, with their covariance."""

    level: float  # Value at zero
    slope: float  # Growth per offset
    level_var: float  # Variance of the level
    both: float  # Covariance of the two
    slope_var: float  # Variance of the slope


def fit_line(offset: Array, value: Array, weight: Array) -> Line:
    """Weighted least squares in closed form: three sums need no matrices."""
    leaning = weight * offset
    s, x, y = float(weight.sum()), float(leaning.sum()), float(weight @ value)
    xx, xy = float(leaning @ offset), float(leaning @ value)
    determinant = s * xx - x * x
    return Line(
        level=(xx * y - x * xy) / determinant,
        slope=(s * xy - x * y) / determinant,
        level_var=xx / determinant,
        both=-x / determinant,
        slope_var=s / determinant,
    )


def has_recovered(points: Array, depth_m: float, fall_N: float, noise_N2: float) -> bool:
    """Whether the newest points lie on the line through those before the fall, level and slope.

    Where the tip was released the force grows anew, at another rate; a bump in the signal leaves
    the force growing as it did.
    """
    reach = 1e3 * (points[:, DEPTH] - depth_m)
    before = (reach > -1e3 * _BEFORE_M) & (reach < -1e3 * _MARGIN_M)
    late = reach > (1.0 - _LATE_FRACTION) * reach[-1]
    if min(np.count_nonzero(before), np.count_nonzero(late)) < _LEAST_ON_A_LINE:
        return False
    centre = float(reach[late].mean())
    was, now = (
        fit_line(
            reach[side] - centre, points[side, FORCE], points[side, BLOCKS] / max(noise_N2, 1e-12)
        )
        for side in (before, late)
    )
    level_var, slope_var = was.level_var + now.level_var, was.slope_var + now.slope_var
    if math.sqrt(slope_var) > _SLOPE_KNOWN * max(abs(was.slope), abs(now.slope)):
        return False  # another slope could not be distinguished from the same
    level, slope, both = now.level - was.level, now.slope - was.slope, was.both + now.both
    squares = slope_var * level**2 - 2.0 * both * level * slope + level_var * slope**2
    surprise = squares / (level_var * slope_var - both * both)
    return surprise < _CHANCE and abs(level) < _RECOVERED * fall_N
