"""Fits a membrane's spring behind each boundary that a layer may have had.

Seven unknowns: level, slope and bend of the layer up to the boundary, its change with speed (level
and slope), and a straight and a parabolic part of the spring beyond.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.membrane_layer import ScaledLayer

_CANDIDATES = 40
_REACH = (0.08, 0.96)
"""Shares of the layer's length between which a boundary is looked for."""
_PARABOLA, _LINE = (0, 1, 2, 3, 4, 6), (0, 1, 2, 3, 4, 5)

Array = NDArray[np.float64]

STARTS = np.linspace(*_REACH, _CANDIDATES)
"""Candidate boundaries, as shares of the layer's length."""
STARTS.setflags(write=False)


class MembraneFits(NamedTuple):
    """Best membrane for each of some candidate boundaries.

    Attributes:
        squares: Sums of squares, infinite where no spring pushes, shape (m,).
        solutions: The seven unknowns, shape (m, 7).
    """

    squares: Array
    solutions: Array


def fit_membranes(layer: ScaledLayer, starts: Array) -> MembraneFits:
    """The best of three springs per candidate, none of which may pull: mixed, parabola, line.

    A straight spring must be steeper than the layer by half, or it is a bend of the layer.

    Args:
        layer: The layer.
        starts: Candidates, some of `STARTS`.
    """
    normal, vector = _normal_equations(layer, starts)
    total = float(layer.target @ layer.target)
    squares, solutions = _solve(normal, vector, total)
    squares[(solutions[:, 5] < 0.0) | (solutions[:, 6] < 0.0)] = np.inf
    for kept in (_PARABOLA, _LINE):
        index = np.array(kept)
        other, part = _solve(normal[:, index[:, None], index], vector[:, index], total)
        least = 1.5 * part[:, 1] if kept is _LINE else 0.0
        other[part[:, 5] < least] = np.inf
        is_better = np.flatnonzero(other < squares)
        squares[is_better] = other[is_better]
        solutions[is_better] = 0.0
        solutions[is_better[:, None], index] = part[is_better]
    return MembraneFits(squares, solutions)


def unit_covariance(layer: ScaledLayer, start: float) -> Array:
    """Covariance of the unknowns behind one candidate, for a variance of one; shape (7, 7)."""
    normal, _ = _normal_equations(layer, np.array([start]))
    return np.asarray(np.linalg.inv(normal[0]), dtype=float)


def _normal_equations(layer: ScaledLayer, starts: Array) -> tuple[Array, Array]:
    """Matrices (m, 7, 7) and vectors (m, 7), priors included."""
    u, v = layer.position, layer.speed
    inside = np.minimum(u, starts[:, None])
    pushed = u - inside
    columns = np.empty((*inside.shape, 7))
    columns[:, :, 0], columns[:, :, 3] = 1.0, v
    columns[:, :, 1], columns[:, :, 2], columns[:, :, 4] = inside, inside * inside, v * inside
    columns[:, :, 5], columns[:, :, 6] = pushed, pushed * pushed
    columns *= layer.root_weight[:, None]
    transposed = columns.transpose(0, 2, 1)
    return transposed @ columns + np.diag(layer.priors), transposed @ layer.target


def _solve(normal: Array, vector: Array, total: float) -> tuple[Array, Array]:
    part = np.asarray(np.linalg.solve(normal, vector[:, :, None])[:, :, 0], dtype=float)
    return total - np.sum(part * vector, axis=1), part
