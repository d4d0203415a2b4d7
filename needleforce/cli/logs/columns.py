"""Which columns of a log are which channels, and which joints it has."""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np

from needleforce import recordings
from needleforce.cli.options import Columns, DepthColumns, RobotOptions
from needleforce.cli.robot import robot_from_options
from needleforce.cli.terminal import CHOOSE_TARE, CommandError
from needleforce.recordings import (
    ChannelRequest,
    ColumnError,
    ColumnMapping,
    Log,
    UnitError,
    parse_column_spec,
)
from needleforce.recordings.channel_request import ChannelUnit
from needleforce.recordings.channels import Channel
from needleforce.recordings.table import STANDARD_STREAM
from needleforce.session_replay import TareWindow
from urdf import Robot


def is_pipe(source: Sequence[str]) -> bool:
    """Return whether a recording can be read only once."""
    return any(each == STANDARD_STREAM or Path(each).is_fifo() for each in source)


def name_log(source: Sequence[str]) -> str:
    """Return what a log is called in figures and on pages."""
    if source[0] == STANDARD_STREAM:
        return "standard input"
    more = f" and {len(source) - 1} more" if len(source) > 1 else ""
    return f"{Path(source[0]).name}{more}"


def mapping_from_options(columns: Columns) -> ColumnMapping:
    """Return the mapping that options and mapping file give together; options win."""
    knowledge = recordings.load_layouts(*columns.layout)
    base = ColumnMapping(knowledge=knowledge)
    if columns.mapping:
        base = recordings.load_mapping(columns.mapping, knowledge)
    texts = {name: getattr(columns, name, None) for name in knowledge.channels}
    options = ColumnMapping(
        channels={
            name: parse_column_spec(text, knowledge.channels[name])
            for name, text in texts.items()
            if text is not None
        },
        rate_hz=columns.rate,
        joints=getattr(columns, "joints", None) or (),
        knowledge=knowledge,
    )
    return base.updated(options)


def parse_window(option: str, text: str, first_s: float) -> TareWindow:
    """Return the seconds of a log that an option names.

    Args:
        option: Its name, for messages.
        text: Its value, START:END; a time with + counts from the first row, a missing
            start is the log's, as a missing end is but for a tare.
        first_s: Time of the log's first row [s].

    Raises:
        CommandError: The text names no window.
    """
    start, colon, end = (word.strip() for word in text.partition(":"))
    is_tare = option == "--tare"
    words = (start or "+0", end or ("inf" if colon and not is_tare else ""))
    try:
        times_s = [first_s * word.startswith("+") + float(word) for word in words]
    except ValueError as error:
        advice = CHOOSE_TARE if is_tare else ""
        raise CommandError(f"{option} {text}: expected START:END", advice) from error
    return TareWindow(*times_s)


def add_constant_speed(log: Log, text: str, channel: Channel) -> Log:
    """Return a log with the depth of a needle at constant speed since its first row.

    Args:
        log: Without a depth and a speed.
        text: The speed, a number and its unit.
        channel: That of speeds, with their units.

    Raises:
        CommandError: The text is no speed above zero, or the log has a depth or a
            speed.
    """
    match = re.fullmatch(r"\s*(\d*\.?\d+(?:e[-+]?\d+)?)\s*(\D.*)", text, re.IGNORECASE)
    spelled = channel.units.find(match[2]) if match else None
    speed_m_s = float(match[1]) * channel.units[spelled] if match and spelled else 0.0
    if not 0.0 < speed_m_s <= channel.at_most:
        raise CommandError(
            f"--constant-speed {text}: expected a speed and its unit, one of "
            f"{', '.join(channel.units)}, as in 2.3mm/s"
        )
    for unit in log.units:
        if unit.channel in ("depth", "speed"):
            raise CommandError(
                f"--constant-speed {text}: the log has a {unit.channel}: {unit}",
                f"Leave the option out, or that column: --{unit.channel} none",
            )
    channels = {
        **log.channels,
        "depth_m": speed_m_s * (log.t_s - log.t_s[0]),
        "speed_m_s": np.full(len(log), speed_m_s),
    }
    column = f"{text} since the first row"
    unit = ChannelUnit("depth", (column,), ("m",), ("--constant-speed",))
    return replace(log, channels=channels, units=(*log.units, unit))


def needle_channels(columns: DepthColumns) -> tuple[str, ...]:
    """Return the channels that `identify` cannot do without."""
    return ("depth", "force") if columns.constant_speed is None else ("force",)


def depth_channels(mapping: ColumnMapping) -> tuple[str, ...]:
    """Return what is read beside depth and force.

    What `needleforce force` states of the axial force holds for no other force.
    """
    channels = ("speed", "force_std", "force_status", "force_warnings")
    force_spec = mapping.channels.get("force")
    if force_spec is None or "axial" in force_spec.patterns[0].lower():
        return channels
    return ("speed", *(name for name in channels[1:] if name in mapping.channels))


def has_channels(
    source: Sequence[str],
    mapping: ColumnMapping,
    channels: Sequence[str],
    others: Sequence[str],
) -> bool:
    """Return whether a recording has columns for all of these channels.

    Args:
        source: The recording as the command line names it.
        mapping: Which columns are which channels.
        channels: Names of channels.
        others: Names of channels that it may have in their place.

    Raises:
        CommandError: The recording is a pipe, which can be read only once.
        ColumnError: It has columns for neither these channels nor the others.
    """
    if is_pipe(source):
        raise CommandError(
            "a report needs a file, not a pipe: write what comes into a file first"
        )
    table = recordings.columns_of(source, mapping)
    try:
        return ChannelRequest(mapping, tuple(channels)).columns(table) is not None
    except (ColumnError, UnitError):
        if ChannelRequest(mapping, tuple(others)).columns(table) is None:
            raise
        # `identify` asks for no joints, so it does not matter how many might fit.
        return False


def _joints_of_log(
    source: Sequence[str], mapping: ColumnMapping
) -> tuple[str | None, ...]:
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
    return tuple(
        joint
        for name in sorted(positions)
        for joint in table.joint_names.get(name, (None,) * table.width(name))
    )


def robot_of_log(
    source: Sequence[str],
    mapping: ColumnMapping,
    options: RobotOptions,
    file: str | None,
) -> Robot:
    """Return the robot of the options; the log may say which joints it has.

    Args:
        source: The log as the command line names it.
        mapping: Which columns are which channels.
        options: Options that describe the robot.
        file: File of the mapping, which may name the payload.
    """
    joints = _joints_of_log(source, mapping) if options.lock_others else ()
    return robot_from_options(options, file, joints)
