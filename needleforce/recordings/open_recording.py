"""Opening a recording, whatever its format: as a table, as tables of rows, or a log."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from needleforce.recordings.bags.messages import BAG_SUFFIXES, is_bag
from needleforce.recordings.bags.tables import bag_tables
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channels import KNOWLEDGE, Knowledge
from needleforce.recordings.columnar import ARROW_SUFFIXES, arrow_tables, read_npz
from needleforce.recordings.csv_file import CSV_SUFFIXES, csv_tables
from needleforce.recordings.errors import (
    KNOWN_SUFFIX,
    MAX_BYTES,
    FileAccessError,
    RecordingError,
    file_errors,
    readable_path,
    require_size,
)
from needleforce.recordings.follow import (
    BINARY,
    STANDARD_STREAM,
    FollowOptions,
    byte_blocks,
    head_of,
)
from needleforce.recordings.joint_names import order_joints
from needleforce.recordings.log import Log
from needleforce.recordings.log_stream import LogStream
from needleforce.recordings.mapping import ColumnMapping, load_layouts
from needleforce.recordings.table import Table


def read_table(path: str | Path, *, max_bytes: int = MAX_BYTES) -> Table:
    """Read a file's columns as they stand, in its units, without saying what they mean.

    Args:
        path: a file ending in `.csv`, `.tsv` or `.txt` (also with `.gz`), `.dat`,
            `.asc` or `.lvm`; in `.npz`, `.parquet` or `.feather`; or a ROS bag: a file
            ending in `.mcap`, `.db3` or `.bag`, or a folder of them.
        max_bytes: the most memory that the content of the file may take.

    Raises:
        FileAccessError: the file cannot be read, or its suffix is not known.
        FormatError: nothing usable is in it, or it is larger than `max_bytes`.
    """
    tables: list[Table] = []
    size = 0
    for table in stream_tables(path, FollowOptions(), max_bytes=max_bytes):
        tables.append(table)
        size += sum(values.nbytes for values in table.columns.values())
        require_size(size, max_bytes, "the recording")

    first = tables[0]
    if len(tables) == 1:
        return first

    with_rows = [table for table in tables if len(table)] or tables[:1]
    warnings = dict.fromkeys(note for table in tables for note in table.warnings)
    columns = {
        name: np.concatenate([table.columns[name] for table in with_rows])
        for name in first.columns
    }
    return replace(first, columns=columns, warnings=tuple(warnings))


def read_log(
    path: str | Path,
    mapping: ColumnMapping | None = None,
    *,
    required: Iterable[str] = (),
    optional: Iterable[str] = (),
    joints: Iterable[str] = (),
    layouts: Iterable[str | Path] = (),
    max_bytes: int = MAX_BYTES,
) -> Log:
    """Read a recording into SI units; its `warnings` say what is wrong with it.

    The log has all rows of a `LogStream`.

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
        max_bytes: the most memory that the content of the file may take.

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
        mapping=mapping,
        required=tuple(required),
        optional=tuple(optional),
        joints=tuple(joints),
    )
    tables = stream_tables(path, FollowOptions(), request, max_bytes=max_bytes)
    return LogStream(tables, request).joined(max_bytes)


