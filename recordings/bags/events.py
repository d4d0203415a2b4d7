"""Events in a table as diagnostic messages."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from recordings.clock.nanoseconds import NS_PER_S
from recordings.tables.checked_columns import Columns
from recordings.tables.labels import Labels

DIAGNOSTICS, KIND = "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"
_OK, _WARN = 0, 1


class Event(NamedTuple):
    """A change of a column that means something.

    Attributes:
        row: where it happens.
        data: the serialised message.
    """

    row: int
    data: bytes


class EventEncoder:
    """Looks for changes of columns, from chunk to chunk.

    Args:
        labels: says which columns, and what their values mean.
        types: the store from `standard_types`.
    """

    def __init__(self, labels: Labels, types: Any) -> None:
        self._labels, self._types = labels, types
        self._latest: dict[str, int] = {}

    def encode(self, columns: Columns, stamps_ns: NDArray[np.int64]) -> list[Event]:
        """Return the events of consecutive rows in order.

        Args:
            columns: the table.
            stamps_ns: time stamps, shape (n,).
        """
        events: list[Event] = []
        for name in self._labels.events:
            if name not in columns or not stamps_ns.size:
                continue
            values = np.nan_to_num(columns[name]).astype(np.int64)
            # Before the first row there was no value: any that it has is a change.
            before = np.roll(values, 1)
            before[0] = self._latest.get(name, int(values[0]) - 1)
            self._latest[name] = int(values[-1])
            for row in np.flatnonzero(values != before).tolist():
                if text := self._text(name, int(values[row])):
                    data = self._message(name, text, int(values[row]), int(stamps_ns[row]))
                    events.append(Event(row, data))
        return sorted(events)

    def _text(self, name: str, value: int) -> str:
        texts = self._labels.events[name]
        return texts[min(max(value, 0), len(texts) - 1)].format(value) if texts else ""

    def _message(self, name: str, text: str, value: int, stamp_ns: int) -> bytes:
        kinds = self._types.types
        stamp = kinds["builtin_interfaces/msg/Time"](stamp_ns // NS_PER_S, stamp_ns % NS_PER_S)
        status = kinds["diagnostic_msgs/msg/DiagnosticStatus"](
            level=_OK if value == 0 else _WARN,
            name=f"{self._labels.prefix.strip('/')}: {name}",
            message=text,
            hardware_id="",
            values=[kinds["diagnostic_msgs/msg/KeyValue"](key=name, value=str(value))],
        )
        message = kinds[KIND](kinds["std_msgs/msg/Header"](stamp, self._labels.frame), [status])
        return bytes(self._types.serialize_cdr(message, KIND))
