"""The events of a session as JSON lines, and their replay."""

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from needleforce.control.errors import SettingError

_COLUMNS = ("seq", "t_s", "from", "event", "to", "refused", "data")


class LoggedEvent(NamedTuple):
    """One event, a refused one included."""

    seq: int  # counts from 0
    t_s: float  # on the manager's clock
    origin: str  # state before it; "from" in the file
    event: str
    target: str  # state after it; "to" in the file
    refused: str  # why it was refused; empty if it was not
    data: Mapping[str, Any] = MappingProxyType({})  # what came with it, and the facts it met

    def row(self) -> dict[str, Any]:
        """The event as it stands in the file."""
        return dict(zip(_COLUMNS, self, strict=True))


class EventLog:
    """Keeps events, and appends each to a file at once, so that a crash loses none."""

    def __init__(self, path: str | Path | None = None) -> None:
        self.events: list[LoggedEvent] = []
        self._path = None if path is None else Path(path)

    def append(self, event: LoggedEvent) -> None:
        """Keep one more event and write it."""
        self.events.append(event)
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(event.row(), default=str) + "\n")


def read_events(path: str | Path) -> list[LoggedEvent]:
    """Read a log back.

    Raises:
        SettingError: A line is no event, or the numbers of the events do not follow each other;
            they start anew where another session was appended.
        OSError: The file cannot be read.
    """
    events: list[LoggedEvent] = []
    for number, line in enumerate(Path(path).read_text(encoding="utf-8").splitlines(), 1):
        try:
            row = json.loads(line)
            event = LoggedEvent(*(row[name] for name in _COLUMNS))
        except (ValueError, KeyError, TypeError) as error:
            raise SettingError(f"{path}, line {number} is no event: {line[:80]!r}") from error
        if event.seq not in (0, events[-1].seq + 1 if events else 0):
            raise SettingError(f"{path}, line {number}: event {event.seq} is out of order")
        events.append(event)
    return events
