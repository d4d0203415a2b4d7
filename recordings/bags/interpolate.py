"""Signals of one topic at the time stamps of another."""

import numpy as np
from numpy.typing import NDArray

from recordings.tables.table import FloatArray

Stamps = NDArray[np.int64]


def interpolate(
    at_ns: Stamps, stamps_ns: Stamps, values: FloatArray, limit_ns: float
) -> FloatArray:
    """Interpolate linearly; where stamps agree, the values are taken as they are.

    Args:
        at_ns: where values are wanted, shape (n,).
        stamps_ns: where they are known, shape (m,), in any order.
        values: shape (m, k).
        limit_ns: between stamps further apart than this, nothing is interpolated.

    Returns:
        Shape (n, k); NaN before the first stamp, after the last, and in gaps.
    """
    if not stamps_ns.size:
        return np.full((at_ns.size, values.shape[1]), np.nan)
    order = np.argsort(stamps_ns, kind="stable")
    stamps_ns, values = stamps_ns[order], values[order]
    before = np.searchsorted(stamps_ns, at_ns, side="right") - 1
    low = np.clip(before, 0, stamps_ns.size - 1)
    high = np.clip(before + 1, 0, stamps_ns.size - 1)
    span = (stamps_ns[high] - stamps_ns[low]).astype(np.float64)
    inside = (before >= 0) & (span > 0.0) & (span <= limit_ns)
    share = np.divide(at_ns - stamps_ns[low], span, out=np.zeros(at_ns.size), where=inside)
    with np.errstate(invalid="ignore"):
        result = values[low] + share[:, None] * (values[high] - values[low])
    result[~inside] = np.nan
    exact = (before >= 0) & (stamps_ns[low] == at_ns)
    result[exact] = values[low[exact]]
    return result
