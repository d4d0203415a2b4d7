"""Opening a recording, whatever its format: as a table or a log."""

import sys
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from needleforce.recordings.bag_file import BAG_SUFFIXES, bag_head, is_bag, read_bag
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.columnar import ARROW_SUFFIXES, read_arrow, read_npz
from needleforce.recordings.errors import (
    MAX_BYTES,
    FileAccessError,
    FormatError,
    file_errors,
    readable_path,
)
from needleforce.recordings.log import Log, log_of_table
from needleforce.recordings.mapping import ColumnMapping, load_layouts
from needleforce.recordings.table import STANDARD_STREAM, Table
from needleforce.recordings.text_file import CSV_SUFFIXES, read_text


def read_table(
    path: str | Path,
    request: ChannelRequest | None = None,
    *,
    max_bytes: int = MAX_BYTES,
) -> Table:
    """Read a file's columns as they stand, in its units, without saying what they mean.

    Args:
        path: a file ending in `.csv`, `.tsv` or `.txt` (also with `.gz`), `.dat`,
            `.asc` or `.lvm`; in `.npz`, `.parquet` or `.feather`; a ROS bag: a file
            ending in `.mcap`, `.db3` or `.bag`, or a folder of them; or `-` for CSV on
            standard input.
        request: what is read of a bag, and in which order joints are; all without.
        max_bytes: the most memory that the content of the file may take.

    Raises:
        FileAccessError: the file cannot be read, or its suffix is not known.
        FormatError: nothing usable is in it, or it is larger than `max_bytes`.
    """
    request = request or ChannelRequest()
    if str(path) != STANDARD_STREAM and is_bag(readable_path(path)):
        return read_bag(Path(path), lambda head: _select(head, request), max_bytes)

    table = _read_file(path, request, max_bytes)
    if not table.columns:
        raise FormatError(f"{path} holds no column of numbers{table.left_out()}")

    return request.in_joint_order(table)


def _select(head: Table, request: ChannelRequest) -> Table:
    """Return the columns of a bag that are needed, joints in the order asked for."""
    is_whole = request == ChannelRequest()
    needed = head.columns.keys() if is_whole else request.columns(head) or ()
    columns = {name: head.columns[name] for name in head.columns if name in needed}
    known = {
        channel: kept
        for channel, names in head.known.items()
        if (kept := tuple(name for name in names if name in needed))
    }
    return request.in_joint_order(replace(head, columns=columns, known=known))


def _read_file(path: str | Path, request: ChannelRequest, max_bytes: int) -> Table:
    """Return the table of a file that is no bag; raises as `read_table` does."""
    knowledge = request.mapping.knowledge
    if str(path) == STANDARD_STREAM:
        data = sys.stdin.buffer.read(max_bytes + 1)
        return read_text(data, "stdin", knowledge, max_bytes)

    path = Path(path)
    name = path.name.lower()
    with file_errors(path):
        if path.is_fifo() or name.endswith(CSV_SUFFIXES):
            with path.open("rb") as stream:
                data = stream.read(max_bytes + 1)

            return read_text(data, str(path), knowledge, max_bytes)
        if name.endswith(".npz"):
            return read_npz(path, max_bytes)
        if name.endswith(ARROW_SUFFIXES):
            return read_arrow(path, max_bytes)

        content = sorted(path.iterdir()) if path.is_dir() else []

    for suffix in (path.suffix.lower(), *(each.suffix for each in content)):
        if conversion := knowledge.conversions.get(suffix):
            raise FileAccessError(
                f"{path} is not read as it is", f"To read it, {conversion}."
            )

    known = ", ".join((*CSV_SUFFIXES, ".npz", *ARROW_SUFFIXES, *BAG_SUFFIXES))
    raise FileAccessError(
        f"{path} has no known suffix; known are: {known}",
        "Give one file: write signals of several files as columns of one table.",
    )


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
    max_bytes: int = MAX_BYTES,
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

    request = ChannelRequest(mapping, tuple(required), tuple(optional), tuple(joints))
    return log_of_table(read_table(path, request, max_bytes=max_bytes), request)
