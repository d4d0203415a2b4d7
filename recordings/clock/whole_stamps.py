"""Whole numbers too large for float64, as stamps in nanoseconds since 1970 are."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

_EXACT = 1 << 53
"""Up to here float64 holds every whole number."""

Stamps = dict[str, NDArray[np.int64]]


def whole_stamps(columns: Mapping[str, np.ndarray]) -> Stamps:
    """Return the columns of whole numbers that float64 would round.

    Args:
        columns: as the file has them, in its own types.
    """
    return {
        name: values.astype(np.int64)
        for name, values in columns.items()
        if values.dtype.kind in "iu" and values.ndim == 1 and exceed_float64(values)
    }


def exceed_float64(values: np.ndarray) -> bool:
    """Return whether float64 rounds whole numbers as large as these, and int64 does not."""
    # Not abs, which overflows for the least integer; a NaN is not larger than anything.
    return bool(len(values)) and bool(((values > _EXACT) & (values < 1 << 63)).all())
