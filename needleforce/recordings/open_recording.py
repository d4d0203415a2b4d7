"""Opening a recording, whatever its format: as a table or a log."""

import re
import sys
from collections.abc import Iterable
from dataclasses import replace
from os.path import commonprefix
from pathlib import Path

import numpy as np

from needleforce.recordings.bag_file import BAG_SUFFIXES, bag_head, is_bag, read_bag
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.columnar import (
    ARROW_SUFFIXES,
    CONTAINER_SUFFIXES,
    read_arrow,
    read_container,
    read_npz,
)
from needleforce.recordings.errors import (
    KNOWN_SUFFIX,
    FileAccessError,
    FormatError,
    file_errors,
    readable_path,
)
from needleforce.recordings.log import Log, log_of_table, read_times, time_unit
from needleforce.recordings.mapping import ColumnMapping, load_layouts
from needleforce.recordings.table import STANDARD_STREAM, Table
from needleforce.recordings.text_file import CSV_SUFFIXES, read_text
from needleforce.recordings.time_stamps import to_nanoseconds

SUFFIXES = (
    *CSV_SUFFIXES,
    ".npz",
    *ARROW_SUFFIXES,
    *CONTAINER_SUFFIXES,
    *BAG_SUFFIXES,
)
"""Of the files that are read."""


def read_table(
    path: str | Path,
    request: ChannelRequest | None = None,
) -> Table:
    """Read a file's columns as they stand, in its units, without saying what they mean.

    Args:
        path: a file ending in `.csv`, `.tsv` or `.txt` (also with `.gz`), `.dat`,
            `.asc` or `.lvm`; in `.npz`, `.parquet`, `.feather`, `.h5`, `.hdf5`, `.mat`
            or `.tdms`; a ROS bag: a file ending in `.mcap`, `.db3` or `.bag`, or a
            folder of them; a folder with one file for each signal; or `-` for CSV on
            standard input.
        request: what is read of a bag, and in which order joints are; all without.

    Raises:
        FileAccessError: the file cannot be read, or its suffix is not known.
        FormatError: nothing usable is in it.
    """
    request = request or ChannelRequest()
    if str(path) != STANDARD_STREAM and is_bag(readable_path(path)):
        return read_bag(Path(path), lambda head: _select(head, request))

    if str(path) != STANDARD_STREAM and Path(path).is_dir():
        table = _read_folder(Path(path), request)
    else:
        table = _read_file(path, request)
    if not table.columns:
        raise FormatError(f"{path} holds no column of numbers{table.left_out()}")

    return request.in_joint_order(table)


def _select(head: Table, request: ChannelRequest) -> Table:
    """Return the columns of a bag that are needed, joints in the order asked for."""
    is_whole = request == ChannelRequest()
    needed = head.columns.keys() if is_whole else request.columns(head) or ()
    columns = {name: head.columns[name] for name in head.columns if name in needed}
    return request.in_joint_order(replace(head, columns=columns))


def _read_file(path: str | Path, request: ChannelRequest) -> Table:
    """Return the table of a file that is no bag; raises as `read_table` does."""
    knowledge = request.mapping.knowledge
    if str(path) == STANDARD_STREAM:
        return read_text(sys.stdin.buffer.read(), "stdin", knowledge)

    path = Path(path)
    name = path.name.lower()
    with file_errors(path):
        if path.is_fifo() or name.endswith(CSV_SUFFIXES):
            return read_text(path.read_bytes(), str(path), knowledge)
        if name.endswith(".npz"):
            return read_npz(path)
        if name.endswith(ARROW_SUFFIXES):
            return read_arrow(path)
        if name.endswith(CONTAINER_SUFFIXES):
            return read_container(path)

    if conversion := knowledge.conversions.get(path.suffix.lower()):
        raise FileAccessError(
            f"{path} is not read as it is", f"To read it, {conversion}."
        )

    raise FileAccessError(
        f"{path} has no known suffix; known are: {', '.join(SUFFIXES)}", KNOWN_SUFFIX
    )


def _read_folder(folder: Path, request: ChannelRequest) -> Table:
    """Return the signals of the files in a folder, each with the clock of its file.

    Columns are called after their file, without what all files' names begin with. The
    columns of a file without a header are one signal, the first of them the time.

    Raises:
        RecordingError: A file cannot be read, or has no time stamps.
    """
    paths = [p for p in sorted(folder.iterdir()) if p.name.lower().endswith(SUFFIXES)]
    stems = [path.name.partition(".")[0] for path in paths]
    # Characters are meant, not parts of a path.
    start = commonprefix(stems)  # noqa: RUF071
    start = re.sub(r"[^\W_]*$", "", start) if len(paths) > 1 else ""
    whole = Table(columns={})
    for path, stem in zip(paths, stems, strict=True):
        name = stem.removeprefix(start)
        table = _read_file(path, request)
        columns = dict(table.columns)
        if "column_1" in columns:
            first, *others = columns.values()
            columns = {"t_s": first, name: np.column_stack(others)}
            table = replace(table, columns=columns, warnings=())

        time = time_unit(table, request.with_layout(table))
        t_s, start_ns = read_times(table, request.channels["time"], time)
        is_row = np.isfinite(t_s)
        signals = {
            column if column == name else f"{name}/{column}": values[is_row]
            for column, values in columns.items()
            if column not in time.columns
        }
        units = {f"{name}/{column}": unit for column, unit in table.units.items()}
        whole = replace(
            whole,
            columns={**whole.columns, **signals},
            units={**whole.units, **units},
            clocks={**whole.clocks, **dict.fromkeys(signals, name)},
            stamps_ns={**whole.stamps_ns, name: to_nanoseconds(t_s[is_row], start_ns)},
            warnings=(*whole.warnings, *(f"{name}: {each}" for each in table.warnings)),
        )

    return whole


def columns_of(path: str | Path, mapping: ColumnMapping) -> Table:
    """Return the columns of a recording, a bag's without rows; see `read_table`."""
    if str(path) != STANDARD_STREAM and is_bag(readable_path(path)):
        return bag_head(Path(path))

    return read_table(path, ChannelRequest(mapping))


def read_log(
    path: str | Path,
    mapping: ColumnMapping | None = None,
    *,
    required: Iterable[str] = (),
    optional: Iterable[str] = (),
    joints: Iterable[str] = (),
    layouts: Iterable[str | Path] = (),
) -> Log:
    """Read a recording into SI units; its `warnings` say what is wrong with it.

    Args:
        path: see `read_table`.
        mapping: which columns are which channels; channels it does not list, or all
            without a mapping, are found by their usual names.
        required: channels that must be there: `q`, `dq`, `tau`, `tau_ext`, `depth`,
            `speed`, `force`.
        optional: channels taken if they are there. With neither given, all are
            optional.
        joints: names of the robot's joints; a recording that names joints is put into
            this order.
        layouts: TOML files that add words, units and layouts to those that are known.

    Raises:
        RecordingError: see `read_table`; or time, a required or a mapped channel was
            not found or is ambiguous (`ColumnError`), a channel name is unknown or a
            scale does not fit its columns (`MappingError`), or the channels do not form
            a log (`LogError`).
    """
    mapping = mapping or ColumnMapping()
    if layouts:
        mapping = replace(mapping, knowledge=load_layouts(*layouts))

    request = ChannelRequest(mapping, tuple(required), tuple(optional), tuple(joints))
    return log_of_table(read_table(path, request), request)
