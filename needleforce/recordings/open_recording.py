"""Opening a recording, whatever its format: as one table, as tables of its rows, or
as a log.
"""

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from needleforce.recordings.bag_messages import BAG_SUFFIXES, is_bag
from needleforce.recordings.bag_reader import Bag, bag_tables, learn_topics
from needleforce.recordings.columnar import read_npz, read_parquet
from needleforce.recordings.csv_file import CSV_SUFFIXES, csv_tables
from needleforce.recordings.errors import (
    MAX_BYTES,
    ColumnError,
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
from needleforce.recordings.log import Log, LogStream
from needleforce.recordings.mapping import (
    ChannelRequest,
    ColumnMapping,
    comment_line,
    mapping_text,
)
from needleforce.recordings.table import Table

SUFFIXES = (*CSV_SUFFIXES, ".npz", ".parquet", *BAG_SUFFIXES)  # what can be read


def read_table(path: str | Path, *, max_bytes: int = MAX_BYTES) -> Table:
    """Read a file's columns as they stand, in its units, without saying what they mean.

    Args:
        path: a file ending in `.csv`, `.tsv` or `.txt` (the first two also with `.gz`),
            `.npz` or `.parquet`; or a ROS 2 bag: a file ending in `.mcap` or `.db3`, or
            a folder of them.
        max_bytes: the most memory that the content of the file may take.

    Raises:
        FileAccessError: the file cannot be read, or its suffix is not known.
        FormatError: nothing usable is in it, or it is larger than `max_bytes`.
    """
    parts = list[Table]()
    size = 0
    for table in stream_tables(path, FollowOptions(), max_bytes=max_bytes):
        parts.append(table)
        size += sum(values.nbytes for values in table.columns.values())
        require_size(size, max_bytes, "the recording")
    if len(parts) == 1:
        return parts[0]
    names = parts[0].columns
    filled = [part for part in parts if len(part)] or parts[:1]
    warnings = tuple(dict.fromkeys(note for part in parts for note in part.warnings))
    columns = {
        name: np.concatenate([part.columns[name] for part in filled]) for name in names
    }
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
    """Read a recording into SI units: all rows of its `LogStream`; `warnings` say what
    is wrong.

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
        max_bytes: the most memory that the content of the file may take.

    Raises:
        RecordingError: see `read_table`; or time, a required or a mapped channel was
            not found or is ambiguous (`ColumnError`), a channel name is unknown or a
            scale does not fit its columns (`MappingError`), or the channels do not form
            a log (`LogError`).
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
    """Read a recording as it comes, so that memory stays bounded (but for npz and
    Parquet).

    Args:
        source: a file, see `read_table`, or `-` for standard input: CSV, plain or
            compressed, as it comes; any other format, known by how it begins, when all
            of it has come.
        options: how long more is waited for; any source is left when it says to stop.
        request: what is read of a bag; of other sources everything is.
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
        # It is not read in the order of its bytes.
        with TemporaryDirectory() as folder:
            copy = Path(folder) / f"{Path(name).name}{BINARY[head]}"
            whole = replace(options, follow=False)
            with file_errors(copy, "write"), copy.open("wb") as file:
                for block in blocks:
                    file.write(block)
                    require_size(
                        file.tell(), max_bytes, f"{name}: what comes through it"
                    )
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
        yield (read_npz if name.endswith(".npz") else read_parquet)(path, max_bytes)
    else:
        raise FileAccessError(
            f"{path} has no known suffix; known are: {', '.join(SUFFIXES)}"
        )


def suggest_mapping(
    source: str | Path,
    channels: Iterable[str],
    *,
    mapping: ColumnMapping | None = None,
    joints: Sequence[str] = (),
    payload: Sequence[str] = (),
) -> str:
    """Return a mapping of a recording as TOML to be edited, with what else there is as
    comments.

    Channels, apart from time, are looked for where the known mapping does not say which
    columns they are; joints are the robot's, and lines of the payload say what hangs on
    it. Raises as `read_table`; `ColumnError` if the mapping names a column that is not
    there.
    """
    known = mapping or ColumnMapping()
    names = list(channels)
    lines = [
        comment_line(f"Mapping of {Path(source).name}; edit it, then: --mapping FILE"),
        "",
    ]
    lines += [f"rate_hz = {known.rate_hz}", ""] if known.rate_hz is not None else []
    is_time_wanted = "time" in known.channels
    if str(source) != STANDARD_STREAM and is_bag(readable_path(source)):
        bag = Bag(Path(source))
        learn_topics(bag)
        table = bag.table()
        lines += [
            "# Topics:",
            *(comment_line(f"  {t.describe()}") for t in bag.topics.values()),
        ]
        lines += [*map(comment_line, bag.warnings), ""]
        lines += _bag_head(bag, table, names, joints, known)
    else:
        table = next(stream_tables(source, FollowOptions()))
        is_time_wanted = known.rate_hz is None
    lines += [*payload, ""] if payload else []
    names = ["time", *names] if is_time_wanted else names
    return "\n".join([*lines, *mapping_text(table, names, known)])


def _bag_head(
    bag: Bag,
    table: Table,
    channels: Sequence[str],
    joints: Sequence[str],
    known: ColumnMapping,
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
        order = known.joints or (
            joints if joints and set(joints) <= set(here) else here
        )
        lines.append(
            "# Joints in the order of the robot; they are found by these names."
        )
        if list(order) != list(joints) and joints:
            lines.append(comment_line(f"The robot calls them: {', '.join(joints)}"))
        lines.append(f"joints = {json.dumps(list(order))}")
    return [*lines, ""]
