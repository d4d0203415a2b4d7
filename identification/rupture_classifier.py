"""Whether a rupture ended a layer or tore the tissue on: what is left at the tip afterwards.

At the end of a layer the tip force goes to nothing, and the force after the rupture is friction.
Tissue that only tears keeps pushing at the tip; taken for friction, that force would never leave
the estimate again. The two differ in how far the needle travels while the force falls, and in how
much of it falls; neither is certain, so both are weighed.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.estimate import Rupture
from identification.force_drop import ForceAfter
from identification.layer_model import MM
from identification.membrane import Boundary, MembraneSearch
from identification.multilayer_config import MultilayerConfig
from identification.published_identifier import Line, fit_line
from identification.resampling import BLOCKS, DEPTH, FORCE

_BEFORE_M = 0.3e-3
_WITHIN_M = 2.5e-3
_LEAST_POINTS = 6
_TOP, _FOOT = 0.1, 0.8
"""Shares of the fall between which it is measured."""
_SHARPNESS = 5.5
"""Log-odds per factor e of travel: both kinds scatter by a factor 1.65 about 0.25 and 1 mm."""
_MOST_LOG_ODDS = 6.0
_END_DROP, _END_DROP_STD = 0.5, 0.25
"""Share of the force that falls at the end of a layer: about half of it is at the tip."""
_TEAR_DROP = 0.2
"""Mean share that falls when tissue tears; small tears are the most frequent."""
_RARE = 1e-4
_ENDS_SEEN = 4.0
"""Ends believed to have been seen per tear, before anything is known of the tissue."""


class ResidualTipForce(NamedTuple):
    """Tip force after a rupture.

    Attributes:
        mean_N: Expected.
        variance: Its variance [N^2].
    """

    mean_N: float = 0.0
    variance: float = 0.0


NO_RESIDUAL_FORCE = ResidualTipForce()
"""A tip that is free."""


def release_travel_m(points: NDArray[np.float64], depth_m: float, after_N: float) -> float:
    """Travel from a tenth to four fifths of the fall after a rupture; nan with too few points.

    Args:
        points: Track points, see `track`.
        depth_m: Depth of the rupture.
        after_N: Force after it: the fall goes no lower, what lies below is noise.
    """
    depth = points[:, DEPTH]
    near = (depth > depth_m - _BEFORE_M) & (depth < depth_m + _WITHIN_M)
    depth = depth[near]
    if len(depth) < _LEAST_POINTS or depth[-1] <= depth_m:
        return math.nan
    force = _smooth(points[near, FORCE])
    foot = int(np.argmin(np.where(depth > depth_m, force, np.inf)))
    force = force[: foot + 1]
    top = float(force.max())
    bottom = min(max(float(force[foot]), after_N), top)
    begin = int(np.flatnonzero(force >= top - _TOP * (top - bottom))[-1])
    end = begin + int(np.argmax(force[begin:] <= top - _FOOT * (top - bottom)))
    return float(depth[end] - depth[begin])


def _smooth(force: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mean of each point and its neighbours; the ends are their own."""
    padded = np.empty(len(force) + 2)
    padded[0], padded[1:-1], padded[-1] = force[0], force, force[-1]
    return (padded[:-2] + force + padded[2:]) / 3.0


def end_probability(
    travel_m: float, drop_share: float, earlier: Sequence[float], config: MultilayerConfig
) -> float:
    """How likely a rupture ended a layer.

    Args:
        travel_m: Of its release, see `release_travel_m`; nan if not known.
        drop_share: Share of the force that fell.
        earlier: The same probability of the ruptures before: tissue that has torn tears again.
        config: Settings.
    """
    log_odds = _MOST_LOG_ODDS
    if math.isfinite(travel_m):
        log_odds = _SHARPNESS * math.log(config.tear_travel_m / max(travel_m, 1e-6))
    log_odds = min(max(log_odds, -_MOST_LOG_ODDS), _MOST_LOG_ODDS)
    off = (drop_share - _END_DROP) / _END_DROP_STD
    end = math.exp(-0.5 * off * off) / (_END_DROP_STD * math.sqrt(2.0 * math.pi))
    tear = math.exp(-max(drop_share, 0.0) / _TEAR_DROP) / _TEAR_DROP
    log_odds += math.log(max(end, _RARE) / max(tear, _RARE))
    ends = sum(earlier)
    log_odds += math.log((_ENDS_SEEN + ends) / (1.0 + len(earlier) - ends))
    return 1.0 / (1.0 + math.exp(-log_odds))


