"""Opening a recording, whatever its format: as a table, a log or a mapping."""

import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from os.path import commonprefix
from pathlib import Path

import numpy as np

from needleforce.recordings.bag_file import BAG_SUFFIXES, is_bag, read_bag
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channels import LEFT_OUT, ColumnMapping, load_layouts
from needleforce.recordings.columnar import (
    ARROW_SUFFIXES,
    CONTAINER_SUFFIXES,
    read_arrow,
    read_container,
    read_npz,
)
from needleforce.recordings.errors import (
    KNOWN_SUFFIX,
    ColumnError,
    FileAccessError,
    FormatError,
    RecordingError,
    UnitError,
    UnpackedSize,
    file_errors,
    readable_path,
)
from needleforce.recordings.log import (
    Log,
    count_rows,
    log_of_table,
    ordered_rows,
    read_times,
)
from needleforce.recordings.table import STANDARD_STREAM, Table
from needleforce.recordings.text_file import CSV_SUFFIXES, read_text
from needleforce.recordings.time_stamps import to_nanoseconds

Source = str | Path | Sequence[str | Path]
"""A recording: a file, a folder with a file for each signal, or such files."""

READERS: dict[str, Callable[[Path, UnpackedSize], Table]] = {
    ".npz": read_npz,
    **dict.fromkeys(ARROW_SUFFIXES, read_arrow),
    **dict.fromkeys(CONTAINER_SUFFIXES, read_container),
}
"""By the suffix of files that are neither text nor bags."""

SUFFIXES = (*CSV_SUFFIXES, *READERS, *BAG_SUFFIXES)
"""Of the files that are read."""


def read_table(source: Source, request: ChannelRequest | None = None) -> Table:
    """Read a file's columns as they stand, in its units, without saying what they mean.

    Args:
        source: a file ending in `.csv`, `.tsv` or `.txt` (also with `.gz`), `.dat`,
            `.asc` or `.lvm`; in `.npz`, `.parquet`, `.feather`, `.h5`, `.hdf5`, `.mat`
            or `.tdms`; a ROS bag: a file ending in `.mcap`, `.db3` (both also with
            `.zstd`) or `.bag`, or a folder of them; a folder with one file for each
            signal, or a list of such files; or `-` for CSV on standard input.
        request: what is read of a bag, and in which order joints are; all without.

    Raises:
        FileAccessError: the file cannot be read, or its suffix is not known.
        FormatError: nothing usable is in it, or it takes too much memory unpacked.
    """
    request = request or ChannelRequest()
    paths = paths_of(source)
    unpacked = UnpackedSize()
    if all(map(is_bag, paths)):
        return read_bag(paths, lambda head: _select(head, request), unpacked)

    if paths[0].is_dir():
        table = _read_files(_files_in(paths[0]), request, unpacked)
    elif len(paths) > 1:
        table = _read_files(paths, request, unpacked)
    else:
        table = _read_file(paths[0], request, unpacked)
    if not table.columns:
        raise FormatError(f"{source} holds no column of numbers{table.left_out()}")

    return request.in_joint_order(table)


def paths_of(source: Source) -> list[Path]:
    """Return the paths of a recording; `FileAccessError` if one is a device."""
    sources = [source] if isinstance(source, str | Path) else source
    return [readable_path(each) for each in sources]


def _files_in(folder: Path) -> list[Path]:
    """Return the files in a folder that can be read."""
    with file_errors(folder):
        files = sorted(folder.iterdir())

    return [file for file in files if file.name.lower().endswith(SUFFIXES)]


def _select(head: Table, request: ChannelRequest) -> Table:
    """Return the columns of a bag that are needed, joints in the order asked for."""
    is_whole = request == ChannelRequest()
    needed = head.columns.keys() if is_whole else request.columns(head) or ()
    columns = {name: head.columns[name] for name in head.columns if name in needed}
    return request.in_joint_order(replace(head, columns=columns))


def _read_file(path: Path, request: ChannelRequest, unpacked: UnpackedSize) -> Table:
    """Return the table of one file; raises as `read_table` does."""
    knowledge = request.mapping.knowledge
    if is_bag(path):
        return read_bag([path], lambda head: head, unpacked)

    with file_errors(path):
        if str(path) == STANDARD_STREAM:
            return read_text(sys.stdin.buffer.read(), "stdin", knowledge, unpacked)
        if path.is_fifo() or path.name.lower().endswith(CSV_SUFFIXES):
            return read_text(path.read_bytes(), str(path), knowledge, unpacked)
        if reader := READERS.get(path.suffix.lower()):
            return reader(path, unpacked)
        path.stat()  # a name that is not there may lack its suffix

    raise FileAccessError(
        f"{path} has no known suffix; known are: {', '.join(SUFFIXES)}", KNOWN_SUFFIX
    )


