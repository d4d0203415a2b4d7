"""Whether the force has come back to where it would be had nothing given way."""

import numpy as np
from numpy.typing import NDArray

from identification.track import BLOCKS, DEPTH, FORCE

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
    was, was_covariance = _line(reach[before] - centre, points[before], noise_N2)
    now, now_covariance = _line(reach[late] - centre, points[late], noise_N2)
    change, covariance = now - was, was_covariance + now_covariance
    if float(np.sqrt(covariance[1, 1])) > _TOLD * float(np.max(np.abs((was[1], now[1])))):
        return False  # another slope could not be told from the same
    surprise = float(change @ np.linalg.solve(covariance, change))
    return surprise < _CHANCE and abs(float(change[0])) < _SHARE * fall_N


def _line(
    offset_mm: NDArray[np.float64], side: NDArray[np.float64], noise_N2: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Level at zero offset and slope, with their covariance."""
    columns = np.ones((len(offset_mm), 2))
    columns[:, 1] = offset_mm
    weight = side[:, BLOCKS] / max(noise_N2, 1e-12)
    normal = columns.T @ (columns * weight[:, None])
    covariance = np.asarray(np.linalg.inv(normal), dtype=float)
    return covariance @ (columns.T @ (weight * side[:, FORCE])), covariance