def held_force(after_N: float, probability: float, config: MultilayerConfig) -> ResidualTipForce:
    """Tip force after a rupture that ended a layer with that probability.

    Args:
        after_N: Axial force after it, without what the next layer adds.
        probability: See `end_probability`.
        config: Settings.
    """
    force, torn = max(after_N, 0.0), 1.0 - probability
    rest, spread = (1.0 - config.tear_share) * force, config.tear_share_std * force
    return ResidualTipForce(torn * rest, torn * (spread * spread + probability * rest * rest))


# How a layer ended, measured on the track around its rupture.


@dataclass(frozen=True, slots=True, kw_only=True)
class RuptureMeasurement:
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
        end_probability: How likely the rupture ended a layer, see `tear`.
        held: Tip force that it left if not.
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
    held: ResidualTipForce = NO_RESIDUAL_FORCE

    @property
    def friction_N(self) -> float:
        """Force after the rupture less what is believed to be held at the tip."""
        return self.after_N - self.held.mean_N

    @property
    def friction_var(self) -> float:
        """Variance of that [N^2]."""
        return self.after_var + self.held.variance


def layer_ending(
    points: NDArray[np.float64],
    search: MembraneSearch,
    rupture: Rupture,
    before: tuple[float, float],
    after: ForceAfter,
) -> RuptureMeasurement:
    """Measure the end of a layer.

    Args:
        points: Track points, see `track`.
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


def weigh_tear(
    ending: RuptureMeasurement, earlier: Sequence[float], config: MultilayerConfig
) -> RuptureMeasurement:
    """The same ending with what the rupture may have left at the tip.

    Args:
        ending: As measured.
        earlier: How likely each rupture before ended a layer.
        config: Settings.
    """
    share = ending.drop_N / max(ending.drop_N + ending.after_N, 1e-6)
    probability = end_probability(ending.release_m, share, earlier, config)
    held = held_force(ending.after_N, probability, config)
    return replace(ending, end_probability=probability, held=held)


# Whether the force has come back to where it would be had nothing given way.


_BEFORE_M_made_good = 2e-3
_MARGIN_M = 2e-5
_LATE_SHARE = 1.0 / 3.0
_LEAST_POINTS_made_good = 8
_CHANCE = 9.0
"""Squared deviations, of level and slope together, that chance reaches once in a hundred."""
_TOLD = 0.2
"""How well the two slopes must be known, as a share of the larger: a fresh layer's cutting force
may also make a small fall good, only its slope gives it away."""
_SHARE = 0.25
"""Share of the fall that must have been made good at the least, whatever the noise."""


def is_made_good(
    points: NDArray[np.float64], depth_m: float, fall_N: float, noise_N2: float
) -> bool:
    """Whether the newest points lie on the line through those before the fall, level and slope.

    A tissue that has let go of the tip grows its force anew, at another rate; a bump in the
    signal leaves the force growing as it did.

    Args:
        points: Track points, see `track`.
        depth_m: Depth of the fall.
        fall_N: How far the force fell.
        noise_N2: Long-run variance of one block.
    """
    reach = 1e3 * (points[:, DEPTH] - depth_m)
    before = (reach > -1e3 * _BEFORE_M_made_good) & (reach < -1e3 * _MARGIN_M)
    late = reach > (1.0 - _LATE_SHARE) * reach[-1]
    if min(np.count_nonzero(before), np.count_nonzero(late)) < _LEAST_POINTS_made_good:
        return False
    centre = float(reach[late].mean())
    was = _line(reach[before] - centre, points[before], noise_N2)
    now = _line(reach[late] - centre, points[late], noise_N2)
    level_var, slope_var = was.level_var + now.level_var, was.slope_var + now.slope_var
    if math.sqrt(slope_var) > _TOLD * max(abs(was.slope), abs(now.slope)):
        return False  # another slope could not be told from the same
    level, slope, both = now.level - was.level, now.slope - was.slope, was.both + now.both
    squares = slope_var * level**2 - 2.0 * both * level * slope + level_var * slope**2
    surprise = squares / (level_var * slope_var - both * both)
    return surprise < _CHANCE and abs(level) < _SHARE * fall_N


def _line(offset_mm: NDArray[np.float64], side: NDArray[np.float64], noise_N2: float) -> Line:
    return fit_line(offset_mm, side[:, FORCE], side[:, BLOCKS] / max(noise_N2, 1e-12))
