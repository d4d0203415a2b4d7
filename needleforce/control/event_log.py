"""The log of the manager's events: JSON lines at once, MCAP afterwards, replay."""

import os
from collections.abc import Iterable
from contextlib import suppress
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import Any

import msgspec

from needleforce.control.errors import OWN_EVENT_LOG, SettingError
from needleforce.control.state_machine import State, transition

MCAP_TOPIC = "/needleforce/events"

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

    def append(self, event: LoggedEvent) -> None:
        """Keep an event in memory; `write` puts it into the file.

        Raises:
            SettingError: Its data cannot be written as JSON.
        """
        try:
            _ENCODER.encode(event)
        except (ValueError, RecursionError) as error:
            raise SettingError(
                f"data of {event.event} cannot be written as JSON: {error}",
                OWN_EVENT_LOG,
            ) from error
        self.events.append(event)

    def write(self) -> str:
        """Append new events to the file, so that a crash loses none.

        Returns:
            Why they could not be written, so that a full disk stops no monitor; empty
            if they were. They are written with the next event.
        """
        if self._path is None:
            return ""
        size = None
        try:
            with Path(self._path).open("ab") as file:
                size = file.tell()
                file.write(_ENCODER.encode_lines(self.events[self._written :]))
            self._written = len(self.events)
        except OSError as error:
            if size is not None:
                with suppress(OSError):  # half a line would spoil the next one
                    os.truncate(self._path, size)
            return f"the log cannot be written: {error}"
        return ""


def write_mcap(events: Iterable[LoggedEvent], path: str | Path) -> None:
    """Write events as JSON messages of an MCAP file, on the manager's clock.

    It replaces another file of this name.

    Raises:
        SettingError: The extra ``recordings`` is not installed.
        OSError: The file cannot be written.
    """
    writer = _import_mcap("writer").Writer(str(path))
    writer.start(library="needleforce")
    schema = msgspec.json.encode(msgspec.json.schema(LoggedEvent))
    schema_id = writer.register_schema("LoggedEvent", "jsonschema", schema)
    channel_id = writer.register_channel(MCAP_TOPIC, "json", schema_id)
    for event in events:
        time_ns = round(1e9 * event.t_s)
        writer.add_message(
            channel_id, time_ns, _ENCODER.encode(event), time_ns, event.seq
        )
    writer.finish()


def _import_mcap(module: str) -> Any:
    try:
        return import_module(f"mcap.{module}")
    except ImportError:
        raise SettingError(
            "MCAP files need mcap, which is not installed",
            "Install it: pip install 'needleforce[recordings]'.",
        ) from None


def read_events(path: str | Path) -> list[LoggedEvent]:
    """Read a log of JSON lines or, where its name ends in ``.mcap``, of MCAP.

    Raises:
        SettingError: A line is no event, or the numbers of the events do not follow
            each other; they start anew where another session was appended. Or the file
            is no MCAP, or damaged.
        OSError: The file cannot be read.
    """
    data = Path(path).read_bytes()
    is_mcap = Path(path).suffix == ".mcap"
    lines = _mcap_messages(data, path) if is_mcap else data.splitlines()
    events = list[LoggedEvent]()
    for number, line in enumerate(lines, 1):
        try:
            event = msgspec.json.decode(line, type=LoggedEvent)
        except msgspec.DecodeError as error:
            raise SettingError(
                f"{path}, line {number} is no event: {line[:80]!r}",
                OWN_EVENT_LOG,
            ) from error
        if event.seq not in (0, events[-1].seq + 1 if events else 0):
            raise SettingError(
                f"{path}, line {number}: event {event.seq} is out of order",
                OWN_EVENT_LOG,
            )
        events.append(event)
    return events


def _mcap_messages(data: bytes, path: str | Path) -> list[bytes]:
    """Return the messages of an MCAP file in the order in which they were written.

    It is not that of their times: the clock of a session that was appended begins anew.
    """
    mcap = _import_mcap("reader")
    try:
        reader = mcap.make_reader(BytesIO(data), validate_crcs=True)
        messages = reader.iter_messages(topics=[MCAP_TOPIC], log_time_order=False)
        return [message.data for _, _, message in messages]
    except Exception as error:  # whatever the library makes of a damaged file
        raise SettingError(
            f"{path} is no MCAP file, or a damaged one: {error!r}",
            OWN_EVENT_LOG,
        ) from error


def replay(events: Iterable[LoggedEvent]) -> list[State]:
    """Return the states after each event, from the events and the facts they met.

    A session begins idle.
    """
    state = State.IDLE
    states = []
    for event in events:
        origin = State.IDLE if event.seq == 0 else state
        state, _ = transition(origin, event.event, event.data["facts"])
        states.append(state)
    return states
