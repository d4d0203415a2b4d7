"""Finds the membrane that was pushed in before a rupture (rupture time differs from exit time).

With a glove or a capsule between two layers the tip reaches the boundary, pushes the membrane in
and punctures it later: t_r is not t_{i+1} (Section II). The boundary shows as a kink upwards of
the force over depth.
"""

import numpy as np
from numpy.typing import NDArray

from identification.track import DEPTH, FORCE

_LEAST_POINTS = 40
_MARGIN = 12
_STRIDE = 4
_STEEPER = 1.5
_BETTER = 0.6


def _residual(columns: NDArray[np.float64], force: NDArray[np.float64]) -> tuple[float, float]:
    """Sum of squares, and the jump of slope (last but one coefficient), of a least squares."""
    solution, *_ = np.linalg.lstsq(columns, force, rcond=None)
    return float(np.sum((force - columns @ solution) ** 2)), float(solution[2])


def membrane_depth(points: NDArray[np.float64], start_m: float, rupture_m: float) -> float | None:
    """Depth at which a membrane began to be pushed in, or None if there was none.

    A line that continues as a steeper parabola must explain the force clearly better than a
    smooth cubic does: a single non-linear spring, as a capsule at the very surface is, has no
    boundary in it and stays one (fictitious) layer, as in Section III-B.

    Args:
        points: Track points, see `track`.
        start_m: Where the layer begins.
        rupture_m: Where the rupture happened.
    """
    depth = points[:, DEPTH]
    side = points[(depth > start_m) & (depth < rupture_m - 5e-5)]
    if len(side) < _LEAST_POINTS:
        return None
    x = 1e3 * (side[:, DEPTH] - side[0, DEPTH])
    force = side[:, FORCE]
    line = np.column_stack([np.ones_like(x), x])
    smooth, _ = _residual(np.column_stack([line, x**2, x**3]), force)
    best, where, steeper = smooth, None, 0.0
    for index in range(_MARGIN, len(x) - _MARGIN, _STRIDE):
        push = np.maximum(x - x[index], 0.0)
        error, jump = _residual(np.column_stack([line, push, push**2]), force)
        if error < best:
            best, where, steeper = error, index, jump
    if where is None or best > _BETTER * smooth:
        return None
    slope = float(np.polyfit(x[: where + 1], force[: where + 1], 1)[0])
    return float(side[where, DEPTH]) if steeper > _STEEPER * max(slope, 0.0) else None
