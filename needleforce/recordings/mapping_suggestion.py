"""A mapping of a recording as TOML to be edited, with what else there is."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from needleforce.recordings.bag_file import bag_head, is_bag
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channel_units import units_of_columns
from needleforce.recordings.channels import Channel
from needleforce.recordings.errors import ColumnError, UnitError, readable_path
from needleforce.recordings.mapping import LEFT_OUT, ColumnMapping, ColumnSpec
from needleforce.recordings.open_recording import columns_of
from needleforce.recordings.table import STANDARD_STREAM, Table


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
        source: See `stream_tables`.
        channels: Names of the channels looked for, apart from time.
        mapping: What is known already; it stays.
        joints: The robot's, in its order.
        payload: Lines that say what hangs on the robot.

    Raises:
        RecordingError: As `read_table` does; `ColumnError` if the mapping names a
            column that is not there.
    """
    known = mapping or ColumnMapping()
    names = list(channels)
    title = f"Mapping of {Path(source).name}; edit it, then: --mapping FILE"
    lines = [comment_line(title), ""]
    if known.rate_hz is not None:
        lines += [f"rate_hz = {known.rate_hz}", ""]

    table = columns_of(source, known)
    if str(source) != STANDARD_STREAM and is_bag(readable_path(source)):
        _, counts = bag_head(Path(source))
        is_time_needed = "time" in known.channels
        reference = known.reference_topic or max(counts, key=counts.__getitem__)
        names_of = [each for each in table.joint_names.values() if {*joints} <= {*each}]
        order = known.joint_order or (joints if names_of else ())
        lines += [comment_line(f"  {each}: {n} messages") for each, n in counts.items()]
        lines += ["", f"reference_topic = {json.dumps(reference)}"]
        lines += [f"joints = {json.dumps(list(order))}", ""] if order else [""]
    else:
        known = ChannelRequest(known).with_layout(table).mapping
        is_time_needed = known.rate_hz is None

    if payload:
        lines += [*payload, ""]
    if is_time_needed:
        names = ["time", *names]

    return "\n".join([*lines, *mapping_text(table, names, known)])


def comment_line(text: str) -> str:
    """Return a comment for TOML.

    Names in it come from files and must not end its line.
    """
    return "# " + "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def mapping_text(
    table: Table, channels: Iterable[str], known: ColumnMapping
) -> list[str]:
    """Return a table's mapping as lines of TOML; unused columns stand in comments.

    Args:
        table: With rows or without.
        channels: Names of the channels looked for.
        known: Where it says which columns a channel is, that stays.
    """
    lines: list[str] = []
    used: set[str] = set()
    for name in channels:
        if name in known.left_out:
            lines += [
                f"[{name}]",
                f"columns = {json.dumps(LEFT_OUT)}  # not read",
                "",
            ]
            continue

        channel = known.knowledge.channels[name]
        lines += [*_channel_lines(table, channel, known, used), ""]

    unused = [name for name in table.columns if name not in used]
    if unused:
        lines.append("# Columns that are not used:")
        for name in unused:
            values = table.columns[name]
            span = f"[0] to [{values.shape[1] - 1}]" if values.ndim == 2 else ""
            lines.append(comment_line(f"  {name}{span}"))

        lines.append("")

    return lines


def _channel_lines(
    table: Table, channel: Channel, known: ColumnMapping, used: set[str]
) -> list[str]:
    """Return a channel as a table of TOML, and add its columns to the used ones.

    Where it is not known which columns it is, all stands in comments, with the reason.
    """
    spec = known.channels.get(channel.name)
    reason = f"not found; {channel.meaning}"
    try:
        names = ChannelRequest(known).find(table, channel)
    except ColumnError as error:
        if spec is not None:
            raise

        names = []
        reason = " ".join(str(error).split(";")[0].split())

    if not names:
        return [
            comment_line(reason),
            f"# [{channel.name}]",
            '# columns = ""',
            f'# unit = "{channel.si_unit}"',
        ]

    used |= set(names)
    joint_note = ", or one for each joint" if channel.per_joint else ""
    return [
        f"[{channel.name}]  # {channel.meaning}",
        f"columns = {json.dumps(names[0] if len(names) == 1 else names)}",
        _unit_line(table, channel, spec, names),
        f"scale = {json.dumps(spec.scale if spec else 1.0)}  # -1.0 turns the sign"
        f"{joint_note}",
    ]


def _unit_line(
    table: Table, channel: Channel, spec: ColumnSpec | None, names: Sequence[str]
) -> str:
    """Return the line of TOML that says the unit of a channel's columns."""
    try:
        columns = units_of_columns(table, channel, names, spec)
    except UnitError as error:
        return comment_line(str(error))

    units = {column.unit for column in columns}
    if len(units) > 1:
        return "# No unit for all: they are those of the names."

    (unit,) = units
    sources = dict.fromkeys(column.source for column in columns)
    note = f"{', '.join(sources)}; of {', '.join(channel.units)}"
    return f"unit = {json.dumps(unit)}  # {note}"