def stream_tables(
    source: str | Path,
    options: FollowOptions,
    request: ChannelRequest | None = None,
    *,
    knowledge: Knowledge = KNOWLEDGE,
    max_bytes: int = MAX_BYTES,
) -> Iterator[Table]:
    """Read a recording as it comes, so that memory stays bounded.

    Only npz and Feather are held as a whole.

    Args:
        source: a file, see `read_table`, or `-` for standard input: CSV, plain or
            compressed, as it comes; any other format, known by how it begins, when all
            of it has come.
        options: how long more is waited for; any source is left when it says to stop.
        request: what is read of a bag; of other sources everything is.
        knowledge: names, units and layouts that are known, where there is no request.
        max_bytes: the most memory that the rows of one table may take, or a file that
            is read as a whole; and the most bytes that come through a pipe, if it is no
            text.

    Yields:
        Tables of consecutive rows with equal columns, the first with `HEAD_ROWS` rows
        at least, if there are so many; the last may have none, but warnings.

    Raises:
        RecordingError: see `read_table`; or the source is to be followed, but neither
            text nor MCAP (`FileAccessError`).
    """
    path = None if str(source) == STANDARD_STREAM else readable_path(source)
    is_file = path is not None and not path.is_fifo()
    if path is not None and is_file and not path.name.lower().endswith(CSV_SUFFIXES):
        for table in _binary_tables(path, options, request, max_bytes):
            yield table
            if options.should_stop() and not options.follow:
                return

        return

    name = "standard input" if path is None else str(path)
    head, blocks = head_of(byte_blocks(path, options))
    if head in BINARY and not is_file:
        file_name = f"{Path(name).name}{BINARY[head]}"
        with TemporaryDirectory() as folder:
            copy = Path(folder) / file_name
            with file_errors(copy, "write"), copy.open("wb") as file:
                for block in blocks:
                    file.write(block)
                    subject = f"{name}: what comes through it"
                    require_size(file.tell(), max_bytes, subject)

            whole = replace(options, follow=False)
            try:
                yield from stream_tables(
                    copy, whole, request, knowledge=knowledge, max_bytes=max_bytes
                )
            except RecordingError as error:
                raise error.reworded(str(error).replace(str(copy), name)) from error

        return

    knowledge = knowledge if request is None else request.mapping.knowledge
    tables = csv_tables(blocks, name, options, max_bytes, knowledge)
    yield from _put_joints_in_order(tables, request)


def _put_joints_in_order(
    tables: Iterable[Table], request: ChannelRequest | None
) -> Iterator[Table]:
    """Yield tables whose columns of joints are in the order that is asked for.

    What is said of a group of joints is said once, of its first column.

    Raises:
        ColumnError: The tables lack a joint of the mapping.
    """
    known: set[tuple[str, ...]] = set()
    for table in tables:
        if request is None or not table.joint_names:
            yield table
            continue

        columns = dict(table.columns)
        joint_names = dict(table.joint_names)
        notes: list[str] = []
        for name, joints in table.joint_names.items():
            order, noted = order_joints(name, joints, request.mapping, request.joints)
            columns[name] = columns[name][:, [joints.index(joint) for joint in order]]
            joint_names[name] = order
            if joints not in known:
                notes += noted
                known.add(joints)

        yield replace(
            table,
            columns=columns,
            joint_names=joint_names,
            warnings=(*table.warnings, *notes),
        )


def _binary_tables(
    path: Path, options: FollowOptions, request: ChannelRequest | None, max_bytes: int
) -> Iterator[Table]:
    """Read a file that is no text by its suffix, or a folder."""
    name = path.name.lower()
    if options.follow:
        _require_followable(path)

    with file_errors(path):
        holds_messages = is_bag(path)

    if holds_messages:
        yield from bag_tables(path, request, options, max_bytes)
    elif name.endswith(".npz"):
        yield read_npz(path, max_bytes)
    elif name.endswith(ARROW_SUFFIXES):
        yield from arrow_tables(path, max_bytes)
    else:
        with file_errors(path):
            conversion = KNOWLEDGE.conversion_of(path)

        if conversion:
            raise FileAccessError(
                f"{path} is not read as it is", f"To convert it, {conversion}"
            )

        suffixes = (*CSV_SUFFIXES, ".npz", *ARROW_SUFFIXES, *BAG_SUFFIXES)
        raise FileAccessError(
            f"{path} has no known suffix; known are: {', '.join(suffixes)}",
            KNOWN_SUFFIX,
        )


def _require_followable(path: Path) -> None:
    """Raise `FileAccessError` if a recording that is no text cannot be followed."""
    fault = "cannot be followed while it grows; only CSV and MCAP can"
    if path.is_dir():
        fault = "is a folder, which cannot be followed while it grows"
    elif path.name.lower().endswith(".mcap"):
        return

    raise FileAccessError(
        f"{path} {fault}",
        "Record CSV or MCAP (ros2 bag record -s mcap) and name the file itself, or "
        "read it when it is complete.",
    )
