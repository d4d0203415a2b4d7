"""Whether a rupture ended a layer or tore the tissue on: what is left at the tip afterwards.

At the end of a layer the tip force goes to nothing, and the force after the rupture is friction.
Tissue that only tears keeps pushing at the tip; taken for friction, that force would never leave
the estimate again. The two differ in how far the needle travels while the force falls, and in how
much of it falls; neither is certain, so both are weighed.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.track import DEPTH, FORCE

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


class Held(NamedTuple):
    """Tip force after a rupture.

    Attributes:
        mean_N: Expected.
        variance: Its variance [N^2].
    """

    mean_N: float = 0.0
    variance: float = 0.0


NOTHING_HELD = Held()
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
    travel_m: float, drop_share: float, earlier: Sequence[float], config: DefaultConfig
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


def held_force(after_N: float, probability: float, config: DefaultConfig) -> Held:
    """Tip force after a rupture that ended a layer with that probability.

    Args:
        after_N: Axial force after it, without what the next layer adds.
        probability: See `end_probability`.
        config: Settings.
    """
    force, torn = max(after_N, 0.0), 1.0 - probability
    rest, spread = (1.0 - config.tear_share) * force, config.tear_share_std * force
    return Held(torn * rest, torn * (spread * spread + probability * rest * rest))
