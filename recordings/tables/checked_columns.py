"""What may be written as a table: named columns of numbers, all of one length."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from recordings.errors import LogError

Columns = Mapping[str, np.ndarray]


def checked_columns(columns: Mapping[str, ArrayLike]) -> Columns:
    """Return the columns as arrays.

    Args:
        columns: name, with its unit, to numbers, shape (n,) or (n, k), all of the same n.

    Raises:
        LogError: the columns are not numbers, differ in length, or a name is empty or starts
            with `#`.
    """
    arrays = {name: _as_array(name, values) for name, values in columns.items()}
    if not arrays:
        raise LogError("no columns to write")
    first = next(iter(arrays.values()))
    rows = len(first) if first.ndim else 0
    for name, values in arrays.items():
        if not name.strip() or name.startswith("#"):
            raise LogError(f"column name {name!r} is empty or starts with '#'")
        if values.dtype.kind not in "fiub" or values.ndim not in (1, 2) or len(values) != rows:
            raise LogError(
                f"column {name!r} has shape {values.shape} and type {values.dtype}; expected "
                f"numbers of shape ({rows},) or ({rows}, k)"
            )
    return arrays


def require_same_columns(first: Columns, later: Columns) -> None:
    """Check that rows to append have the columns of those before them.

    Args:
        first: columns of the rows written first.
        later: columns of the rows to append.

    Raises:
        LogError: names, their order, widths or types differ.
    """
    told = [
        [f"{name} {values.dtype}{list(values.shape[1:])}" for name, values in columns.items()]
        for columns in (first, later)
    ]
    if told[0] != told[1]:
        raise LogError(f"rows with the columns {told[1]} do not fit those before: {told[0]}")


def _as_array(name: str, values: ArrayLike) -> np.ndarray:
    try:
        return np.asarray(values)
    except ValueError as error:
        raise LogError(f"column {name!r} is not an array of numbers: {error}") from error
