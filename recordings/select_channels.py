"""From a table to a log: the mapping applied."""

from collections.abc import Iterable, Mapping

import numpy as np

from recordings.clock.time_channel import find_time
from recordings.columns.channel import CHANNELS, Channel
from recordings.columns.mapping import ColumnMapping
from recordings.columns.si_channel import SiChannel, find_si_channel
from recordings.columns.unit_hints import unit_hints
from recordings.errors import ColumnError, LogError, MappingError
from recordings.log import Log
from recordings.tables.table import Table


def select_channels(
    table: Table,
    mapping: ColumnMapping,
    required: Iterable[str] = (),
    optional: Iterable[str] = (),
) -> Log:
    """Return the log that a mapping makes of a table.

    Args:
        table: the file's columns.
        mapping: which columns are which channels; others are found by their usual names.
        required: channel names (keys of `CHANNELS`) that must be there.
        optional: channel names taken if they are there. With neither given, all channels are
            optional.

    Returns:
        The log in SI units. Rows without a finite time stamp are left out, with a warning.

    Raises:
        ColumnError: time, a required or a mapped channel was not found, or is ambiguous.
        MappingError: a channel name is unknown, or a scale does not fit its columns.
        LogError: the channels do not form a log.
    """
    selected, notes = find_channels(table, mapping, required, optional)
    rows = len(next(iter(selected.values())).values)
    time, told = find_time(table, mapping, rows)
    everything = {"t_s": time, **selected}
    check_sizes(everything)
    hints = unit_hints({k: f.values for k, f in everything.items() if not f.is_unit_stated})
    keep = np.isfinite(time.values)
    if not keep.all():
        told += (without_stamp(np.flatnonzero(~keep).size, int(np.argmin(keep))),)
    return Log(
        t_s=time.values[keep],
        channels={key: found.values[keep] for key, found in selected.items()},
        warnings=(*table.warnings, *notes, *told, *hints),
        start_ns=table.start_ns or time.start_ns,
    )


def find_channels(
    table: Table,
    mapping: ColumnMapping,
    required: Iterable[str] = (),
    optional: Iterable[str] = (),
) -> tuple[dict[str, SiChannel], tuple[str, ...]]:
    """Return the channels that a table has, by their key in a `Log`, and what was left out.

    Args:
        table: the file's columns.
        mapping: see `select_channels`.
        required: see `select_channels`.
        optional: see `select_channels`.

    Raises:
        ColumnError: a required or a mapped channel was not found, or is ambiguous.
        MappingError: a channel name is unknown, or a scale does not fit its columns.
        LogError: the columns of a channel differ in length.
    """
    required, optional = tuple(required), tuple(optional)
    _check_names((*required, *optional))
    if not (required or optional):
        optional = _names()
    selected: dict[str, SiChannel] = {}
    notes: tuple[str, ...] = ()
    missing: list[Channel] = []
    for name in (*required, *optional):
        found = find_si_channel(table, CHANNELS[name], mapping.channels.get(name))
        if found is None:
            missing += [CHANNELS[name]] * (name in required)
        elif name in required or name in mapping.channels or np.isfinite(found.values).any():
            selected[CHANNELS[name].key] = found
        else:
            notes += (f"{name}: its columns hold no finite value and were left out",)
    if missing:
        raise _missing(table, *missing)
    if not selected:
        raise ColumnError(f"no channel was recognised. Columns are: {table.describe()}")
    return selected, notes


def _names() -> tuple[str, ...]:
    return tuple(name for name in CHANNELS if name != "time")


def _check_names(names: tuple[str, ...]) -> None:
    for name in names:
        if name not in _names():
            raise MappingError(f"unknown channel {name!r}; channels are: {', '.join(_names())}")


def _missing(table: Table, channel: Channel, *others: Channel) -> ColumnError:
    also = ", ".join(f"{other.name} ({other.meaning})" for other in others)
    return ColumnError(
        f"no column found for {channel.name} ({channel.meaning}); usual names are "
        f"{', '.join(channel.spellings)}. Say which one with --{channel.name}, or under "
        f"{channel.name} in the mapping. {f'Nor for {also}. ' if also else ''}"
        f"Columns are: {table.describe()}{table.left_out()}"
    )


def without_stamp(rows: int, first: int) -> str:
    """Say how many rows have no time stamp.

    Args:
        rows: how many.
        first: the first of them, counted from 0.
    """
    return f"time: rows without a stamp, left out: {rows} (first: row {first + 1})"


def check_sizes(channels: Mapping[str, SiChannel], *, is_part: bool = False) -> None:
    """Check that channels belong together.

    Args:
        channels: by their key in a `Log`.
        is_part: whether more rows may follow.

    Raises:
        LogError: they differ in length or in the number of joints.
    """
    shapes = {key: found.values.shape for key, found in channels.items()}
    if len({shape[0] for shape in shapes.values()}) > 1:
        most = max(shape[0] for shape in shapes.values())
        more = " or more" if is_part else ""
        lengths = ", ".join(
            f"{key} {shape[0]}{more if shape[0] == most else ''}" for key, shape in shapes.items()
        )
        turned = [
            f"; {key} has {shape[0]} rows of {shape[1]}: is it transposed?"
            for key, shape in shapes.items()
            if len(shape) == 2 and shape[0] < shape[1]
        ]
        raise LogError(f"channels differ in length, in rows: {lengths}{''.join(turned)}")
    joints = {key: shape[1] for key, shape in shapes.items() if len(shape) == 2}
    if len(set(joints.values())) > 1:
        widths = ", ".join(f"{key} {width}" for key, width in joints.items())
        raise LogError(f"channels differ in the number of joints: {widths}")
