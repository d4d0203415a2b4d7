"""The messages of one topic as columns of numbers."""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from recordings.bag_storage.raw_message import RawMessage
from recordings.bags.cdr_layout import CdrLayout, Place
from recordings.bags.message_columns import MessageColumns, message_columns
from recordings.bags.message_types import MessageTypes
from recordings.bags.survey import SurveyedTopic, layout_of
from recordings.clock.nanoseconds import NS_PER_S
from recordings.errors import FormatError
from recordings.tables.table import FloatArray

_MOST_LAYOUTS = 32
"""So many are remembered, in case every message of a topic has another one."""


class TopicRows(NamedTuple):
    """Messages of one topic.

    Attributes:
        stamps_ns: their source time stamps, shape (m,).
        columns: column name to values, shape (m, k).
    """

    stamps_ns: NDArray[np.int64]
    columns: dict[str, FloatArray]


class TopicReader:
    """Collects messages of a topic and decodes them together.

    Joints are put where their names say; a joint that a message lacks is NaN. The time stamp is
    the header's; where there is none, or it was never set, the recorder's.

    Args:
        found: the topic.
        columns: those to read.
        types: types of its bag.
        joints: the order of joints in columns whose elements have names; messages that name
            joints, but none of these, are left out.
    """

    def __init__(
        self,
        found: SurveyedTopic,
        columns: Collection[str],
        types: MessageTypes,
        joints: Collection[str] = (),
    ) -> None:
        self._found, self._types = found, types
        self._joints = {joint: place for place, joint in enumerate(joints)}
        self._wanted = [name for name in found.columns if name in columns]
        self._layouts: list[tuple[CdrLayout, MessageColumns]] = []
        self._pending: list[tuple[int, RawMessage]] = []
        self._faults: dict[str, int] = {}

    def __len__(self) -> int:
        """Return how many messages wait to be taken."""
        return len(self._pending)

    def add(self, message: RawMessage) -> None:
        """Take a message in."""
        number = next(
            (i for i, known in enumerate(self._layouts) if known[0].fits(message.data)), -1
        )
        if number < 0:
            try:
                layout = layout_of(message, self._types)
            except FormatError:
                self._tell("messages that do not fit their type, left out")
                return
            number = len(self._layouts)
            self._layouts.append((layout, message_columns(self._found.topic, layout)))
        names = self._layouts[number][1].names
        if self._joints and names and self._joints.keys().isdisjoint(names):
            self._tell("messages without any of the joints, left out")
            return
        self._pending.append((number, message))

    def take(self) -> TopicRows:
        """Return what has been added since the last call."""
        pending, self._pending = self._pending, []
        rows = len(pending)
        stamps_ns = np.array([message.log_ns for _, message in pending], dtype=np.int64)
        values = {name: np.full((rows, self._width(name)), np.nan) for name in self._wanted}
        numbers = np.array([number for number, _ in pending], dtype=np.int64)
        for number in np.unique(numbers).tolist():
            where = np.flatnonzero(numbers == number)
            layout, columns = self._layouts[number]
            data = b"".join(pending[row][1].data for row in where.tolist())
            cells = np.frombuffer(data, dtype=np.uint8).reshape(len(where), layout.size)
            self._stamp(stamps_ns, where, cells, columns)
            if columns.names and not self._joints.keys() <= set(columns.names):
                self._tell("messages that lack joints", len(where))
            for name in self._wanted:
                self._fill(values[name], name, where, cells, columns)
        self._layouts = self._layouts[-_MOST_LAYOUTS:]
        return TopicRows(stamps_ns, values)

    def notes(self) -> list[str]:
        """Return what was left out or guessed so far, one sentence each."""
        return [f"{self._found.topic.name}: {what}: {n}" for what, n in self._faults.items()]

    def _tell(self, what: str, count: int = 1) -> None:
        if count:
            self._faults[what] = self._faults.get(what, 0) + count

    def _width(self, name: str) -> int:
        if name in self._found.named:
            return len(self._joints)
        return self._found.columns[name] or 1

    def _stamp(
        self,
        stamps_ns: NDArray[np.int64],
        where: NDArray[np.intp],
        cells: NDArray[np.uint8],
        columns: MessageColumns,
    ) -> None:
        if columns.stamp is None:
            return
        seconds, nanoseconds = (_numbers(cells, place)[:, 0] for place in columns.stamp)
        source_ns = seconds.astype(np.int64) * NS_PER_S + nanoseconds.astype(np.int64)
        is_set = source_ns != 0
        self._tell(
            "messages without a source time stamp; the recorder's was taken",
            int(np.sum(~is_set & (stamps_ns[where] != 0))),
        )
        stamps_ns[where[is_set]] = source_ns[is_set]

    def _fill(
        self,
        values: FloatArray,
        name: str,
        where: NDArray[np.intp],
        cells: NDArray[np.uint8],
        columns: MessageColumns,
    ) -> None:
        """Put numbers of messages into rows of a column; what does not fit stays NaN."""
        place = columns.places.get(name)
        is_named = name in self._found.named
        if place is None or is_named != (name in columns.named):
            self._tell(f"messages without values of {name}, or not one for each joint", len(where))
            return
        found = _numbers(cells, place)
        if is_named:
            known = [i for i, joint in enumerate(columns.names) if joint in self._joints]
            to = [self._joints[columns.names[i]] for i in known]
            values[where[:, None], to] = found[:, known]
        elif found.shape[1] == values.shape[1]:
            values[where] = found
        else:
            self._tell(f"messages with another number of values of {name}", len(where))


def _numbers(cells: NDArray[np.uint8], place: Place) -> NDArray:
    """Return the numbers at one place of many messages, shape (m, k)."""
    dtype = np.dtype(place.dtype)
    size = dtype.itemsize * (place.length or 1)
    return np.ascontiguousarray(cells[:, place.offset : place.offset + size]).view(dtype)
