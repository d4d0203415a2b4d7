"""Finds the membrane that was pushed in before a rupture (rupture time differs from exit time).

With a glove or a capsule between two layers the tip reaches the boundary, pushes the membrane in
and punctures it later: t_r is not t_{i+1} (Section II). Up to the boundary the force of the layer
grows; from there on the layer's own part stays and the membrane is a spring, in general a
non-linear one (a parabola: Okamura, Simone, O'Leary 2004).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.config import MultilayerConfig
from identification.resampling import BLOCKS, DEPTH, FORCE, SPEED, TRAVEL, merge_rows

_MOST_ROWS = 64
_LEAST_ROWS = 12
_MARGIN_M = 5e-5
_CURVATURE = 0.2
"""Bend of a layer's force over its slope, one standard deviation (tissue stiffens by 0 to 30 %)."""
_SPEED_EFFECT = 0.5
"""Change of force with speed over mean force, one standard deviation: friction, part viscous."""
_FREE = 1e-9

Array = NDArray[np.float64]


class ScaledLayer(NamedTuple):
    """Rows of a layer, scaled: position 0 to 1, speed about its mean, root of weights."""

    rows: Array  # The rows, see `resampling.add_layer_row`, shape (n, 6)
    position: Array  # Shape (n,)
    speed: Array  # Shape (n,)
    root_weight: Array  # Shape (n,)
    target: Array  # Weighted force about its mean, shape (n,)
    priors: Array  # Weights of the priors on the unknowns of a membrane, shape (7,)


