"""Fewer points of a curve that look the same: the least and the largest of every block."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BLOCKS = 500
"""More than a chart has columns of dots on a phone; print gets two points of each."""


def kept_points(y: Array, blocks: int = BLOCKS) -> NDArray[np.intp]:
    """Indices of the points to draw, increasing.

    A block keeps its least and its largest value, so that no spike is lost, and its first value
    that is not finite, so that no gap is bridged. The first and the last point stay.

    Args:
        y: Values, shape (n,).
        blocks: Into which the curve is cut.
    """
    size = -(-len(y) // blocks)
    if size <= 2:
        return np.arange(len(y))
    keep = {0, len(y) - 1}
    for start in range(0, len(y), size):
        block = y[start : start + size]
        is_finite = np.isfinite(block)
        if is_finite.any():
            keep.add(start + int(np.argmin(np.where(is_finite, block, np.inf))))
            keep.add(start + int(np.argmax(np.where(is_finite, block, -np.inf))))
        if not is_finite.all():
            keep.add(start + int(np.argmin(is_finite)))
    return np.array(sorted(keep), dtype=np.intp)
