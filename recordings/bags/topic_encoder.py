"""Rows of a table as serialised messages of one topic."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.bags.cdr_layout import Path, Place, learn_layout
from recordings.bags.layout import OutTopic
from recordings.clock.nanoseconds import NS_PER_S
from recordings.tables.checked_columns import Columns

_FRAME: Path = ("header", "frame_id")


class TopicEncoder:
    """Fills the numbers of many messages into copies of one.

    Args:
        topic: what is written.
        types: the store from `standard_types`.
    """

    def __init__(self, topic: OutTopic, types: Any) -> None:
        self._topic, self._types = topic, types
        message = self._empty(topic.kind, ())
        self._pattern = np.frombuffer(bytes(types.serialize_cdr(message, topic.kind)), np.uint8)
        layout = learn_layout(
            self._pattern.tobytes(), topic.kind, lambda kind: dict(types.fielddefs[kind][1])
        )
        self._places = {place.path: place for place in layout.places}

    def encode(self, columns: Columns, stamps_ns: NDArray[np.int64]) -> list[bytes]:
        """Return one message for each row.

        Args:
            columns: the table.
            stamps_ns: time stamps, shape (n,).
        """
        cells = np.tile(self._pattern, (stamps_ns.size, 1))
        if ("header", "stamp", "sec") in self._places:
            seconds, nanoseconds = np.divmod(stamps_ns, NS_PER_S)
            _fill(cells, self._places["header", "stamp", "sec"], seconds)
            _fill(cells, self._places["header", "stamp", "nanosec"], nanoseconds)
        for path, (name, element) in self._topic.values.items():
            values = columns[name] if element is None else columns[name][:, element]
            _fill(cells, self._places[path], values)
        data, size = cells.tobytes(), self._pattern.size
        return [data[start : start + size] for start in range(0, len(data), size)]

    def _empty(self, kind: str, path: Path) -> Any:
        """Return a message whose numbers are zero and whose arrays have their lengths."""
        fields = self._types.fielddefs[kind][1]
        values = [self._value(description, (*path, name)) for name, description in fields]
        return self._types.types[kind](*values)

    def _value(self, description: Any, path: Path) -> Any:
        node, rest = int(description[0]), description[1]
        if node == 2:
            return self._empty(rest, path)
        if node == 1:
            texts = {_FRAME: self._topic.frame}
            return texts.get(path, "") if rest[0] == "string" else 0
        if rest[0][1][0] == "string":
            return list(self._topic.names)
        return np.zeros(self._topic.lengths.get(path, 0))


def _fill(cells: NDArray[np.uint8], place: Place, values: NDArray) -> None:
    numbers = np.ascontiguousarray(values.reshape(len(cells), -1), dtype=place.dtype)
    data = numbers.view(np.uint8).reshape(len(cells), -1)
    cells[:, place.offset : place.offset + data.shape[1]] = data
