"""The formats that tables are written in: CSV, npz, Parquet and MCAP."""

import csv
import io
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from typing import Any, BinaryIO

import numpy as np

from needleforce.recordings.bag_topics import bag_topics, standard_types
from needleforce.recordings.errors import (
    EQUAL_COLUMNS,
    LogError,
    optional_library,
)
from needleforce.recordings.table import (
    START_KEY,
    TableColumns,
    TableLabels,
    flat_columns,
)
from needleforce.recordings.time_stamps import to_nanoseconds

Append = Callable[[TableColumns], None]
"""Writes rows of checked columns, the same in every call."""

Writer = Callable[[BinaryIO, TableLabels, TableColumns], AbstractContextManager[Append]]
"""Begins a table of these columns, here without rows, gives what writes rows, and
finishes it."""


@contextmanager
def csv_writer(
    stream: BinaryIO, labels: TableLabels, empty: TableColumns
) -> Iterator[Append]:
    """Write a header and rows that read back bit for bit.

    The start of the clock is a comment.
    """
    header = io.StringIO()
    if labels.start_ns:
        header.write(f"# {START_KEY} = {labels.start_ns}\n")

    csv.writer(header, lineterminator="\n").writerow(flat_columns(empty))
    stream.write(header.getvalue().encode())

    def append(columns: TableColumns) -> None:
        # The shortest texts that read back to the same numbers; truth values as 0, 1.
        columns_as_text = (
            map(repr, (values * 1 if values.dtype.kind == "b" else values).tolist())
            for values in flat_columns(columns).values()
        )
        if lines := [",".join(row) for row in zip(*columns_as_text, strict=True)]:
            stream.write(("\n".join(lines) + "\n").encode())

        stream.flush()  # for readers of a file that grows

    yield append


@contextmanager
def npz_writer(
    stream: BinaryIO, labels: TableLabels, empty: TableColumns
) -> Iterator[Append]:
    """Collect rows in memory, and write the archive at the end.

    It cannot be appended to.
    """
    chunks: dict[str, list[np.ndarray]] = {name: [] for name in empty}

    def append(columns: TableColumns) -> None:
        for name, values in columns.items():
            chunks[name].append(np.array(values))

    yield append
    arrays = {name: np.concatenate(values) for name, values in chunks.items()}
    if labels.start_ns:
        arrays[START_KEY] = np.array(labels.start_ns, dtype=np.int64)

    # numpy.savez could not write a column called "file".
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values)


@contextmanager
def parquet_writer(
    stream: BinaryIO, labels: TableLabels, empty: TableColumns
) -> Iterator[Append]:
    """Write each chunk as a row group.

    Two-dimensional columns become numbered ones, as in CSV.
    """
    arrow = optional_library("pyarrow", "Parquet files")
    parquet = optional_library("pyarrow.parquet", "Parquet files")
    metadata = {START_KEY: str(labels.start_ns)} if labels.start_ns else {}
    schema = arrow.table(flat_columns(empty), metadata=metadata).schema
    writer = parquet.ParquetWriter(stream, schema, write_page_checksum=True)

    def append(columns: TableColumns) -> None:
        table = arrow.table(flat_columns(columns))
        if table.num_rows:
            writer.write_table(table)

    yield append
    # Writes the table of contents, without which the file cannot be read.
    writer.close()


@contextmanager
def mcap_writer(
    stream: BinaryIO, labels: TableLabels, empty: TableColumns
) -> Iterator[Append]:
    """Write one MCAP file, compressed, with checksums.

    Each row becomes a message on each topic.

    Raises:
        LogError: There is no time stamp `t_s`, or one that no message can carry.
    """
    types = standard_types()
    library = optional_library("mcap.writer", "MCAP files")
    # Rows that come at once make a chunk, or several of 64 KiB.
    bag = library.Writer(stream, chunk_size=1 << 16, enable_data_crcs=True)
    bag.start(profile="ros2", library="needleforce")
    channels = [
        _register(bag, topic.name, topic.kind)
        for topic in bag_topics(empty, labels, ())
    ]
    is_first = True

    def append(columns: TableColumns) -> None:
        stamps_ns = _message_stamps_ns(columns, labels)
        nonlocal is_first
        if is_first and stamps_ns and labels.robot_description:
            kind = "std_msgs/msg/String"
            channel = _register(bag, "/robot_description", kind)
            message = types.types[kind](labels.robot_description)
            data = types.serialize_cdr(message, kind)
            bag.add_message(channel, stamps_ns[0], data, stamps_ns[0])

        is_first = is_first and not stamps_ns
        topics = bag_topics(columns, labels, stamps_ns)
        rows = (topic.messages for topic in topics)
        for stamp_ns, *messages in zip(stamps_ns, *rows, strict=True):
            for channel, message in zip(channels, messages, strict=True):
                if message is not None:
                    data = types.serialize_cdr(message, message.__msgtype__)
                    bag.add_message(channel, stamp_ns, data, stamp_ns)

        bag.flush()  # for readers of a file that grows, and if this process is killed

    yield append
    bag.finish()  # writes the index


def _register(bag: Any, name: str, kind: str) -> int:
    """Announce a topic, with its type, in a bag that is written; return its number."""
    definition, _ = standard_types().generate_msgdef(kind, ros_version=2)
    schema = bag.register_schema(kind, "ros2msg", definition.encode())
    return bag.register_channel(name, "cdr", schema)


def _message_stamps_ns(columns: TableColumns, labels: TableLabels) -> list[int]:
    """Return the time stamps of rows as messages carry them.

    Raises:
        LogError: There are none, or one is not finite or before zero.
    """
    t_s = columns.get("t_s")
    stamps_ns = [-1]
    if t_s is not None and t_s.ndim == 1 and np.isfinite(t_s).all():
        stamps_ns = to_nanoseconds(t_s, labels.start_ns).tolist()
    if min(stamps_ns, default=0) < 0:
        raise LogError(
            "a bag needs a column t_s with a finite time stamp from zero on in every "
            f"row; there is {list(columns)}",
            EQUAL_COLUMNS,
        )

    return stamps_ns


WRITERS: Mapping[str, Writer] = {
    ".csv": csv_writer,
    ".npz": npz_writer,
    ".parquet": parquet_writer,
    ".mcap": mcap_writer,
}
"""Writers by the suffix of a file."""
