"""A mapping of a recording as TOML to be edited, with what else there is."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channel_units import read_units
from needleforce.recordings.channels import Channel
from needleforce.recordings.errors import ColumnError, UnitError
from needleforce.recordings.mapping import LEFT_OUT, ColumnMapping
from needleforce.recordings.open_recording import columns_of
from needleforce.recordings.table import Table


def suggest_mapping(
    source: str | Path,
    channels: Iterable[str],
    *,
    mapping: ColumnMapping | None = None,
    joints: Sequence[str] = (),
    payload: Sequence[str] = (),
) -> str:
    """Return a mapping of a recording as TOML, with what else there is as comments.

    Args:
        source: See `read_table`.
        channels: Names of the channels looked for, apart from time.
        mapping: What is known already; it stays.
        joints: The robot's, in its order.
        payload: Lines that say what hangs on the robot.

    Raises:
        RecordingError: As `read_table` does; `ColumnError` if the mapping names a
            column that is not there.
    """
    known = mapping or ColumnMapping()
    table = columns_of(source, known)
    request = ChannelRequest(known, joints=tuple(joints)).with_layout(table)
    known = request.mapping
    names_robot = any({*joints} <= {*each} for each in table.joint_names.values())
    top = {
        "rate_hz": known.rate_hz,
        "reference_topic": known.reference_topic,
        "joints": list(known.joint_order or (joints if names_robot else ())),
    }
    title = f"Mapping of {Path(source).name}; edit it, then: --mapping FILE"
    lines = [comment_line(title), ""]
    lines += [f"{key} = {json.dumps(value)}" for key, value in top.items() if value]
    lines += [*payload, ""]
    is_timed = known.rate_hz is not None or table.clocks
    used: set[str] = set()
    for name in channels if is_timed else ("time", *channels):
        lines += [*_channel_lines(table, request, request.channels[name], used), ""]

    lines.append("# Columns that are not used:")
    for name, values in table.columns.items():
        if name not in used:
            lines.append(comment_line(f"  {name} {list(values.shape[1:]) or ''}"))

    return "\n".join([*lines, ""])


def comment_line(text: str) -> str:
    """Return a comment for TOML.

    Names in it come from files and must not end its line.
    """
    return "# " + "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def _channel_lines(
    table: Table, request: ChannelRequest, channel: Channel, used: set[str]
) -> list[str]:
    """Return a channel as a table of TOML, and add its columns to the used ones.

    Where it is not known which columns it is, or in which unit, the reason stands in a
    comment.
    """
    spec = request.mapping.channels.get(channel.name)
    head = f"[{channel.name}]  # {channel.meaning}"
    if spec is not None and spec.columns == LEFT_OUT:
        return [head, f"columns = {json.dumps(LEFT_OUT)}"]

    try:
        columns = request.find(table, channel)
        if not columns:
            return [comment_line(f"{head}: not found")]

        unit = read_units(table, channel, columns, spec)
    except (ColumnError, UnitError) as error:
        if spec is not None:
            raise

        return [comment_line(f"{head}: {error}")]

    used |= set(columns)
    lines = [
        head,
        f"columns = {json.dumps(columns[0] if len(columns) == 1 else columns)}",
    ]
    if len({*unit.units}) == 1:  # else they are those of the names
        listed = ", ".join(channel.units)
        lines.append(f"unit = {json.dumps(unit.units[0])}  # of {listed}")

    return [*lines, f"scale = {json.dumps(unit.scale)}  # -1.0 turns the sign"]
