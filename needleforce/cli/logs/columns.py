"""Which columns of a log are which channels, and which joints it has."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from needleforce import recordings
from needleforce.cli.options import Columns, RobotOptions
from needleforce.cli.robot import robot_from_options
from needleforce.cli.terminal import CommandError
from needleforce.recordings import ChannelRequest, ColumnError, ColumnMapping
from needleforce.recordings.mapping import parse_column_spec
from needleforce.recordings.table import STANDARD_STREAM
from urdf import Robot


def is_pipe(source: str) -> bool:
    """Return whether a recording can be read only once."""
    return source == STANDARD_STREAM or Path(source).is_fifo()


def mapping_from_options(columns: Columns) -> ColumnMapping:
    """Return the mapping that options and mapping file give together; options win."""
    knowledge = recordings.load_layouts(*columns.layout)
    base = ColumnMapping(knowledge=knowledge)
    if columns.mapping:
        base = recordings.load_mapping(columns.mapping, knowledge)
    channels = dict(base.channels)
    rate_hz = base.rate_hz
    if columns.rate is not None or columns.time is not None:
        channels.pop("time", None)
        rate_hz = columns.rate
    for name, channel in knowledge.channels.items():
        if (text := getattr(columns, name, None)) is not None:
            channels[name] = parse_column_spec(text, channel)
    joints = getattr(columns, "joints", None) or base.joints
    return replace(base, joints=joints, channels=channels, rate_hz=rate_hz)


def depth_channels(mapping: ColumnMapping) -> tuple[str, ...]:
    """Return what is read beside depth and force.

    What `needleforce force` states of the axial force holds for no other force.
    """
    channels = ("speed", "force_std", "force_status", "force_warnings")
    force_spec = mapping.channels.get("force")
    if force_spec is None or "axial" in force_spec.patterns[0].lower():
        return channels
    return ("speed", *(name for name in channels[1:] if name in mapping.channels))


def has_channels(source: str, mapping: ColumnMapping, channels: Sequence[str]) -> bool:
    """Return whether a recording has columns for all of these channels.

    Args:
        source: The recording as the command line names it.
        mapping: Which columns are which channels.
        channels: Names of channels.

    Raises:
        CommandError: The recording is a pipe, which can be read only once.
        ColumnError: It has columns for neither these channels nor depth and force.
    """
    if is_pipe(source):
        raise CommandError(
            "a report needs a file, not a pipe: write what comes into a file first"
        )
    table = recordings.columns_of(source, mapping)
    try:
        return ChannelRequest(mapping, tuple(channels)).columns(table) is not None
    except ColumnError:
        if ChannelRequest(mapping, ("depth", "force")).columns(table) is None:
            raise
        # `identify` asks for no joints, so it does not matter how many might fit.
        return False


def joints_of_log(source: str, mapping: ColumnMapping) -> tuple[str | None, ...]:
    """Return the joints of a log by name: those of the mapping, else as it names them.

    Joints without a name are None. A pipe is not looked at: it has none.

    Args:
        source: The log as the command line names it.
        mapping: Which columns are which channels.
    """
    if mapping.joint_order or is_pipe(source):
        return mapping.joint_order
    table = recordings.columns_of(source, mapping)
    positions = frozenset(table.joint_names)
    with suppress(ColumnError):  # several would fit, which reading the log will say
        positions = ChannelRequest(mapping, ("q",)).columns(table) or frozenset()
    joints: list[str | None] = []
    for column in sorted(positions):
        values = table.columns.get(column)
        width = 1 if values is None or values.ndim == 1 else values.shape[1]
        joints += table.joint_names.get(column, (None,) * width)
    return tuple(joints)


def robot_of_log(
    source: str, mapping: ColumnMapping, options: RobotOptions, file: str | None
) -> Robot:
    """Return the robot of the options; the log may say which joints it has.

    Args:
        source: The log as the command line names it.
        mapping: Which columns are which channels.
        options: Options that describe the robot.
        file: File of the mapping, which may name the payload.
    """
    joints = joints_of_log(source, mapping) if options.lock_others else ()
    return robot_from_options(options, file, joints)
