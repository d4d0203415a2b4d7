"""A mapping of a recording as TOML to be edited, with what else there is."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channels import Channel
from needleforce.recordings.column_names import ChannelUnit, read_units
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
        "joints": list(known.joint_order or (joints if names_robot else ())),
    }
    title = f"Mapping of {Path(source).name}; edit it, then: --mapping FILE"
    lines = [comment_line(title), ""]
    lines += [f"{key} = {json.dumps(value)}" for key, value in top.items() if value]
    is_timed = known.rate_hz is not None or table.clocks
    used: set[str] = set()
    for name in channels if is_timed else ("time", *channels):
        channel = request.channels[name]
        try:
            unit = _find_unit(table, request, channel)
        except (ColumnError, UnitError) as error:
            if name in known.channels:
                raise

            lines.append(comment_line(f"{name}: {error}"))
            continue

        used |= {*unit.columns}
        columns = unit.columns[0] if len(unit.columns) == 1 else unit.columns
        value = f"columns = {json.dumps(columns)}"
        if columns != LEFT_OUT:
            units = unit.units[0] if len({*unit.units}) == 1 else unit.units
            value += f", unit = {json.dumps(units)}, scale = {json.dumps(unit.scale)}"
        lines.append(f"{name} = {{ {value} }}  # {channel.meaning}")

    lines += ["", *payload, "", "# Columns that are not used:"]
    for name, values in table.columns.items():
        if name not in used:
            lines.append(comment_line(f"  {name} {list(values.shape[1:]) or ''}"))

    return "\n".join([*lines, ""])


def _find_unit(table: Table, request: ChannelRequest, channel: Channel) -> ChannelUnit:
    """Return a channel's columns and units; raises if they are not known."""
    spec = request.mapping.channels.get(channel.name)
    if spec is not None and spec.patterns == (LEFT_OUT,):
        return ChannelUnit(channel.name, (LEFT_OUT,), (), ())
    if columns := request.find(table, channel):
        return read_units(table, channel, columns, spec)

    raise ColumnError("not found")


def comment_line(text: str) -> str:
    """Return a comment for TOML.

    Names in it come from files and must not end its line.
    """
    return "# " + "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
