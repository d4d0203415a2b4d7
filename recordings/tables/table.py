"""What a file holds before anyone has said what it means: named columns of numbers."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from recordings.errors import FormatError, LogError

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Named columns as read from a file, in the file's own units.

    Columns may differ in length (an npz file may hold several recordings); a `Log` may not.

    Attributes:
        columns: name to values, shape (n,) or (n, k); stored as read-only copies.
        constants: single numbers of the file, such as a sample rate.
        warnings: what the reader had to leave out or guess.
        joint_names: for two-dimensional columns of a file that names joints, their names in the
            order of the column.
        start_ns: the instant of t = 0 on the clock that stamped the file, in ns; not zero only
            where stamps are too large for seconds in float64 to tell nanoseconds apart.
        stamps: those of `columns` that float64 has rounded, as the whole numbers that they are.
        omitted: which columns were left out and why, where `warnings` come with later rows.
    """

    columns: Mapping[str, FloatArray]
    constants: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    joint_names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    start_ns: int = 0
    stamps: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    omitted: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Copy and freeze the columns.

        Raises:
            FormatError: there is no column, or one is not one- or two-dimensional.
            LogError: a column does not hold numbers.
        """
        if not self.columns:
            raise FormatError("no column of numbers: a table needs at least one")
        columns = {name: read_only(name, values) for name, values in self.columns.items()}
        for name, values in columns.items():
            if values.ndim not in (1, 2):
                raise FormatError(
                    f"column {name!r} has shape {values.shape}; expected (n,) or (n, k)"
                )
        object.__setattr__(self, "columns", MappingProxyType(columns))
        object.__setattr__(self, "constants", MappingProxyType(dict(self.constants)))
        object.__setattr__(self, "stamps", MappingProxyType(dict(self.stamps)))
        object.__setattr__(self, "joint_names", MappingProxyType(dict(self.joint_names)))

    def describe(self, limit: int = 40) -> str:
        """Return the column names for a message, two-dimensional ones with their width."""
        names = [
            f"{name} ({values.shape[1]} columns)" if values.ndim == 2 else name
            for name, values in self.columns.items()
        ]
        more = f" and {len(names) - limit} more" if len(names) > limit else ""
        return ", ".join(names[:limit]) + more

    def left_out(self, limit: int = 3) -> str:
        """Return in brackets, for a message, which columns the reader left out and why."""
        notes = [
            note
            for note in dict.fromkeys((*self.omitted, *self.warnings))
            if note.startswith("column ") and note.endswith("was left out")
        ]
        more = f"; and {len(notes) - limit} more" if len(notes) > limit else ""
        return f" ({'; '.join(notes[:limit])}{more})" if notes else ""


def read_only(name: str, values: ArrayLike) -> FloatArray:
    """Return a contiguous read-only copy of `values` as float64.

    Args:
        name: whose values they are, for the error.
        values: numbers in a regular array.

    Returns:
        The copy.

    Raises:
        LogError: they are not.
    """
    try:
        copy = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise LogError(f"{name} is not an array of numbers: {error}") from error
    copy.setflags(write=False)
    return copy
