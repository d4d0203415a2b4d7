"""Force on both sides of a rupture, extrapolated to the same instant."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.track import BLOCKS, DEPTH, FORCE, SPEED

_BEFORE_M = 2e-3
_MARGIN_M = 2e-5
_LEAST_POINTS = 4
_AGREEMENT = 2.5
_CHUNK = 4


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


def force_before(
    points: NDArray[np.float64], depth_m: float, noise_N2: float
) -> tuple[float, float] | None:
    """Force at a rupture extrapolated from the last millimetres before it, and its variance.

    Args:
        points: Track points, see `track`.
        depth_m: Depth of the rupture.
        noise_N2: Long-run variance of one block.

    Returns:
        Both, or None while too few points are at hand.
    """
    reach = points[:, DEPTH] - depth_m
    side = points[(reach > -_BEFORE_M) & (reach < -_MARGIN_M)]
    if len(side) < 2:
        return None
    offset = 1e3 * (side[:, DEPTH] - depth_m)
    columns = np.ones((len(side), 2 if len(side) > 3 else 1))
    columns[:, 1:] = offset[:, None]
    weight = side[:, BLOCKS] / max(noise_N2, 1e-12)
    normal = columns.T @ (columns * weight[:, None])
    covariance = np.linalg.inv(normal + 1e-9 * np.eye(len(normal)))
    solution = covariance @ (columns.T @ (weight * side[:, FORCE]))
    return float(solution[0]), float(covariance[0, 0])


def _columns(
    side: NDArray[np.float64], depth_m: float, speed_m_s: float, config: DefaultConfig
) -> NDArray[np.float64]:
    """Friction at the rupture's speed, cutting force of the next layer, its slope.

    The speed is smoothed by a line: noise in a regressor would let the other columns take over.
    """
    reach = side[:, DEPTH] - depth_m
    share = config.coulomb_share(speed_m_s)
    x = reach - reach.mean()
    change = float(x @ side[:, SPEED]) / max(float(x @ x), 1e-18)
    speed = side[:, SPEED].mean() + change * x
    friction = share + (1.0 - share) * speed / max(speed_m_s, 1e-6)
    onset = np.minimum(reach / config.cutting_onset_m, 1.0)
    onset = onset * (2.0 - onset)
    columns = np.empty((len(side), 3))
    columns[:, 0], columns[:, 1], columns[:, 2] = friction, onset, 1e3 * reach
    return columns


class _Windows(NamedTuple):
    """Fits of every window that ends at the newest point, one per first point.

    Attributes:
        solution: Friction, cutting force (never negative), slope, shape (k, 3).
        covariance: Shape (k, 3, 3).
    """

    solution: NDArray[np.float64]
    covariance: NDArray[np.float64]


def _windows(
    columns: NDArray[np.float64],
    force: NDArray[np.float64],
    weight: NDArray[np.float64],
    cutting_N: float,
    first: NDArray[np.int64],
) -> _Windows:
    """Weighted least squares from each of `first` on; the cutting force is near `cutting_N`."""
    weighted = columns * weight[:, None]
    products = np.empty((len(force), 3, 4))
    np.multiply(weighted[:, :, None], columns[:, None, :], out=products[:, :, :3])
    np.multiply(weighted, force[:, None], out=products[:, :, 3])
    sums = np.cumsum(products[::-1], axis=0)[::-1][first]
    normal, target = sums[:, :, :3].copy(), sums[:, :, 3].copy()
    normal += np.diag([1e-9, cutting_N**-2, 1e-9])
    target[:, 1] += 1.0 / cutting_N
    covariance = np.asarray(np.linalg.inv(normal), dtype=float)
    solution = (covariance @ target[:, :, None])[:, :, 0]
    without = solution[:, 1] < 0.0
    if without.any():
        inner = np.linalg.inv(normal[without][:, ::2, ::2])
        part = (inner @ target[without][:, ::2, None])[:, :, 0]
        solution[without, 1] = 0.0
        solution[without, ::2] = part
    return _Windows(solution, covariance)


def _cutting_prior(
    columns: NDArray[np.float64],
    force: NDArray[np.float64],
    weight: NDArray[np.float64],
    config: DefaultConfig,
) -> float:
    """Expected cutting force of the next layer, from how fast its force grows.

    A layer that hardly pushes back hardly resists cutting either; free air does neither.
    """
    half = len(force) // 2
    line = columns[half:, [0, 2]]
    normal = line.T @ (line * weight[half:, None]) + 1e-9 * np.eye(2)
    covariance = np.linalg.inv(normal)
    slope = float((covariance @ (line.T @ (weight[half:] * force[half:])))[1])
    reach = 1e3 * config.cutting_reach_m
    return max(reach * slope, reach * float(np.sqrt(covariance[1, 1])), 1e-6)


def _first_undisturbed(
    windows: _Windows,
    columns: NDArray[np.float64],
    force: NDArray[np.float64],
    weight: NDArray[np.float64],
    first: NDArray[np.int64],
) -> int:
    """Which window is the longest that the release does not reach into."""
    chunks = first[1:, None] + np.arange(_CHUNK)
    share = weight[chunks]
    total = share.sum(axis=1)
    share = share / total[:, None]
    means = (share[:, None, :] @ columns[chunks])[:, 0, :]
    forces = np.sum(share * force[chunks], axis=1)
    used, lifted = 0, 0
    rows = zip(means.tolist(), forces.tolist(), total.tolist(), strict=True)
    for k, (mean, value, blocks) in enumerate(rows):
        surprise, variance = _surprise(mean, value, windows, used)
        lifted = lifted + 1 if surprise > _AGREEMENT * math.sqrt(variance + 1.0 / blocks) else 0
        if lifted == 2:
            break
        used = used if lifted else k + 1
    return max(used - 1, 0)


def _surprise(
    mean: list[float], force_N: float, windows: _Windows, used: int
) -> tuple[float, float]:
    """How far a force lies above what a window predicts, and the prediction's variance [N^2].

    Plain floats: three numbers are too few for arrays to be worth it.
    """
    x, y, z = mean
    a, b, c = windows.solution[used].tolist()
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = windows.covariance[used].tolist()
    variance = x * (xx * x + 2.0 * (xy * y + xz * z)) + y * (yy * y + 2.0 * yz * z) + zz * z * z
    return force_N - (x * a + y * b + z * c), max(variance, 0.0)


def force_after(
    points: NDArray[np.float64],
    depth_m: float,
    speed_m_s: float,
    noise_N2: float,
    config: DefaultConfig,
) -> ForceAfter | None:
    """Force after a rupture: grow the window back towards it until the release is met.

    The release lifts two neighbouring chunks of points above what the later ones predict; the
    chunk before which that happens may hold its tail and is left out too.

    Args:
        points: Track points, see `track`.
        depth_m: Depth of the rupture.
        speed_m_s: Speed at the rupture.
        noise_N2: Long-run variance of one block.
        config: Settings.

    Returns:
        The force, or None while too few points are at hand.
    """
    side = points[points[:, DEPTH] > depth_m]
    if len(side) < _LEAST_POINTS:
        return None
    columns = _columns(side, depth_m, speed_m_s, config)
    force, weight = side[:, FORCE], side[:, BLOCKS] / max(noise_N2, 1e-12)
    cutting = _cutting_prior(columns, force, weight, config)
    latest = max(len(side) - max(_LEAST_POINTS, len(side) // 2), 0)
    first = latest - _CHUNK * np.arange(latest // _CHUNK + 1)
    windows = _windows(columns, force, weight, cutting, first)
    begin = _first_undisturbed(windows, columns, force, weight, first)
    solution = windows.solution[begin]
    return ForceAfter(
        float(solution[0]), float(windows.covariance[begin, 0, 0]), max(float(solution[2]), 0.0)
    )
