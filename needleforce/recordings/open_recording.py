"""Opening a recording, whatever its format: as one table, as tables of its rows, or as a log.

npz and Parquet are read here, held in memory as a whole; pickled objects are never loaded. Columns
that hold no numbers, or are damaged, are left out, with a warning.
"""

import json
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

import numpy as np

from needleforce.recordings.bag_messages import BAG_SUFFIXES, is_bag
from needleforce.recordings.bag_reader import Bag, bag_tables, learn_topics
from needleforce.recordings.csv_file import CSV_SUFFIXES, csv_tables
from needleforce.recordings.errors import (
    MAX_BYTES,
    ColumnError,
    FileAccessError,
    FormatError,
    RecordingError,
    file_errors,
    optional_library,
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
from needleforce.recordings.log import Log, LogStream
from needleforce.recordings.mapping import ChannelRequest, ColumnMapping, comment_line, mapping_text
from needleforce.recordings.table import START_KEY, Table, start_of_clock, to_seconds

SUFFIXES = (*CSV_SUFFIXES, ".npz", ".parquet", *BAG_SUFFIXES)  # what can be read
_CUT = "so that nothing can be read without its end"


def read_table(path: str | Path, *, max_bytes: int = MAX_BYTES) -> Table:
    """Read a file's columns as they stand, in its units, without saying what they mean.

    Args:
        path: a file ending in `.csv`, `.tsv` or `.txt` (the first two also with `.gz`), `.npz` or
            `.parquet`; or a ROS 2 bag: a file ending in `.mcap` or `.db3`, or a folder of them.
        max_bytes: the most memory that the content of the file may take.

    Raises:
        FileAccessError: the file cannot be read, or its suffix is not known.
        FormatError: nothing usable is in it, or it is larger than `max_bytes`.
    """
    parts, size = list[Table](), 0
    for table in stream_tables(path, FollowOptions(), max_bytes=max_bytes):
        parts.append(table)
        size += sum(values.nbytes for values in table.columns.values())
        require_size(size, max_bytes, "the recording")
    if len(parts) == 1:
        return parts[0]
    names = parts[0].columns
    filled = [part for part in parts if len(part)] or parts[:1]
    warnings = tuple(dict.fromkeys(note for part in parts for note in part.warnings))
    columns = {name: np.concatenate([part.columns[name] for part in filled]) for name in names}
    return replace(parts[0], columns=columns, warnings=warnings)


def read_log(
    path: str | Path,
    mapping: ColumnMapping | None = None,
    *,
    required: Iterable[str] = (),
    optional: Iterable[str] = (),
    joints: Iterable[str] = (),
    max_bytes: int = MAX_BYTES,
) -> Log:
    """Read a recording into SI units: all rows of its `LogStream`; `warnings` say what is wrong.

    Args:
        path: see `read_table`.
        mapping: which columns are which channels; channels it does not list, or all without a
            mapping, are found by their usual names.
        required: channels that must be there: `q`, `dq`, `tau`, `tau_ext`, `depth`, `speed`,
            `force`.
        optional: channels taken if they are there. With neither given, all are optional.
        joints: names of the robot's joints; a recording that names joints is put into this order.
        max_bytes: the most memory that the content of the file may take.

    Raises:
        RecordingError: see `read_table`; or time, a required or a mapped channel was not found or
            is ambiguous (`ColumnError`), a channel name is unknown or a scale does not fit its
            columns (`MappingError`), or the channels do not form a log (`LogError`).
    """
    asked = tuple(required), tuple(optional), tuple(joints)
    request = ChannelRequest(mapping or ColumnMapping(), *asked)
    tables = stream_tables(path, FollowOptions(), request, max_bytes=max_bytes)
    return LogStream(tables, request).joined(max_bytes)


def stream_tables(
    source: str | Path,
    options: FollowOptions,
    request: ChannelRequest | None = None,
    *,
    max_bytes: int = MAX_BYTES,
) -> Iterator[Table]:
    """Read a recording as it comes, so that memory stays bounded (but for npz and Parquet).

    Args:
        source: a file, see `read_table`, or `-` for standard input: CSV, plain or compressed, as
            it comes; any other format, known by how it begins, when all of it has come.
        options: how long more is waited for; any source is left when it says to stop.
        request: what is read of a bag; of other sources everything is.
        max_bytes: the most memory that the rows of one table may take, or a file that is read as
            a whole; and the most bytes that come through a pipe, if it is no text.

    Yields:
        Tables of consecutive rows with equal columns, the first with `HEAD_ROWS` rows at least,
        if there are so many; the last may have none, but warnings.

    Raises:
        RecordingError: see `read_table`; or the source is to be followed, but neither text nor
            MCAP (`FileAccessError`).
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
        # It is not read in the order of its bytes.
        with TemporaryDirectory() as folder:
            copy = Path(folder) / f"{Path(name).name}{BINARY[head]}"
            whole = replace(options, follow=False)
            with file_errors(copy, "write"), copy.open("wb") as file:
                for block in blocks:
                    file.write(block)
                    require_size(file.tell(), max_bytes, f"{name}: what comes through it")
            try:
                yield from stream_tables(copy, whole, request, max_bytes=max_bytes)
            except RecordingError as error:
                raise type(error)(str(error).replace(str(copy), name)) from error
        return
    yield from csv_tables(blocks, name, options, max_bytes)


def _binary_tables(
    path: Path, options: FollowOptions, request: ChannelRequest | None, max_bytes: int
) -> Iterator[Table]:
    name = path.name.lower()
    if options.follow and path.is_dir():
        raise FileAccessError(
            f"{path} is a folder, which cannot be followed while it grows; name the .mcap file in "
            "it, or read it when it is complete"
        )
    if options.follow and not name.endswith(".mcap"):
        raise FileAccessError(
            f"{path} cannot be followed while it grows; only CSV and MCAP can. Record one of them "
            "(ros2 bag record -s mcap), or read it when it is complete"
        )
    with file_errors(path):
        holds_messages = is_bag(path)
    if holds_messages:
        yield from bag_tables(path, request, options, max_bytes)
    elif name.endswith((".npz", ".parquet")):
        yield (_read_npz if name.endswith(".npz") else _read_parquet)(path, max_bytes)
    else:
        raise FileAccessError(f"{path} has no known suffix; known are: {', '.join(SUFFIXES)}")


def _read_npz(path: Path, max_bytes: int) -> Table:
    """Read an npz archive: arrays of numbers become columns, single numbers do not."""
    with file_errors(path):
        try:
            with zipfile.ZipFile(path) as archive:
                return _npz_table(path, archive, max_bytes)
        except (zipfile.BadZipFile, NotImplementedError) as error:
            raise FormatError(
                f"{path} is not an npz archive, or it is cut short: an npz file ends with its "
                f"table of contents, {_CUT}"
            ) from error


def _npz_table(path: Path, archive: zipfile.ZipFile, max_bytes: int) -> Table:
    arrays: dict[str, np.ndarray] = {}
    warnings: list[str] = []
    total = 0
    for member in archive.namelist():
        name = member.removesuffix(".npy")
        try:
            with archive.open(member) as stream:
                total += _npy_size(stream)
            require_size(total, max_bytes, f"{path}: what its arrays hold")
            with archive.open(member) as stream:
                arrays[name] = np.lib.format.read_array(stream, allow_pickle=False)
        except (OSError, FormatError, MemoryError):
            raise
        except Exception as error:
            # A damaged header raises whatever numpy's and Python's parsers run into.
            warnings.append(f"column {name!r} cannot be read ({error}) and was left out")
    start = arrays.get(START_KEY)
    start_ns = int(start) if start is not None and start.shape == () else 0
    columns = {name: values for name, values in arrays.items() if values.ndim}
    if not columns:
        reasons = f": {'; '.join(warnings)}" if warnings else ""
        raise FormatError(f"{path} holds no array of numbers{reasons}")
    return Table(columns=columns, warnings=tuple(warnings), start_ns=start_ns)


def _npy_size(stream: IO[bytes]) -> int:
    """Return from an array's header how many bytes it takes; `ValueError` if it is no column."""
    if np.lib.format.read_magic(stream) == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(stream)
    else:
        shape, _, dtype = np.lib.format.read_array_header_2_0(stream)
    if dtype.kind not in "fiub":
        raise ValueError(f"it holds {dtype}, no numbers")
    if len(shape) > 2 or any(n < 1 for n in shape):
        raise ValueError(f"its shape is {shape}, not (n,) or (n, k)")
    return prod(shape) * max(dtype.itemsize, 8)


def _read_parquet(path: Path, max_bytes: int) -> Table:
    """Read columns of numbers, empty cells as NaN, and time stamps, as seconds, without loss."""
    parquet = optional_library("pyarrow.parquet", "Parquet files")
    arrow = optional_library("pyarrow", "Parquet files")
    try:
        with parquet.ParquetFile(path, page_checksum_verification=True) as file:
            groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
            # Repeated numbers take no room in the file, but all of it in memory.
            values = (g.column(i).num_values for g in groups for i in range(g.num_columns))
            size = max(8 * sum(values), sum(group.total_byte_size for group in groups))
            require_size(size, max_bytes, f"{path}: what it holds")
            return _parquet_table(path, file, arrow)
    except (arrow.ArrowException, UnicodeDecodeError, OSError) as error:
        # Arrow's own failures come as OSError too, but have no number.
        if getattr(error, "errno", None) is not None:
            with file_errors(path):
                raise
        raise FormatError(
            f"{path} is not a Parquet file, or it is damaged or cut short: a Parquet file ends "
            f"with its table of contents, {_CUT} ({error})"
        ) from error


def _parquet_table(path: Path, file: Any, arrow: Any) -> Table:
    columns: dict[str, np.ndarray] = {}
    warnings, types, seconds = [], arrow.types, frozenset[str]()
    start_ns = int((file.schema_arrow.metadata or {}).get(START_KEY.encode(), 0))
    for name in file.schema_arrow.names if file.metadata.num_rows else ():
        cells = file.read(columns=[name]).column(0).combine_chunks()
        if types.is_timestamp(cells.type):
            nanoseconds = cells.cast(arrow.timestamp("ns", cells.type.tz)).cast(arrow.int64())
            is_known = cells.is_valid().to_numpy(zero_copy_only=False)
            stamps_ns = nanoseconds.fill_null(0).to_numpy(zero_copy_only=False)
            if is_known.any():
                start_ns = start_ns or start_of_clock(int(stamps_ns[is_known][0]))
            columns[name] = np.where(is_known, to_seconds(stamps_ns, start_ns), np.nan)
            seconds |= {name}
            continue
        try:
            if types.is_string(cells.type) or types.is_large_string(cells.type):
                raise TypeError("text, which a cast would read as numbers")
            if not types.is_integer(cells.type) or cells.null_count:
                # Without the check of `safe`, which refuses integers that a double rounds.
                cells = cells.cast(arrow.float64(), safe=False)
            columns[name] = cells.to_numpy(zero_copy_only=False)  # empty ones are NaN
        except (arrow.ArrowInvalid, arrow.ArrowNotImplementedError, TypeError):
            warnings.append(f"column {name!r} holds {cells.type}, no numbers, and was left out")
    if not columns:
        left_out = "".join(f" ({warning})" for warning in warnings)
        raise FormatError(f"{path} holds {file.metadata.num_rows} rows without numbers{left_out}")
    return Table(columns=columns, warnings=tuple(warnings), start_ns=start_ns, seconds=seconds)


def suggest_mapping(
    source: str | Path,
    channels: Iterable[str],
    *,
    mapping: ColumnMapping | None = None,
    joints: Sequence[str] = (),
    payload: Sequence[str] = (),
) -> str:
    """Return a mapping of a recording as TOML to be edited, with what else there is as comments.

    Channels, apart from time, are looked for where the known mapping does not say which columns
    they are; joints are the robot's, and lines of the payload say what hangs on it. Raises as
    `read_table`; `ColumnError` if the mapping names a column that is not there.
    """
    known, names = mapping or ColumnMapping(), list(channels)
    lines = [comment_line(f"Mapping of {Path(source).name}; edit it, then: --mapping FILE"), ""]
    lines += [f"rate_hz = {known.rate_hz}", ""] if known.rate_hz is not None else []
    is_time_wanted = "time" in known.channels
    if str(source) != STANDARD_STREAM and is_bag(readable_path(source)):
        bag = Bag(Path(source))
        learn_topics(bag)
        table = bag.table()
        lines += ["# Topics:", *(comment_line(f"  {t.describe()}") for t in bag.topics.values())]
        lines += [*map(comment_line, bag.warnings), ""]
        lines += _bag_head(bag, table, names, joints, known)
    else:
        table, is_time_wanted = next(stream_tables(source, FollowOptions())), known.rate_hz is None
    lines += [*payload, ""] if payload else []
    names = ["time", *names] if is_time_wanted else names
    return "\n".join([*lines, *mapping_text(table, names, known)])


def _bag_head(
    bag: Bag, table: Table, channels: Sequence[str], joints: Sequence[str], known: ColumnMapping
) -> list[str]:
    """Say whose messages are the rows, and the order of joints; what is known stays."""
    columns: set[str] = set()
    for name in channels:
        with suppress(ColumnError):  # several would fit, which the mapping will say
            columns |= ChannelRequest(known, optional=(name,)).columns(table) or set()
    topics = [topic for topic in bag.topics.values() if topic.columns.keys() & columns]
    if not topics:
        return []
    reference = known.reference_topic or max(topics, key=lambda topic: topic.count).name
    lines = [
        "# Rows are the messages of this topic; others are interpolated to its time stamps.",
        f"reference_topic = {json.dumps(reference)}",
    ]
    here = list(dict.fromkeys(joint for topic in topics for joint in topic.joint_names))
    if here:
        order = known.joints or (joints if joints and set(joints) <= set(here) else here)
        lines.append("# Joints in the order of the robot; they are found by these names.")
        if list(order) != list(joints) and joints:
            lines.append(comment_line(f"The robot calls them: {', '.join(joints)}"))
        lines.append(f"joints = {json.dumps(list(order))}")
    return [*lines, ""]
