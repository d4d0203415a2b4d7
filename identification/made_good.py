"""Whether the force has come back to where it would be had nothing given way."""

import math

import numpy as np
from numpy.typing import NDArray

from identification.track import BLOCKS, DEPTH, FORCE
from identification.weighted_line import Line, fit_line

_BEFORE_M = 2e-3
_MARGIN_M = 2e-5
_LATE_SHARE = 1.0 / 3.0
_LEAST_POINTS = 8
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
    before = (reach > -1e3 * _BEFORE_M) & (reach < -1e3 * _MARGIN_M)
    late = reach > (1.0 - _LATE_SHARE) * reach[-1]
    if min(np.count_nonzero(before), np.count_nonzero(late)) < _LEAST_POINTS:
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