def scale_layer(rows: Array, start_m: float, rupture_m: float) -> ScaledLayer | None:
    """The rows in which a membrane is looked for, or None where they are too few."""
    end = rows[:, DEPTH] + 0.5 * rows[:, TRAVEL]
    side = rows[(rows[:, DEPTH] > start_m) & (end < rupture_m - _MARGIN_M)]
    side = merge_rows(side, -(-len(side) // _MOST_ROWS)) if len(side) else side
    if len(side) < _LEAST_ROWS:
        return None
    depth, force = side[:, DEPTH], side[:, FORCE]
    position = (depth - depth[0]) / (depth[-1] - depth[0])
    weight = np.sqrt(side[:, BLOCKS] / side[:, BLOCKS].mean())
    mean = float(force.mean())
    target = (force - mean) * weight
    return ScaledLayer(
        rows=side,
        position=position,
        speed=side[:, SPEED] / max(float(side[:, SPEED].mean()), 1e-6) - 1.0,
        root_weight=weight,
        target=target,
        priors=_priors(position, force, mean, target),
    )


def _priors(position: Array, force: Array, mean: float, target: Array) -> Array:
    variance = max(0.5 * float(np.var(np.diff(target))), 1e-12)
    half = len(force) // 2
    begin = position[:half] - position[:half].mean()
    rise = float(begin @ force[:half]) / float(begin @ begin)
    slope = max(rise, 0.1 * float(np.ptp(force)), 1e-3)
    weights = np.full(7, _FREE)
    weights[2] += variance / (_CURVATURE * slope) ** 2
    weights[3:5] += variance / (_SPEED_EFFECT * max(abs(mean), 0.02)) ** 2
    return weights


def _smooth_squares(layer: ScaledLayer) -> float:
    """Sum of squares that a smooth cubic leaves, with the same priors on the effect of speed."""
    u, v = layer.position, layer.speed
    columns = np.stack([np.ones_like(u), u, u**2, v, v * u, u**3], axis=1)
    columns = columns * layer.root_weight[:, None]
    weights = np.array([_FREE, _FREE, _FREE, layer.priors[3], layer.priors[4], _FREE])
    vector = columns.T @ layer.target
    solution = np.linalg.solve(columns.T @ columns + np.diag(weights), vector)
    return float(layer.target @ layer.target - vector @ solution)


# A membrane's spring behind each boundary that a layer may have had. Seven unknowns: level, slope
# and bend of the layer up to the boundary, its change with speed (level and slope), and a straight
# and a parabolic part of the spring beyond.

_PARABOLA, _LINE = (0, 1, 2, 3, 4, 6), (0, 1, 2, 3, 4, 5)
STARTS = np.linspace(0.08, 0.96, 40)
"""Candidate boundaries, as fractions of the layer's length."""
STARTS.setflags(write=False)
_UNKNOWNS = 7
_EVIDENCE = 30.0
"""Gain of log-likelihood, twice, over a smooth cubic: five to six standard deviations."""
_BETTER = 0.75
"""Fraction of the cubic's sum of squares that must not be exceeded: with little noise any tissue
is significantly no cubic."""
_MOST_PUSHED_M = 13e-3
"""No membrane gives more: the capsule of bovine liver 11 mm."""
_AT_ONCE = 8
"""Candidates of one stage."""


class MembraneFits(NamedTuple):
    """Best membrane for each of some candidate boundaries."""

    squares: Array  # Sums of squares, infinite where no spring pushes, shape (m,)
    solutions: Array  # The seven unknowns, shape (m, 7)


def fit_membranes(layer: ScaledLayer, starts: Array) -> MembraneFits:
    """The best of three springs per candidate, none of which may pull: mixed, parabola, line.

    A straight spring must be steeper than the layer by half, or it is a bend of the layer.
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


class Boundary(NamedTuple):
    """Where a layer ended."""

    depth_m: float  # Depth: that of its rupture, or where its membrane began to be pushed in
    std_m: float  # Its standard deviation
    force_N: float  # Force there
    force_var: float  # Its variance [N^2]
    speed_m_s: float  # Speed there


def best_membrane(layer: ScaledLayer, fits: MembraneFits) -> Boundary | None:
    """The boundary, if a membrane explains the layer much better than a smooth cubic does.

    A single non-linear spring, as a capsule at the very surface is, has no boundary in it and
    stays one (fictitious) layer, as in Section III-B.
    """
    best = int(np.argmin(fits.squares))
    if not np.isfinite(fits.squares[best]):
        return None
    variance = max(float(fits.squares[best]), 1e-12) / (len(layer.rows) - _UNKNOWNS)
    smooth = _smooth_squares(layer)
    evidence = (smooth - fits.squares[best]) / variance
    if evidence < _EVIDENCE or fits.squares[best] > _BETTER * smooth:
        return None
    _, slope, _, _, _, straight, parabola = fits.solutions[best].tolist()
    if straight + 2.0 * parabola * (1.0 - float(STARTS[best])) <= max(slope, 0.0):
        return None  # a membrane at its puncture pushes back more steeply than the layer did
    normal, _ = _normal_equations(layer, STARTS[best : best + 1])
    covariance = variance * np.asarray(np.linalg.inv(normal[0]), dtype=float)
    return _membrane(layer.rows, fits, variance, covariance)


def _membrane(side: Array, fits: MembraneFits, variance: float, covariance: Array) -> Boundary:
    """Mean of the candidates by their likelihood, and the spread of it."""
    best = int(np.argmin(fits.squares))
    likelihood = np.exp(-0.5 * (fits.squares - fits.squares[best]) / variance)
    likelihood /= likelihood.sum()
    length = float(side[-1, DEPTH] - side[0, DEPTH])
    start = float(likelihood @ STARTS)
    step = float(STARTS[1] - STARTS[0])
    spread = float(likelihood @ (STARTS - start) ** 2) + step * step / 12.0
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


# The search, a stage per tick once the rupture has alarmed: all that it needs is known then, and
# the ticks that measure the force drop, millimetres later, are spared it.


class MembraneSearch(NamedTuple):
    """What was found."""

    boundary: Boundary | None  # Where the membrane before the rupture began, None if there was none
    is_one_law: bool  # Whether the layer's force obeyed one law up to the rupture


class SearchWork(NamedTuple):
    """What has been done of a search."""

    from_m: float  # Depth from which on the layer is searched
    is_second: bool = False  # Whether only what follows a missed transition is
    layer: ScaledLayer | None = None  # What is searched, None before the first stage
    fits: tuple[MembraneFits, ...] = ()  # Of the candidates tried so far


def search_step(
    work: SearchWork, rows: Array, rupture_m: float, config: MultilayerConfig
) -> SearchWork | MembraneSearch:
    """Work off the next stage of a search.

    Returns:
        What has been done now, or what was found.
    """
    if work.layer is None:
        layer = scale_layer(rows, work.from_m, rupture_m)
        if layer is None:
            return _conclude(work, None, rupture_m, config)
        return work._replace(layer=layer)
    tried = _AT_ONCE * len(work.fits)
    if tried < len(STARTS):
        fits = fit_membranes(work.layer, STARTS[tried : tried + _AT_ONCE])
        return work._replace(fits=(*work.fits, fits))
    every = MembraneFits(*(np.concatenate(parts) for parts in zip(*work.fits, strict=True)))
    return _conclude(work, best_membrane(work.layer, every), rupture_m, config)


def _conclude(
    work: SearchWork, found: Boundary | None, rupture_m: float, config: MultilayerConfig
) -> SearchWork | MembraneSearch:
    """What a search through a whole layer found.

    A boundary further back than any membrane gives is a soft transition that was missed. What
    follows it is searched again; the friction of both parts is measured together.
    """
    is_near = found is not None and rupture_m - found.depth_m <= _MOST_PUSHED_M
    if work.is_second:
        return MembraneSearch(found if is_near else None, False)
    if found is None or is_near:
        return MembraneSearch(found, found is None)
    return SearchWork(found.depth_m + config.provisional_window_m, is_second=True)
