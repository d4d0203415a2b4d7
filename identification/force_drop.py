"""Force on both sides of a rupture, extrapolated to the same instant."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.config import MultilayerConfig
from identification.resampling import BLOCKS, DEPTH, FORCE, SPEED

_BEFORE_M = 2e-3
_MARGIN_M = 2e-5
_LEAST_POINTS = 4
_AGREEMENT = 2.5
_CHUNK = 4
_RIDGE = 1e-9

Array = NDArray[np.float64]


class ForceAfter(NamedTuple):
    """Axial force just after a rupture, and what follows it.

    Attributes:
        force_N: Force at t_r without the tip force of the layer left, extrapolated from after the
            release; the next layer's push is taken out.
        variance: Its variance [N^2].
        slope_N_per_mm: Growth of the force per travel after the release.
    """

    force_N: float
    variance: float
    slope_N_per_mm: float


def force_before(points: Array, depth_m: float, noise_N2: float) -> tuple[float, float] | None:
    """Force at a rupture extrapolated from the last millimetres before it, and its variance.

    Args:
        points: Points of the track.
        depth_m: Depth of the rupture.
        noise_N2: Long-run variance of one block.

    Returns:
        Both, or None while too few points are at hand.
    """
    reach = points[:, DEPTH] - depth_m
    is_before = (reach > -_BEFORE_M) & (reach < -_MARGIN_M)
    side = points[is_before]
    if len(side) < 2:
        return None
    columns = np.ones((len(side), 2 if len(side) > 3 else 1))
    columns[:, 1:] = 1e3 * reach[is_before][:, None]
    weight = side[:, BLOCKS] / max(noise_N2, 1e-12)
    normal = columns.T @ (columns * weight[:, None])
    covariance = np.linalg.inv(normal + _RIDGE * np.eye(len(normal)))
    solution = covariance @ (columns.T @ (weight * side[:, FORCE]))
    return float(solution[0]), float(covariance[0, 0])


class AfterRows(NamedTuple):
    """Points after a rupture as rows of the law that their force obeys.

    Attributes:
        design: Friction, cutting force, slope; force; ones. Shape (n, 5).
        weight: Inverse variances, shape (n,).
        cutting_N: Expected cutting force.
    """

    design: Array
    weight: Array
    cutting_N: float


def rows_after(
    points: Array, depth_m: float, speed_m_s: float, noise_N2: float, config: MultilayerConfig
) -> AfterRows | None:
    """What the force after a rupture is measured from.

    Args:
        points: Points of the track.
        depth_m: Depth of the rupture.
        speed_m_s: Speed at the rupture.
        noise_N2: Long-run variance of one block.
        config: Settings.

    Returns:
        The rows, or None while too few points are at hand.
    """
    side = points[points[:, DEPTH] > depth_m]
    if len(side) < _LEAST_POINTS:
        return None
    design = _design(side, depth_m, speed_m_s, config)
    weight, half = side[:, BLOCKS] / max(noise_N2, 1e-12), len(side) // 2
    return AfterRows(design, weight, _cutting_prior(design[half:], weight[half:], config))


def force_after(rows: AfterRows) -> ForceAfter:
    """Force after a rupture: grow the window back towards it until the release is met.

    The release lifts two neighbouring chunks of points above what the later ones predict; the
    chunk before which that happens may hold its tail and is left out too.

    Args:
        rows: See `rows_after`.
    """
    weighted, count = rows.design * rows.weight[:, None], len(rows.weight)
    latest = max(count - max(_LEAST_POINTS, count // 2), 0)
    windows = _windows(rows.design, weighted, rows.cutting_N, latest)
    begin = _first_undisturbed(windows, weighted[latest % _CHUNK : latest])
    force, _, slope = windows.solution[begin]
    return ForceAfter(force, windows.covariance[begin][0][0], max(slope, 0.0))


def _design(side: Array, depth_m: float, speed_m_s: float, config: MultilayerConfig) -> Array:
    """Friction at the rupture's speed, cutting force of the next layer, its slope; force; ones.

    The speed is smoothed by a line: noise in a regressor would let the other columns take over.
    """
    reach, speed = side[:, DEPTH] - depth_m, side[:, SPEED]
    coulomb = config.coulomb_fraction(speed_m_s)
    x = reach - reach.mean()
    change = float(x @ speed) / max(float(x @ x), 1e-18)
    smooth = speed.mean() + change * x
    onset = np.minimum(reach / config.cutting_onset_m, 1.0)
    design = np.empty((len(side), 5))
    design[:, 0] = coulomb + (1.0 - coulomb) * smooth / max(speed_m_s, 1e-6)
    design[:, 1] = onset * (2.0 - onset)
    design[:, 2], design[:, 3], design[:, 4] = 1e3 * reach, side[:, FORCE], 1.0
    return design


def _cutting_prior(design: Array, weight: Array, config: MultilayerConfig) -> float:
    """Expected cutting force of the next layer, from how fast its force grows.

    A layer that hardly pushes back hardly resists cutting either; free air does neither.
    """
    line, force = design[:, [0, 2]], design[:, 3]
    normal = line.T @ (line * weight[:, None]) + _RIDGE * np.eye(2)
    covariance = np.linalg.inv(normal)
    slope = float((covariance @ (line.T @ (weight * force)))[1])
    reach = 1e3 * config.cutting_reach_m
    return max(reach * slope, reach * math.sqrt(covariance[1, 1]), 1e-6)


class _Windows(NamedTuple):
    """Fits of every window that ends at the newest point, each a chunk longer than the one before.

    Attributes:
        solution: Friction, cutting force (never negative), slope of each.
        covariance: Their covariance, row by row.
    """

    solution: list[list[float]]
    covariance: list[list[list[float]]]


def _windows(design: Array, weighted: Array, cutting_N: float, latest: int) -> _Windows:
    """Weighted least squares from `latest` on, and from ever earlier points on.

    The cutting force is near `cutting_N`.
    """
    products = weighted[:, :3, None] * design[:, None, :4]
    sums = np.cumsum(products[::-1], axis=0)[len(design) - 1 - latest :: _CHUNK]
    normal = sums[:, :, :3] + np.diag([_RIDGE, cutting_N**-2, _RIDGE])
    target = sums[:, :, 3].copy()
    target[:, 1] += 1.0 / cutting_N
    covariance = np.asarray(np.linalg.inv(normal), dtype=float)
    solution = (covariance @ target[:, :, None])[:, :, 0]
    without = solution[:, 1] < 0.0
    if without.any():
        inner = np.linalg.inv(normal[without][:, ::2, ::2])
        part = (inner @ target[without][:, ::2, None])[:, :, 0]
        solution[without, 1] = 0.0
        solution[without, ::2] = part
    return _Windows(solution.tolist(), covariance.tolist())


def _first_undisturbed(windows: _Windows, weighted: Array) -> int:
    """Which window is the longest that the release does not reach into.

    Args:
        windows: From the shortest on.
        weighted: Weighted rows of the design by which the others are longer.
    """
    chunks = weighted.reshape(-1, _CHUNK, 5).sum(axis=1)[::-1]
    used, lifted = 0, 0
    for k, (*sums, blocks) in enumerate(chunks.tolist()):
        x, y, z, force = (total / blocks for total in sums)
        surprise, variance = _surprise((x, y, z), force, windows, used)
        lifted = lifted + 1 if surprise > _AGREEMENT * math.sqrt(variance + 1.0 / blocks) else 0
        if lifted == 2:
            break
        used = used if lifted else k + 1
    return max(used - 1, 0)


def _surprise(
    mean: tuple[float, float, float], force_N: float, windows: _Windows, used: int
) -> tuple[float, float]:
    """How far a force lies above what a window predicts, and the prediction's variance [N^2].

    Plain floats: three numbers are too few for arrays to be worth it.
    """
    x, y, z = mean
    a, b, c = windows.solution[used]
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = windows.covariance[used]
    variance = x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + zz * z * z
    return force_N - (x * a + y * b + z * c), max(variance, 0.0)