def _read_files(
    paths: Sequence[Path], request: ChannelRequest, unpacked: UnpackedSize
) -> Table:
    """Return the signals of several files, each with the clock of its file.

    If the mapping has a rate, rows are numbered, and there are no clocks.

    Raises:
        RecordingError: A file cannot be read, has no usable time stamps, or is called
            as another one.
    """
    stems = [Path(path.name.removesuffix(".gz")).stem for path in paths]
    # What all begin with is the name of the run. Characters are meant, no path.
    start = commonprefix(stems) if len(paths) > 1 else ""  # noqa: RUF071
    run = re.sub(r"[^\W_]*$", "", start)
    whole = Table(columns={})
    for path, stem in zip(paths, stems, strict=True):
        table = _read_file(path, request, unpacked)
        try:
            if not table.clocks:
                table = _with_clock(table, stem.removeprefix(run), request)
        except RecordingError as error:
            raise error.reworded(f"{path}: {error}") from error

        if shared := whole.stamps_ns.keys() & table.stamps_ns.keys():
            taken = ", ".join(shared)
            raise FormatError(f"{path}: another file has signals of {taken}, too")

        whole = Table(
            columns={**whole.columns, **table.columns},
            joint_names={**whole.joint_names, **table.joint_names},
            units={**whole.units, **table.units},
            clocks={**whole.clocks, **table.clocks},
            stamps_ns={**whole.stamps_ns, **table.stamps_ns},
            warnings=(*whole.warnings, *table.warnings),
        )

    if request.mapping.rate_hz is not None:
        return replace(whole, clocks={}, stamps_ns={})

    return whole


def _with_clock(table: Table, name: str, request: ChannelRequest) -> Table:
    """Return the signals of one of several files, called after it, with its clock.

    The columns of a file without a header are one signal; the time is the first of
    them, or those that the mapping names.

    Args:
        table: The columns of the file.
        name: Of the file.
        request: Tells the time stamps.

    Raises:
        RecordingError: There are no time stamps, no signal beside them, or one with
            more or fewer rows.
    """
    has_header = not all(column.startswith("column_") for column in table.columns)
    if not has_header and "time" not in request.mapping.channels:
        table = replace(
            table,
            columns={
                "time" if column == "column_1" else column: values
                for column, values in table.columns.items()
            },
        )

    has_rate = request.mapping.rate_hz is not None
    request = request.with_layout(table)
    channel = request.channels["time"]
    time = request.find(table, channel) if has_rate else request.find_time(table)
    columns = {
        column: values
        for column, values in table.columns.items()
        if time is None or column not in time.columns
    }
    if not columns:
        raise FormatError("expected time stamps and a signal")
    if not has_header:
        count_rows(table, table.columns)
        signal = np.column_stack([*columns.values()])
        columns = {name: signal if signal.shape[1] > 1 else signal[:, 0]}

    stamps_ns = np.empty(0, np.int64)
    notes = [] if has_header else ["column_1 counts as the time and was left out"]
    if time and not has_rate:
        t_s, start_ns = read_times(table, request, time, table.columns)
        first = next(iter(columns.values()))
        rows, t_s, notes = ordered_rows(t_s, first, channel, time)
        stamps_ns = to_nanoseconds(t_s, start_ns)
        columns = {column: values[rows] for column, values in columns.items()}

    names = {old: old if old == name else f"{name}/{old}" for old in columns}
    return Table(
        columns={names[old]: values for old, values in columns.items()},
        joint_names={
            new: table.joint_names[old]
            for old, new in names.items()
            if old in table.joint_names
        },
        units={
            new: table.units[old] for old, new in names.items() if old in table.units
        },
        clocks=dict.fromkeys(names.values(), name),
        stamps_ns={name: stamps_ns},
        warnings=tuple(
            f"{name}: {note}"
            for note in (*table.warnings, *notes)
            if "no header" not in note  # the name of the file stands for it
        ),
    )


def columns_of(source: Source, mapping: ColumnMapping) -> Table:
    """Return the columns of a recording, a bag's without rows; see `read_table`."""
    paths = paths_of(source)
    if all(map(is_bag, paths)):
        return read_bag(paths, lambda head: replace(head, columns={}), UnpackedSize())

    return read_table(source, ChannelRequest(mapping))


def read_log(
    source: Source,
    mapping: ColumnMapping | None = None,
    *,
    required: Iterable[str] = (),
    optional: Iterable[str] = (),
    named: Iterable[str] = (),
    joints: Iterable[str] = (),
    layouts: Iterable[str | Path] = (),
) -> Log:
    """Read a recording into SI units; its `warnings` say what is wrong with it.

    Args:
        source: see `read_table`.
        mapping: which columns are which channels; channels it does not list, or all
            without a mapping, are found by their usual names.
        required: channels that must be there: `q`, `dq`, `tau`, `tau_ext`, `depth`,
            `speed`, `force`.
        optional: channels taken if they are there. With neither given, all are
            optional.
        named: channels taken if the mapping or the layout names their columns.
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

    request = ChannelRequest(
        mapping, tuple(required), tuple(optional), tuple(joints), tuple(named)
    )
    return log_of_table(read_table(source, request), request)


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
