"""Finds the membrane that was pushed in before a rupture (rupture time differs from exit time).

With a glove or a capsule between two layers the tip reaches the boundary, pushes the membrane in
and punctures it later: t_r is not t_{i+1} (Section II). Up to the boundary the force of the layer
grows; from there on the layer's own part stays and the membrane is a spring, in general a
non-linear one (a parabola: Okamura, Simone, O'Leary 2004).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.layer_rows import merge_rows
from identification.track import BLOCKS, DEPTH, FORCE, SPEED, TRAVEL

_MOST_ROWS = 64
_LEAST_ROWS = 12
_CANDIDATES = 40
_REACH = (0.08, 0.96)
"""Shares of the layer's length between which a boundary is looked for."""
_MARGIN_M = 5e-5
_EVIDENCE = 30.0
"""Gain of log-likelihood, twice, over a smooth cubic: five to six standard deviations."""
_BETTER = 0.75
"""Share of the cubic's sum of squares that must not be exceeded: with little noise any tissue is
significantly no cubic."""
_CURVATURE = 0.2
"""Bend of a layer's force over its slope, one standard deviation (tissue stiffens by 0 to 30 %)."""
_SPEED_SHARE = 0.5
"""Change of force with speed over mean force, one standard deviation: friction, part viscous."""
_FREE = 1e-9
_PARABOLA, _LINE = (0, 1, 2, 3, 4, 6), (0, 1, 2, 3, 4, 5)
_STARTS = np.linspace(*_REACH, _CANDIDATES)

Array = NDArray[np.float64]


class Boundary(NamedTuple):
    """Where a layer ended.

    Attributes:
        depth_m: Depth: that of its rupture, or where its membrane began to be pushed in.
        std_m: Its standard deviation.
        force_N: Force there.
        force_var: Its variance [N^2].
        speed_m_s: Speed there.
    """

    depth_m: float
    std_m: float
    force_N: float
    force_var: float
    speed_m_s: float


class _Layer(NamedTuple):
    """Rows of a layer, scaled: position 0 to 1, speed about its mean, root of weights."""

    position: Array
    speed: Array
    root_weight: Array
    target: Array
    slope: float
    force: float


class _Fits(NamedTuple):
    """Best membrane for each candidate boundary: sums of squares (m,), solutions (m, 7)."""

    squares: Array
    solutions: Array


