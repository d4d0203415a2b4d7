"""Which columns of a log are which channels, and which joints it has."""

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from needleforce import recordings
from needleforce.cli.kept_joints import LogJoints
from needleforce.cli.shared_options import Columns
from needleforce.cli.terminal import CommandError
from needleforce.recordings import ColumnError, ColumnMapping
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.mapping import parse_column_spec
from needleforce.recordings.table import STANDARD_STREAM


def is_pipe(source: str) -> bool:
    """Return whether a recording can be read only once."""
    return source == STANDARD_STREAM or Path(source).is_fifo()


def mapping_from_options(columns: Columns) -> ColumnMapping:
    """Return the mapping that options and mapping file give together; options win."""
    knowledge = recordings.load_layouts(*columns.layout)
    base = ColumnMapping(knowledge=knowledge)
    if columns.mapping:
        base = recordings.load_mapping(columns.mapping, knowledge)
    from_options = {
        name: parse_column_spec(text, channel)
        for name, channel in knowledge.channels.items()
        if (text := getattr(columns, name, None)) is not None
    }
    channels = {**base.channels, **from_options}
    rate_hz = base.rate_hz if columns.rate is None else columns.rate
    if "time" in from_options:
        rate_hz = columns.rate
    elif columns.rate is not None:
        channels.pop("time", None)
    within_s = columns.sort_within
    return replace(
        base,
        joints=getattr(columns, "joints", None) or base.joints,
        channels=channels,
        rate_hz=rate_hz,
        sort_within_s=base.sort_within_s if within_s is None else within_s,
    )


def has_channels(source: str, columns: Columns, channels: Iterable[str]) -> bool:
    """Return whether a recording has columns for all of these channels.

    Args:
        source: The recording as the command line names it.
        columns: Which columns are which channels.
        channels: Names of channels.

    Raises:
        CommandError: The recording is a pipe, which can be read only once.
        ColumnError: It has columns for neither these channels nor depth and force.
    """
    if is_pipe(source):
        raise CommandError(
            "a report needs a file, not a pipe: write what comes into a file first"
        )
    mapping = mapping_from_options(columns)
    table = recordings.columns_of(source, mapping)
    required = tuple(channels)
    try:
        return ChannelRequest(mapping, required).columns(table) is not None
    except ColumnError:
        layers = ChannelRequest(mapping, ("depth", "force"))
        if mapping.channels.keys() & {*required} or layers.columns(table) is None:
            raise
        # `identify` asks for no joints, so it does not matter how many might fit.
        return False


def find_log_joints(source: str, mapping: ColumnMapping) -> LogJoints:
    """Return the joints of a log: those of the mapping, else those that it names.

    Args:
        source: The log as the command line names it; a pipe is not looked at.
        mapping: Which columns are which channels.
    """
    if mapping.joint_order:
        return LogJoints(mapping.joint_order, len(mapping.joint_order))
    if is_pipe(source):
        return LogJoints()
    table = recordings.columns_of(source, mapping)
    positions = frozenset(table.joint_names)
    with suppress(ColumnError):  # several would fit, which reading the log will say
        positions = ChannelRequest(mapping, ("q",)).columns(table) or frozenset()
    names: dict[str, None] = {}
    count = 0
    for column in sorted(positions):
        names |= dict.fromkeys(table.joint_names.get(column, ()))
        values = table.columns.get(column)
        count += 1 if values is None or values.ndim == 1 else values.shape[1]
    return LogJoints(tuple(names), count or None)
