"""How much room a panel needs."""

from collections.abc import Sequence

import numpy as np

from figures.curve import Curve

MOST_OF = 99.8
"""Per cent of each curve that is shown; lonely spikes may leave the panel."""
MARGIN = 0.06


def limits_of(curves: Sequence[Curve], x_limits: tuple[float, float] | None) -> tuple[float, float]:
    """Lower and upper limit: zero, and nearly all of every curve with its band."""
    edges = [0.0]
    for curve in curves:
        inside = np.isfinite(curve.y) & np.isfinite(curve.x)
        if x_limits is not None:
            inside &= (curve.x >= x_limits[0]) & (curve.x <= x_limits[1])
        if not inside.any():
            continue
        y = curve.y[inside]
        band = np.zeros_like(y) if curve.std is None else 2.0 * curve.std[inside]
        band[~np.isfinite(band)] = 0.0
        edges.append(float(np.percentile(y - band, 100.0 - MOST_OF)))
        edges.append(float(np.percentile(y + band, MOST_OF)))
    low, high = min(edges), max(edges)
    margin = MARGIN * (high - low) or 1.0
    return low - margin, high + margin