def find_membrane(rows: Array, start_m: float, rupture_m: float) -> Boundary | None:
    """Where the membrane that a layer ended with began, or None if there was none.

    Its force must explain the layer much better than a smooth cubic does: a single non-linear
    spring, as a capsule at the very surface is, has no boundary in it and stays one (fictitious)
    layer, as in Section III-B.

    Args:
        rows: Rows of the layer, see `layer_rows`.
        start_m: Depth from which on the layer was met undisturbed.
        rupture_m: Where the rupture happened.
    """
    end = rows[:, DEPTH] + 0.5 * rows[:, TRAVEL]
    side = rows[(rows[:, DEPTH] > start_m) & (end < rupture_m - _MARGIN_M)]
    side = merge_rows(side, -(-len(side) // _MOST_ROWS)) if len(side) else side
    if len(side) < _LEAST_ROWS:
        return None
    layer = _scaled(side)
    columns = _membrane_columns(layer, _STARTS)
    transposed = columns.transpose(0, 2, 1)
    gram, vector = transposed @ columns, transposed @ layer.target
    priors = _priors(layer, max(0.5 * float(np.var(np.diff(layer.target))), 1e-12))
    normal = gram + np.diag(priors)
    fits = _fit_membranes(normal, vector, float(layer.target @ layer.target))
    best = int(np.argmin(fits.squares))
    if not np.isfinite(fits.squares[best]):
        return None
    variance = max(float(fits.squares[best]), 1e-12) / (len(side) - len(priors))
    smooth = _smooth_squares(layer, priors)
    evidence = (smooth - fits.squares[best]) / variance
    if evidence < _EVIDENCE or fits.squares[best] > _BETTER * smooth:
        return None
    if not _is_steeper(fits.solutions[best], 1.0 - _STARTS[best]):
        return None
    covariance = variance * np.linalg.inv(normal[best])
    return _membrane(side, fits, variance, covariance)


def _scaled(side: Array) -> _Layer:
    depth, force = side[:, DEPTH], side[:, FORCE]
    position = (depth - depth[0]) / (depth[-1] - depth[0])
    weight = np.sqrt(side[:, BLOCKS] / side[:, BLOCKS].mean())
    half = len(side) // 2
    begin = position[:half] - position[:half].mean()
    rise = float(begin @ force[:half]) / float(begin @ begin)
    mean = float(force.mean())
    return _Layer(
        position=position,
        speed=side[:, SPEED] / max(float(side[:, SPEED].mean()), 1e-6) - 1.0,
        root_weight=weight,
        target=(force - mean) * weight,
        slope=max(rise, 0.1 * float(np.ptp(force)), 1e-3),
        force=max(abs(mean), 0.02),
    )


def _membrane_columns(layer: _Layer, starts: Array) -> Array:
    """Level, slope and bend up to the boundary, speed, and the membrane's spring beyond it."""
    u, v = layer.position, layer.speed
    inside = np.minimum(u, starts[:, None])
    pushed = u - inside
    columns = np.empty((*inside.shape, 7))
    columns[:, :, 0], columns[:, :, 3] = 1.0, v
    columns[:, :, 1], columns[:, :, 2], columns[:, :, 4] = inside, inside * inside, v * inside
    columns[:, :, 5], columns[:, :, 6] = pushed, pushed * pushed
    columns *= layer.root_weight[:, None]
    return columns


def _priors(layer: _Layer, variance: float) -> Array:
    weights = np.full(7, _FREE)
    weights[2] += variance / (_CURVATURE * layer.slope) ** 2
    weights[3:5] += variance / (_SPEED_SHARE * layer.force) ** 2
    return weights


def _smooth_squares(layer: _Layer, priors: Array) -> float:
    u, v = layer.position, layer.speed
    columns = np.stack([np.ones_like(u), u, u**2, v, v * u, u**3], axis=1)
    columns = columns * layer.root_weight[:, None]
    weights = np.array([_FREE, _FREE, _FREE, priors[3], priors[4], _FREE])
    vector = columns.T @ layer.target
    solution = np.linalg.solve(columns.T @ columns + np.diag(weights), vector)
    return float(layer.target @ layer.target - vector @ solution)


def _fit_membranes(normal: Array, vector: Array, total: float) -> _Fits:
    """The best of three springs per candidate, none of which may pull: mixed, parabola, line.

    A straight spring must be steeper than the layer by half, or it is a bend of the layer.
    """
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
    return _Fits(squares, solutions)


def _solve(normal: Array, vector: Array, total: float) -> tuple[Array, Array]:
    part = np.asarray(np.linalg.solve(normal, vector[:, :, None])[:, :, 0], dtype=float)
    return total - np.sum(part * vector, axis=1), part


def _is_steeper(solution: Array, reach: float) -> bool:
    """Whether the membrane at its puncture pushes back more steeply than the layer did."""
    return float(solution[5] + 2.0 * solution[6] * reach) > max(float(solution[1]), 0.0)


def _membrane(side: Array, fits: _Fits, variance: float, covariance: Array) -> Boundary:
    """Mean of the candidates by their likelihood, and the spread of it."""
    best = int(np.argmin(fits.squares))
    likelihood = np.exp(-0.5 * (fits.squares - fits.squares[best]) / variance)
    likelihood /= likelihood.sum()
    length = float(side[-1, DEPTH] - side[0, DEPTH])
    start = float(likelihood @ _STARTS)
    step = float(_STARTS[1] - _STARTS[0])
    spread = float(likelihood @ (_STARTS - start) ** 2) + step * step / 12.0
    depth = float(side[0, DEPTH]) + start * length
    speed = float(np.interp(depth, side[:, DEPTH], side[:, SPEED]))
    relative = speed / max(float(side[:, SPEED].mean()), 1e-6) - 1.0
    row = np.array([1.0, start, start**2, relative, relative * start, 0.0, 0.0])
    return Boundary(
        depth_m=depth,
        std_m=float(np.sqrt(spread)) * length,
        force_N=float(side[:, FORCE].mean() + row @ fits.solutions[best]),
        force_var=float(row @ covariance @ row),
        speed_m_s=speed,
    )
