"""One column of a recording as numbers."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.errors import InvalidLogError


def read_column(
    name: str, values: ArrayLike, rows: int | None = None, *, finite: bool = False
) -> NDArray[np.float64]:
    """Return a column as a float array of its own.

    Args:
        name: What it is, for the message.
        values: One number per row.
        rows: How many rows there must be, those of t_s; None for any number but zero.
        finite: Whether all numbers must be finite.

    Returns:
        The same numbers, shape (n,), a copy.

    Raises:
        InvalidLogError: Not a vector of real numbers, an empty one, or not as wanted.
    """
    try:
        if np.iscomplexobj(values):
            raise TypeError("its numbers are complex")
        column = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise InvalidLogError(f"{name} is not a vector of numbers: {error}") from error
    if column.ndim != 1 or column.size == 0:
        raise InvalidLogError(
            f"{name} must be a non-empty vector, got shape {column.shape}; one value per row"
        )
    if rows is not None and len(column) != rows:
        raise InvalidLogError(f"{name} has {len(column)} rows where t_s has {rows}")
    bad = np.flatnonzero(~np.isfinite(column))
    if finite and len(bad):
        raise InvalidLogError(f"{name} is not finite at row {bad[0]} ({len(bad)} in all)")
    return column
