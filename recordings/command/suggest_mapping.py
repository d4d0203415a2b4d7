"""A mapping for a given recording, as text to be edited: what `--print-config` writes."""

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

from recordings.bag_storage.files import is_bag
from recordings.bags.plan import survey_table
from recordings.bags.survey import BagSurvey, survey_bag
from recordings.columns.channel import CHANNELS, Channel
from recordings.columns.detect import detect_columns
from recordings.columns.find import FoundColumn, find_columns
from recordings.columns.mapping import ColumnMapping
from recordings.columns.name import parse_column_name
from recordings.columns.spec import ColumnSpec
from recordings.errors import ColumnError
from recordings.sources.byte_source import Patience
from recordings.table_stream import stream_tables
from recordings.tables.table import Table


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
        source: see `stream_tables`.
        channels: the channels that are looked for, apart from time.
        mapping: what is known already; only what it does not say is looked for.
        joints: the robot's joints in its order.
        payload: lines that say what hangs on the robot.

    Raises:
        FileAccessError: the recording cannot be read.
        FormatError: nothing usable is in it.
        ColumnError: the mapping names a column that is not there.
    """
    known = mapping or ColumnMapping()
    lines = [f"# Mapping of {Path(source).name}; edit it, then: --mapping FILE", ""]
    if str(source) != "-" and is_bag(Path(source)):
        survey = survey_bag(Path(source))
        table = survey_table(survey)
        lines += _topics(survey)
        lines += _head(survey, table, channels, joints)
        wanted = list(channels)
    else:
        table = next(stream_tables(source, Patience()))
        wanted = ["time", *channels] if known.rate_hz is None else list(channels)
        lines += [] if known.rate_hz is None else [f"rate_hz = {known.rate_hz}", ""]
    lines += [*payload, ""] if payload else []
    used: set[str] = set()
    for name in wanted:
        lines += [*_channel(table, CHANNELS[name], known.channels.get(name), used), ""]
    if left := [name for name in table.columns if name not in used]:
        lines += [
            "# Columns that are not used:",
            *(f"#   {_told(table, name)}" for name in left),
            "",
        ]
    return "\n".join(lines)


def _topics(survey: BagSurvey) -> list[str]:
    lines = ["# Topics:"]
    for name, found in survey.topics.items():
        what = found.fault or ("source stamps" if found.has_stamp else "stamps of the recorder")
        what = what if found.columns or found.fault else "no numbers"
        count = f"{found.count} messages, {found.rate_hz:.4g} Hz"
        lines.append(f"#   {name}: {found.topic.kind}, {count}, {what}")
    lines += [f"# {warning}" for warning in survey.warnings]
    return [*lines, ""]


def _head(
    survey: BagSurvey, table: Table, channels: Iterable[str], joints: Sequence[str]
) -> list[str]:
    """Say whose messages are the rows, and the order of joints."""
    columns: set[str] = set()
    for name in channels:
        columns |= {column.name for column in _detected(table, CHANNELS[name])[0]}
    topics = [n for n, found in survey.topics.items() if found.columns.keys() & columns]
    lines = []
    if topics:
        clock = max(topics, key=lambda name: survey.topics[name].count)
        lines = [
            "# Rows are the messages of this topic; others are interpolated to its time stamps.",
            f"clock = {json.dumps(clock)}",
        ]
    here = list(dict.fromkeys(j for n in topics for j in survey.topics[n].joints))
    if here:
        order = joints if joints and set(joints) <= set(here) else here
        lines.append("# Joints in the order of the robot; they are found by these names.")
        if list(order) != list(joints) and joints:
            lines.append(f"# The robot calls them: {', '.join(joints)}")
        lines.append(f"joints = {json.dumps(list(order))}")
    return [*lines, ""] if lines else []


def _channel(table: Table, channel: Channel, spec: ColumnSpec | None, used: set[str]) -> list[str]:
    if spec is None:
        found, trouble = _detected(table, channel)
    else:
        found, trouble = tuple(c for p in spec.patterns for c in find_columns(table, p)), ""
    if not found:
        lines = [f"[{channel.name}]", 'columns = ""', f'unit = "{channel.si_unit}"']
        reason = trouble or f"not found; {channel.meaning}"
        return [f"# {reason}", *(f"# {line}" for line in lines)]
    used |= {column.name for column in found}
    names = [column.name for column in found]
    units = {parse_column_name(name, channel.units).unit for name in names}
    stated = spec.unit if spec is not None else None
    unit = stated or (units.pop() if len(units) == 1 else None)
    scale = json.dumps(spec.scale if spec is not None else 1.0)
    others = ", ".join(channel.units)
    told = f"  # of {others}" if unit else f"  # assumed; of {others}"
    return [
        f"[{channel.name}]  # {channel.meaning}",
        f"columns = {json.dumps(names[0] if len(names) == 1 else names)}",
        f"unit = {json.dumps(unit or channel.si_unit)}{told}",
        f"scale = {scale}  # -1.0 turns the sign" + (", or one for each joint" * channel.per_joint),
    ]


def _detected(table: Table, channel: Channel) -> tuple[tuple[FoundColumn, ...], str]:
    """Return the columns of a channel, or why none was chosen."""
    try:
        return detect_columns(table, channel), ""
    except ColumnError as error:
        return (), " ".join(str(error).split(";")[0].split())


def _told(table: Table, name: str) -> str:
    values = table.columns[name]
    if values.ndim == 1:
        return name
    return f"{name}[0] to [{values.shape[1] - 1}]"
