"""A mapping of a recording as TOML to be edited, with what else there is."""

import json
from collections.abc import Iterable, Sequence

from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.column_names import read_units
from needleforce.recordings.errors import ColumnError, UnitError
from needleforce.recordings.mapping import LEFT_OUT, ColumnMapping
from needleforce.recordings.open_recording import Source, columns_of, paths_of


def suggest_mapping(
    source: Source,
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
    title = f"Mapping of {paths_of(source)[0].name}; edit it, then: --mapping FILE"
    lines = [comment_line(title), ""]
    lines += [f"{key} = {json.dumps(value)}" for key, value in top.items() if value]
    is_timed = known.rate_hz is not None or table.clocks
    used: set[str] = set()
    for name in channels if is_timed else ("time", *channels):
        channel = request.channels[name]
        spec = known.channels.get(name)
        if name in known.left_out:
            lines.append(f'{name} = "{LEFT_OUT}"  # {channel.meaning}')
            continue
        try:
            columns = request.find(table, channel)
            if not columns:
                lines.append(comment_line(f"{name}: not found"))
                continue
            unit = read_units(table, channel, columns, spec)
        except (ColumnError, UnitError) as error:
            if spec is not None:
                raise
            lines.append(comment_line(f"{name}: {error}"))
            continue
        used |= {*columns}
        values = {
            "columns": columns if len(columns) > 1 else columns[0],
            "unit": unit.units if len({*unit.units}) > 1 else unit.units[0],
            "scale": unit.scale,
        }
        entries = ", ".join(f"{key} = {json.dumps(v)}" for key, v in values.items())
        lines.append(f"{name} = {{ {entries} }}  # {channel.meaning}")

    lines += ["", *payload, "", "# Columns that are not used:"]
    for name, values in table.columns.items():
        if name not in used:
            lines.append(comment_line(f"  {name} {list(values.shape[1:]) or ''}"))

    return "\n".join([*lines, ""])


def comment_line(text: str) -> str:
    """Return a comment for TOML.

    Names in it come from files and must not end its line.
    """
    return "# " + "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
