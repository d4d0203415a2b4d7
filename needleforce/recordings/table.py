"""Named columns of numbers before anyone has said what they mean."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import prod
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.recordings.errors import LogError

TableColumns = Mapping[str, np.ndarray]
"""Columns by name, shape (n,) or (n, k)."""

STANDARD_STREAM = "-"
"""Stands in place of a file for standard input or standard output."""

MAX_LIST_NUMBERS = 64
"""Longer lists in cells are images and point clouds, no signals of joints."""

START_KEY = "start_ns"
"""What files of numbers call `TableLabels.start_ns`."""


class LinkTransforms(NamedTuple):
    """Where the links of an arm are: poses of k links in the axes of one frame.

    Attributes:
        parent: The frame.
        children: Names of the links, shape (k,).
        translation_m: Origins of the links, shape (k, 3).
        rotation_xyzw: Unit quaternions, shape (k, 4).
    """

    parent: str
    children: tuple[str, ...]
    translation_m: np.ndarray
    rotation_xyzw: np.ndarray


LinkPoses = Callable[[np.ndarray], LinkTransforms]
"""Returns where the links are for joint positions, shape (n,) [rad or m]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Named columns as read from a file, in the file's own units.

    Columns may differ in length: an npz file may hold several recordings, and topics
    of a bag have clocks of their own.

    Attributes:
        columns: By name, shape (n,) or (n, k).
        warnings: What the reader had to leave out or guess.
        joint_names: By name of a column (n, k): the joints that its k values belong to.
        start_ns: The instant of t = 0 on the clock that stamped the file, in ns: zero,
            unless stamps are too large for seconds in float64 to resolve nanoseconds.
        seconds: Names of the columns of time stamps; they are in seconds, whatever unit
            the name says.
        units: By name of a column: what a row of units says of it.
        clocks: By name of a column: what stamped its rows, a topic or a file; none
            where one column holds the time stamps of all.
        stamps_ns: By clock: the time stamp of each row, shape (n,).
        empty: Names of what holds no number, although it might.
    """

    columns: TableColumns
    warnings: tuple[str, ...] = ()
    joint_names: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    start_ns: int = 0
    seconds: frozenset[str] = frozenset()
    units: Mapping[str, str] = field(default_factory=dict)
    clocks: Mapping[str, str] = field(default_factory=dict)
    stamps_ns: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    empty: tuple[str, ...] = ()

    def values(self, name: str) -> np.ndarray:
        """Return a column, or an element of one such as `wrench[2]`.

        Raises:
            KeyError: There is no such column.
        """
        element = re.fullmatch(r"(.+)\[(\d{1,9})\]", name)
        if name in self.columns or element is None:
            return self.columns[name]

        array = self.columns[element[1]]
        index = int(element[2])
        if array.shape[1:] <= (index,):
            raise KeyError(name)

        return array[:, index]

    def width(self, name: str) -> int:
        """Return how many values a row has in a column, or an element of one."""
        return prod(self.values(name).shape[1:])

    def describe(self, limit: int = 40) -> str:
        """Return column names for a message, two-dimensional ones with their width."""
        names = [
            f"{name} ({values.shape[1]} columns)" if values.ndim == 2 else name
            for name, values in self.columns.items()
        ]
        names += [f"{name} (empty)" for name in self.empty]
        more = f" and {len(names) - limit} more" if len(names) > limit else ""
        return ", ".join(names[:limit]) + more

    def left_out(self, limit: int = 3) -> str:
        """Return in brackets which columns were left out or renamed, and why."""
        odd = [note for note in self.warnings if re.search("left out|column_", note)]
        return f" ({'; '.join(odd[:limit])})" if odd else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class TableLabels:
    """What goes with the columns of a table that is written.

    Bags carry all of it, the other formats `start_ns` if it is not zero. A bag written
    from a log that was read from one has the source's stamps, to the nanosecond.

    Attributes:
        start_ns: The instant of t = 0, see `Table`.
        joint_names: In the order of the columns of joint signals.
        frame: In which forces are given.
        prefix: How the topics of a bag begin that hold estimates.
        robot_description: URDF of the arm, for who shows the bag; empty for none.
        link_poses: Where the links are for the joint positions of a row; None if that
            is not known.
    """

    start_ns: int = 0
    joint_names: tuple[str, ...] = ()
    frame: str = ""
    prefix: str = "/needleforce"
    robot_description: str = ""
    link_poses: LinkPoses | None = None


def flat_columns(columns: TableColumns) -> dict[str, np.ndarray]:
    """Return columns of one value a row: `q_rad_1`, `q_rad_2`, ... in place of `q_rad`.

    Raises:
        LogError: Two columns would have the same name.
    """
    flat: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        for number, column in enumerate(np.atleast_2d(values.T), 1):
            flat_name = f"{name}_{number}" if values.ndim == 2 else name
            if flat_name in flat:
                raise LogError(
                    f"column name {flat_name!r} would stand twice in the header"
                )

            flat[flat_name] = column

    return flat
