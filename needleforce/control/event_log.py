"""The events of a session, as JSON lines and as MCAP."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import msgspec

from needleforce.control.errors import SettingError

mcap: Any
try:
    import mcap.reader
    import mcap.writer
except ImportError:
    mcap = None

MCAP_TOPIC = "/needleforce/events"


class LoggedEvent(msgspec.Struct, frozen=True, rename={"origin": "from", "target": "to"}):
    """One event, a refused one included."""

    seq: int  # counts from 0
    t_s: float  # on the manager's clock
    origin: str  # state before it; "from" in the file
    event: str
    target: str  # state after it; "to" in the file
    refused: str  # why it was refused; empty if it was not
    data: dict[str, Any]  # what came with it, and the facts it met


_ENCODER = msgspec.json.Encoder(enc_hook=str)


def append_event(event: LoggedEvent, path: str | Path) -> None:
    """Write one more line at once, so that a crash loses none."""
    with Path(path).open("ab") as file:
        file.write(_ENCODER.encode(event) + b"\n")


def write_mcap(events: Iterable[LoggedEvent], path: str | Path) -> None:
    """Write events as JSON messages of an MCAP file, on the manager's clock; it replaces another.

    Raises:
        SettingError: The extra ``recordings`` is not installed.
        OSError: The file cannot be written.
    """
    _require_mcap()
    writer = mcap.writer.Writer(str(path))
    writer.start(library="needleforce")
    schema = msgspec.json.encode(msgspec.json.schema(LoggedEvent))
    schema_id = writer.register_schema("LoggedEvent", "jsonschema", schema)
    channel_id = writer.register_channel(MCAP_TOPIC, "json", schema_id)
    for event in events:
        time_ns = round(1e9 * event.t_s)
        writer.add_message(channel_id, time_ns, _ENCODER.encode(event), time_ns, event.seq)
    writer.finish()


def _require_mcap() -> None:
    if mcap is None:
        raise SettingError("MCAP needs: pip install 'needleforce[recordings]'")


def read_events(path: str | Path) -> list[LoggedEvent]:
    """Read a log back, of JSON lines or, where its name ends in ``.mcap``, of MCAP.

    Raises:
        SettingError: A line is no event, or the numbers of the events do not follow each other;
            they start anew where another session was appended.
        OSError: The file cannot be read.
    """
    if Path(path).suffix == ".mcap":
        with Path(path).open("rb") as file:
            _require_mcap()
            messages = mcap.reader.make_reader(file).iter_messages(topics=[MCAP_TOPIC])
            lines = [message.data for _, _, message in messages]
    else:
        lines = Path(path).read_bytes().splitlines()
    events: list[LoggedEvent] = []
    for number, line in enumerate(lines, 1):
        try:
            event = msgspec.json.decode(line, type=LoggedEvent)
        except msgspec.DecodeError as error:
            raise SettingError(f"{path}, line {number} is no event: {line[:80]!r}") from error
        if event.seq not in (0, events[-1].seq + 1 if events else 0):
            raise SettingError(f"{path}, line {number}: event {event.seq} is out of order")
        events.append(event)
    return events
