"""The log of the manager's events: JSON lines, written at once."""

import os
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from needleforce.control.errors import SettingError

_ENCODER = msgspec.json.Encoder(enc_hook=str)


class LoggedEvent(
    msgspec.Struct, frozen=True, rename={"origin": "from", "target": "to"}
):
    """One event, a refused one included.

    Attributes:
        seq: Counts from 0.
        t_s: On the manager's clock.
        origin: State before it; "from" in the file.
        event: Its name, one of `EVENTS`.
        target: State after it; "to" in the file.
        refused: Why it was refused; empty if it was not.
        data: What came with it, and the facts it met.
    """

    seq: int
    t_s: float
    origin: str
    event: str
    target: str
    refused: str
    data: dict[str, Any]


class EventLog:
    """Events of a session, kept in memory and appended to a file.

    Args:
        path: The file, one JSON object per line; None: memory only.

    Attributes:
        events: Events so far.

    Raises:
        OSError: The file cannot be written.
    """

    def __init__(self, path: str | Path | None) -> None:
        if path is not None:
            Path(path).open("ab").close()
        self.events: list[LoggedEvent] = []
        self._path = path
        self._written = 0

    def append(self, event: LoggedEvent) -> str:
        """Keep an event, and append it to the file, so that a crash loses none.

        Returns:
            Why it could not be written, so that a full disk stops no monitor; empty if
            it was. It is written with the next event.

        Raises:
            SettingError: Its data cannot be written as JSON; it is not kept.
        """
        try:
            _ENCODER.encode(event)
        except (ValueError, RecursionError) as error:
            raise SettingError(
                f"data of {event.event} cannot be written as JSON: {error}"
            ) from error
        self.events.append(event)
        if self._path is None:
            return ""
        size = None
        try:
            with Path(self._path).open("ab") as file:
                size = file.tell()
                file.write(_ENCODER.encode_lines(self.events[self._written :]))
        except OSError as error:
            if size is not None:
                with suppress(OSError):  # half a line would spoil the next one
                    os.truncate(self._path, size)
            return f"the log cannot be written: {error}"
        self._written = len(self.events)
        return ""
