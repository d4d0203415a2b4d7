"""Tells what a recording with a flipped sign or a wrong unit looks like."""

import numpy as np
from numpy.typing import NDArray

_LEAST_TRAVEL_M = 1e-3
_LARGEST_DEPTH_M = 1.0
_LEAST_FORCE_N = 0.02


def sign_hints(
    depth_m: NDArray[np.float64],
    speed_m_s: NDArray[np.float64] | None,
    force_N: NDArray[np.float64],
) -> tuple[str, ...]:
    """Look at a whole recording for signs of a wrong sign.

    Args:
        depth_m: Tip depth, shape (n,); may hold gaps.
        speed_m_s: Recorded speed, shape (n,), or None.
        force_N: Axial force, shape (n,).

    Returns:
        One sentence per suspicion; none for a recording that looks right.
    """
    change = np.diff(depth_m, prepend=depth_m[:1])
    good = np.isfinite(change) & np.isfinite(force_N)
    change, force = np.where(good, change, 0.0), np.where(good, force_N, 0.0)
    depth = np.where(np.isfinite(depth_m), depth_m, -np.inf)
    hints = []
    span = float(np.ptp(depth[np.isfinite(depth)])) if np.isfinite(depth).any() else 0.0
    if span > _LARGEST_DEPTH_M:
        hints.append(f"depth spans {span:.3g} m; is it in millimetres?")
    if span < _LEAST_TRAVEL_M:
        return (*hints, f"depth moves by {span * 1e3:.3g} mm only; there is nothing to identify")
    is_fresh = (change > 0.0) & (depth >= np.maximum.accumulate(depth))
    if _mean(force, change * is_fresh) < -_LEAST_FORCE_N:
        hints.append(
            "the force is negative while the needle goes in; it must be positive when tissue "
            "pushes back: flip its sign"
        )
    first, last = force[: len(force) // 2], force[len(force) // 2 :]
    if depth[np.isfinite(depth)][0] - depth.min() > 0.7 * span and np.ptp(first) + np.ptp(last) > 0:
        hints.append("depth falls before it rises; it must grow into the tissue: flip its sign?")
    if speed_m_s is not None and float(np.nansum(change * speed_m_s)) < 0.0:
        hints.append("speed has the sign opposite to the change of depth: flip one of them")
    return tuple(hints)


def _mean(values: NDArray[np.float64], weights: NDArray[np.float64]) -> float:
    total = float(weights.sum())
    return float((values * weights).sum()) / total if total > 0.0 else 0.0
