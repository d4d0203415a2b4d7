"""A mapping of a recording as TOML to be edited, with what else there is."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channel_units import unit_of_column
from needleforce.recordings.channels import Channel
from needleforce.recordings.errors import ColumnError, UnitError
from needleforce.recordings.mapping import LEFT_OUT, ColumnMapping, ColumnSpec
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
    title = f"Mapping of {Path(source).name}; edit it, then: --mapping FILE"
    lines = [comment_line(title), ""]
    if known.rate_hz is not None:
        lines += [f"rate_hz = {known.rate_hz}", ""]
    if known.reference_topic is not None:
        lines += [f"reference_topic = {json.dumps(known.reference_topic)}", ""]

    names_robot = any({*joints} <= {*each} for each in table.joint_names.values())
    order = known.joint_order or (joints if names_robot else ())
    if order:
        lines += [f"joints = {json.dumps(list(order))}", ""]

    is_timed = known.rate_hz is None and "t_s" not in table.seconds
    names = ["time", *channels] if is_timed else list(channels)
    used: set[str] = set()
    lines += [*payload, ""]
    for name in names:
        lines += [*_channel_lines(table, request, request.channels[name], used), ""]

    lines.append("# Columns that are not used:")
    for name, values in table.columns.items():
        span = f"[0] to [{values.shape[1] - 1}]" if values.ndim == 2 else ""
        if name not in used:
            lines.append(comment_line(f"  {name}{span}"))

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

    Where it is not known which columns it is, all stands in comments, with the reason.
    """
    spec = request.mapping.channels.get(channel.name)
    if spec is not None and spec.columns == LEFT_OUT:
        return [f"[{channel.name}]", f"columns = {json.dumps(LEFT_OUT)}  # not read"]

    reason = f"not found; {channel.meaning}"
    names: list[str] = []
    try:
        names = request.find(table, channel)
    except ColumnError as error:
        if spec is not None:
            raise

        reason = str(error)

    if not names:
        return [
            comment_line(reason),
            f"# [{channel.name}]",
            '# columns = ""',
            f'# unit = "{channel.si_unit}"',
        ]

    used |= set(names)
    spec = spec or ColumnSpec(columns=tuple(names))
    try:
        units = {unit_of_column(table, channel, name, spec) for name in names}
        unit, origin = next(iter(units))
        note = f"{origin}; of {', '.join(channel.units)}"
        unit_line = f"unit = {json.dumps(unit)}  # {note}"
        if len(units) > 1:
            unit_line = "# No unit for all: they are those of the names."
    except UnitError as error:
        unit_line = comment_line(str(error))

    return [
        f"[{channel.name}]  # {channel.meaning}",
        f"columns = {json.dumps(names[0] if len(names) == 1 else names)}",
        unit_line,
        f"scale = {json.dumps(spec.scale)}  # -1.0 turns the sign",
    ]
