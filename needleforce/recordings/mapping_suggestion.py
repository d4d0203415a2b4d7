"""A mapping of a recording as TOML to be edited, with what else there is."""

import json
from collections.abc import Iterable, Sequence

from needleforce.recordings.channel_request import ChannelRequest
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
        **dict.fromkeys(sorted(known.left_out), LEFT_OUT),
    }
    lines = [
        comment_line(
            f"Mapping of {paths_of(source)[0].name}; edit it, then: --mapping FILE"
        ),
        "",
    ]
    lines += [f"{key} = {json.dumps(value)}" for key, value in top.items() if value]
    is_timed = known.rate_hz is not None or table.clocks
    names = [*channels] if is_timed else ["time", *channels]
    used: set[str] = set()
    for name in filter(lambda each: each not in known.left_out, names):
        unit = None
        reason = "not found"
        try:
            unit = request.find(table, request.channels[name])
        except (ColumnError, UnitError) as error:
            if name in known.channels:
                raise
            reason = str(error)
        if unit is None:
            lines.append(comment_line(f"{name}: {reason}"))
            continue

        used |= {*unit.columns}
        column, *others = unit.columns
        first_unit, *_ = unit.units
        values = {
            "columns": unit.columns if others else column,
            "unit": unit.units if len({*unit.units}) > 1 else first_unit,
            "scale": unit.scale,
        }
        entries = ", ".join(f"{key} = {json.dumps(v)}" for key, v in values.items())
        lines.append(f"{name} = {{ {entries} }}  # {request.channels[name].meaning}")

    unused = [
        comment_line(f"  {name} {list(values.shape[1:]) or ''}")
        for name, values in table.columns.items()
        if name not in used
    ]
    return "\n".join(
        [*lines, "", *payload, "", "# Columns that are not used:", *unused, ""]
    )


def comment_line(text: str) -> str:
    """Return a comment for TOML.

    Names in it come from files and must not end its line.
    """
    return "# " + "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
