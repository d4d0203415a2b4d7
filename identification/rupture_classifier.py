"""Whether a rupture ended a layer, was a partial one, or none: what is left at the tip afterwards.

At the end of a layer the tip force goes to nothing, and the force after the rupture is friction.
After a partial rupture the tissue keeps pushing at the tip; taken for friction, that force would
never leave the estimate again. The two differ in how far the needle travels while the force falls,
and in how much of it falls; neither is certain, so both are weighed.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.config import MultilayerConfig
from identification.estimate import Rupture
from identification.force_drop import ForceAfter
from identification.layer_model import MM
from identification.membrane import Boundary, MembraneSearch
from identification.resampling import BLOCKS, DEPTH, FORCE

_BEFORE_M = 0.3e-3
_WITHIN_M = 2.5e-3
_LEAST_POINTS = 6
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

Array = NDArray[np.float64]


class ResidualTipForce(NamedTuple):
    """Tip force that a rupture leaves.

    Attributes:
        mean_N: Expected.
        variance: Its variance [N^2].
    """

    mean_N: float = 0.0
    variance: float = 0.0


NO_RESIDUAL_FORCE = ResidualTipForce()
"""A tip that is free."""


class RuptureMeasurement(NamedTuple):
    """Forces at the end of a layer and what they say about the next.

    Attributes:
        boundary: Where the layer ends, and the force there, tip force included.
        has_membrane: Whether that is before the rupture.
        is_one_law: Whether the layer's force obeyed one law up to the rupture.
        after_N: Force after the rupture less all tip force: friction up to this layer, and of the
            next one on the length that was pushed in.
        after_var: Its variance [N^2].
        drop_N: Force released by the rupture, equation (10).
        drop_std_N: Its standard deviation.
        next_slope_N_per_mm: Growth of the force in the next layer.
        pushed_in_mm: Length of the next layer on the shaft when its membrane had been punctured.
        release_m: Travel over which the force fell; nan if not known.
        end_probability: How likely the rupture ended a layer.
        residual: Tip force that it left if not.
    """

    boundary: Boundary
    has_membrane: bool
    is_one_law: bool
    after_N: float
    after_var: float
    drop_N: float
    drop_std_N: float
    next_slope_N_per_mm: float
    pushed_in_mm: float
    release_m: float
    end_probability: float = 1.0
    residual: ResidualTipForce = NO_RESIDUAL_FORCE

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
) -> RuptureMeasurement:
    """Measure the end of a layer, as if the rupture had ended it for sure.

    Args:
        points: Points of the track.
        search: What was found of a membrane before its rupture.
        rupture: Its rupture.
        before: Force before that, and its variance [N^2].
        after: Force after it.
    """
    before_N, before_var = before
    here = Boundary(rupture.depth_m, 0.0, before_N, before_var, rupture.speed_m_s)
    boundary = here if search.boundary is None else search.boundary
    return RuptureMeasurement(
        boundary=boundary,
        has_membrane=search.boundary is not None,
        is_one_law=search.is_one_law,
        after_N=after.force_N,
        after_var=after.variance,
        drop_N=before_N - after.force_N,
        drop_std_N=math.sqrt(before_var + after.variance),
        next_slope_N_per_mm=after.slope_N_per_mm,
        pushed_in_mm=MM * (rupture.depth_m - boundary.depth_m),
        release_m=release_travel_m(points, rupture.depth_m, after.force_N),
    )


def weigh_partial_rupture(
    measured: RuptureMeasurement, earlier: Sequence[float], config: MultilayerConfig
) -> RuptureMeasurement:
    """The same end with what the rupture may have left at the tip.

    Args:
        measured: See `measure_end`.
        earlier: How likely each rupture before ended a layer.
        config: Settings.
    """
    fallen = measured.drop_N / max(measured.drop_N + measured.after_N, 1e-6)
    probability = end_probability(measured.release_m, fallen, earlier, config)
    residual = residual_tip_force(measured.after_N, probability, config)
    return measured._replace(end_probability=probability, residual=residual)


def release_travel_m(points: Array, depth_m: float, after_N: float) -> float:
    """Travel from a tenth to four fifths of the fall after a rupture; nan with too few points.

    Args:
        points: Points of the track.
        depth_m: Depth of the rupture.
        after_N: Force after it: the fall goes no lower, what lies below is noise.
    """
    depth = points[:, DEPTH]
    near = (depth > depth_m - _BEFORE_M) & (depth < depth_m + _WITHIN_M)
    depth = depth[near]
    if len(depth) < _LEAST_POINTS or depth[-1] <= depth_m:
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
    """Tip force after a rupture that ended a layer with that probability.

    Args:
        after_N: Axial force after it, without what the next layer adds.
        probability: See `end_probability`.
        config: Settings.
    """
    force, partial = max(after_N, 0.0), 1.0 - probability
    rest = (1.0 - config.partial_rupture_friction_fraction) * force
    spread = config.partial_rupture_friction_fraction_std * force
    variance = partial * (spread * spread + probability * rest * rest)
    return ResidualTipForce(partial * rest, variance)


# Whether the force has come back to where it would be had nothing ruptured.

_LINE_M = 2e-3
_MARGIN_M = 2e-5
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
    """Level at zero offset and slope of a line, with their covariance.

    Attributes:
        level: Value at zero.
        slope: Growth per offset.
        level_var: Variance of the level.
        both: Covariance of the two.
        slope_var: Variance of the slope.
    """

    level: float
    slope: float
    level_var: float
    both: float
    slope_var: float


def fit_line(offset: Array, value: Array, weight: Array) -> Line:
    """Weighted least squares in closed form: three sums need no matrices.

    Args:
        offset: Shape (n,), at least two different ones.
        value: Shape (n,).
        weight: Inverse variances, shape (n,).
    """
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

    Args:
        points: Points of the track.
        depth_m: Depth of the fall.
        fall_N: How far the force fell.
        noise_N2: Long-run variance of one block.
    """
    reach = 1e3 * (points[:, DEPTH] - depth_m)
    before = (reach > -1e3 * _LINE_M) & (reach < -1e3 * _MARGIN_M)
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
