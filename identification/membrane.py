"""Finds the membrane that was pushed in before a rupture (rupture time differs from exit time).

With a glove or a capsule between two layers the tip reaches the boundary, pushes the membrane in
and punctures it later: t_r is not t_{i+1} (Section II). The boundary shows where the force over
depth leaves its line upwards.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from identification.track import DEPTH, FORCE

_MOST_POINTS = 128
_LEAST_POINTS = 32
_CANDIDATES = 30
_STEEPER = 0.5
_BETTER = 0.75


def membrane_depth(points: NDArray[np.float64], start_m: float, rupture_m: float) -> float | None:
    """Depth at which a membrane began to be pushed in, or None if there was none.

    A line that continues as a parabola must explain the force clearly better than a smooth cubic
    does, and the membrane must add at least half the slope there was: a single non-linear spring,
    as a capsule at the very surface is, has no boundary in it and stays one (fictitious) layer,
    as in Section III-B.

    Args:
        points: Track points, see `track`.
        start_m: Where the layer begins.
        rupture_m: Where the rupture happened.
    """
    depth = points[:, DEPTH]
    side = points[(depth > start_m) & (depth < rupture_m - 5e-5)]
    side = side[:: len(side) // _MOST_POINTS + 1]
    if len(side) < _LEAST_POINTS:
        return None
    length = float(side[-1, DEPTH] - side[0, DEPTH])
    x, force = (side[:, DEPTH] - side[0, DEPTH]) / length, side[:, FORCE]
    line = np.column_stack([np.ones_like(x), x])
    smooth, _ = _fit(np.column_stack([line, x**2, x**3])[None], force)
    starts = np.linspace(0.12, 0.9, _CANDIDATES)
    push = np.maximum(x[None, :] - starts[:, None], 0.0)
    lines = np.broadcast_to(line, (_CANDIDATES, *line.shape))
    errors, solutions = _fit(np.dstack([lines, push[:, :, None], push[:, :, None] ** 2]), force)
    best = int(np.argmin(errors))
    _, slope, bend, curve = solutions[best]
    added = bend + curve * (1.0 - starts[best])
    if errors[best] > _BETTER * smooth[0] or added < _STEEPER * max(slope, 0.0):
        return None
    return float(side[0, DEPTH] + starts[best] * length)


def _fit(
    columns: NDArray[np.float64], force: NDArray[np.float64]
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Least squares of many column sets at once: sums of squares (m,), solutions (m, 4)."""
    transposed = columns.transpose(0, 2, 1)
    normal = transposed @ columns + 1e-9 * np.eye(columns.shape[2])
    solutions = np.linalg.solve(normal, (transposed @ force)[:, :, None])
    residual = force[None, :] - (columns @ solutions)[:, :, 0]
    return np.sum(residual**2, axis=1), solutions[:, :, 0]
