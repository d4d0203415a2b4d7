"""Force on both sides of a rupture, extrapolated to the same instant."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DefaultConfig
from identification.layer_model import cutting_onset
from identification.track import BLOCKS, DEPTH, FORCE, SPEED

_BEFORE_M = 2e-3
_MARGIN_M = 2e-5
_LEAST_POINTS = 4
_AGREEMENT = 2.5
_CHUNK = 4


class RuptureFit(NamedTuple):
    """Axial force just before and just after a rupture.

    Attributes:
        before_N: Force at t_r, extrapolated from before.
        before_var: Its variance [N^2].
        after_N: Force at t_r without the tip force of the layer left, extrapolated from after the
            release; the next layer's push is taken out.
        after_var: Its variance [N^2].
        slope_N_per_mm: Growth of the force per travel after the release.
        drop_N: Force released, equation (10) with both forces at the same instant.
    """

    before_N: float
    before_var: float
    after_N: float
    after_var: float
    slope_N_per_mm: float
    drop_N: float


def force_before(
    points: NDArray[np.float64], depth_m: float, noise_N2: float
) -> tuple[float, float] | None:
    """Force at `depth_m` extrapolated from the last millimetres before it, and its variance."""
    reach = points[:, DEPTH] - depth_m
    side = points[(reach > -_BEFORE_M) & (reach < -_MARGIN_M)]
    if len(side) < 2:
        return None
    offset = 1e3 * (side[:, DEPTH] - depth_m)
    columns = np.column_stack([np.ones_like(offset), offset])[:, : 2 if len(side) > 3 else 1]
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
    onset = np.array([cutting_onset(x, config.cutting_onset_m) for x in reach])
    return np.column_stack([friction, onset, 1e3 * reach])


def _solve(
    columns: NDArray[np.float64],
    force: NDArray[np.float64],
    weight: NDArray[np.float64],
    cutting_N: float,
) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Weighted least squares, the cutting force near `cutting_N` by prior, never negative."""
    normal = columns.T @ (columns * weight[:, None])
    normal += np.diag([1e-9, cutting_N**-2, 1e-9])
    target = columns.T @ (weight * force)
    target[1] += 1.0 / cutting_N
    covariance = np.linalg.inv(normal)
    solution = covariance @ target
    if solution[1] < 0.0:
        kept = [0, 2]
        inner = np.linalg.inv(normal[np.ix_(kept, kept)])
        part = inner @ target[kept]
        solution = np.array([part[0], 0.0, part[1]])
    return solution, covariance


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


def _after(
    points: NDArray[np.float64],
    depth_m: float,
    speed_m_s: float,
    noise_N2: float,
    config: DefaultConfig,
) -> tuple[float, float, float] | None:
    """Grow the window back towards the rupture until the release is met.

    The release lifts two neighbouring chunks of points above what the later ones predict; the
    chunk before which that happens may hold its tail and is left out too.
    """
    side = points[points[:, DEPTH] > depth_m]
    if len(side) < _LEAST_POINTS:
        return None
    columns = _columns(side, depth_m, speed_m_s, config)
    force, weight = side[:, FORCE], side[:, BLOCKS] / noise_N2
    cutting = _cutting_prior(columns, force, weight, config)
    latest = max(len(side) - max(_LEAST_POINTS, len(side) // 2), 0)
    start, lifted = latest, 0
    for begin in range(latest - _CHUNK, -1, -_CHUNK):
        solution, covariance = _solve(columns[start:], force[start:], weight[start:], cutting)
        chunk = slice(begin, begin + _CHUNK)
        mean = np.average(columns[chunk], axis=0, weights=weight[chunk])
        surprise = np.average(force[chunk], weights=weight[chunk]) - mean @ solution
        variance = mean @ covariance @ mean + 1.0 / np.sum(weight[chunk])
        lifted = lifted + 1 if surprise > _AGREEMENT * np.sqrt(variance) else 0
        if lifted == 2:
            break
        start = start if lifted else begin
    start = min(start + _CHUNK, latest)
    solution, covariance = _solve(columns[start:], force[start:], weight[start:], cutting)
    return float(solution[0]), float(covariance[0, 0]), max(float(solution[2]), 0.0)


def fit_rupture(
    points: NDArray[np.float64],
    depth_m: float,
    speed_m_s: float,
    noise_N2: float,
    config: DefaultConfig,
) -> RuptureFit | None:
    """Measure the force drop of a rupture from the track around it.

    Args:
        points: Track points, see `track`.
        depth_m: Depth of the rupture.
        speed_m_s: Speed at the rupture.
        noise_N2: Long-run variance of one block.
        config: Settings.

    Returns:
        Both forces with variances, or None while too few points are at hand.
    """
    noise = max(noise_N2, 1e-12)
    before = force_before(points, depth_m, noise)
    if before is None:
        return None
    after = _after(points, depth_m, speed_m_s, noise, config)
    if after is None:
        return None
    return RuptureFit(*before, *after, drop_N=before[0] - after[0])
