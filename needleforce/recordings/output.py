"""Tables that are written: whole or not at all, or row by row for others to follow."""

import csv
import io
import sys
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from itertools import combinations
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import ArrayLike

from needleforce.files import whole_file
from needleforce.recordings.bag_messages import METADATA, is_bag
from needleforce.recordings.bag_types import CDR, bag_topics, standard_types
from needleforce.recordings.errors import (
    FileAccessError,
    LogError,
    file_errors,
    optional_library,
)
from needleforce.recordings.follow import STANDARD_STREAM
from needleforce.recordings.log import Log
from needleforce.recordings.table import (
    START_KEY,
    Columns,
    Labels,
    flat_columns,
    to_nanoseconds,
)

Append = Callable[
    [Columns], None
]  # writes rows of checked columns, the same in every call
_CHUNK_BYTES = (
    1 << 16
)  # of a bag that is written: who follows it sees rows so many at a time


@contextmanager
def csv_writer(stream: BinaryIO, labels: Labels, empty: Columns) -> Iterator[Append]:
    """Write a header and rows that read back bit for bit; the start of the clock as
    a comment.
    """
    header = io.StringIO()
    header.write(f"# {START_KEY} = {labels.start_ns}\n" if labels.start_ns else "")
    csv.writer(header, lineterminator="\n").writerow(flat_columns(empty))
    stream.write(header.getvalue().encode())

    def append(columns: Columns) -> None:
        # repr is the shortest text that reads back to the same float.
        flat = flat_columns(columns).values()
        texts = (
            map(repr, (v.astype(int) if v.dtype.kind == "b" else v).tolist())
            for v in flat
        )
        if rows := [",".join(row) for row in zip(*texts, strict=True)]:
            stream.write(("\n".join(rows) + "\n").encode())
        stream.flush()  # for readers of a file that grows

    yield append


@contextmanager
def npz_writer(stream: BinaryIO, labels: Labels, empty: Columns) -> Iterator[Append]:
    """Collect rows in memory, since an archive cannot be appended to; write it at
    the end.
    """
    parts: dict[str, list[np.ndarray]] = {name: [] for name in empty}

    def append(columns: Columns) -> None:
        for name, values in columns.items():
            parts[name].append(np.array(values))

    yield append
    arrays = {name: np.concatenate(found) for name, found in parts.items()}
    if labels.start_ns:
        arrays[START_KEY] = np.array(labels.start_ns, dtype=np.int64)
    # numpy.savez could not write a column called "file".
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values)


@contextmanager
def parquet_writer(
    stream: BinaryIO, labels: Labels, empty: Columns
) -> Iterator[Append]:
    """Write each chunk as a row group; two-dimensional columns become numbered ones,
    as in CSV.
    """
    arrow = optional_library("pyarrow", "Parquet files")
    parquet = optional_library("pyarrow.parquet", "Parquet files")
    metadata = {START_KEY: str(labels.start_ns)} if labels.start_ns else {}
    schema = arrow.table(flat_columns(empty), metadata=metadata).schema
    writer = parquet.ParquetWriter(stream, schema, write_page_checksum=True)

    def append(columns: Columns) -> None:
        if (table := arrow.table(flat_columns(columns))).num_rows:
            writer.write_table(table)

    yield append
    writer.close()  # writes the table of contents, without which the file cannot be read


@contextmanager
def mcap_writer(stream: BinaryIO, labels: Labels, empty: Columns) -> Iterator[Append]:
    """Write one MCAP file, compressed, with checksums: of each row a message on each
    topic.

    `LogError` if there is no time stamp `t_s`, or one that no message can carry.
    """
    types = standard_types()
    places = list[tuple[int, str]]()
    library = optional_library("mcap.writer", "MCAP files")
    bag = library.Writer(stream, chunk_size=_CHUNK_BYTES, enable_data_crcs=True)
    bag.start(profile="ros2", library="needleforce")
    for name, kind, _ in bag_topics(empty, labels, ()):
        text, _ = types.generate_msgdef(kind, ros_version=2)
        schema = bag.register_schema(kind, "ros2msg", text.encode())
        places.append((bag.register_channel(name, CDR, schema), kind))

    def append(columns: Columns) -> None:
        t_s = columns.get("t_s")
        if t_s is None or t_s.ndim != 1:
            raise LogError(
                f"a bag needs time stamps: a column t_s; there is {list(columns)}"
            )
        if not np.isfinite(t_s).all():
            raise LogError("a bag needs a time stamp in every row; one is not finite")
        stamps_ns = to_nanoseconds(t_s, labels.start_ns).tolist()
        if min(stamps_ns, default=0) < 0:
            raise LogError(
                f"a bag cannot hold time stamps before zero; t_s reaches {t_s.min()} s"
            )
        rows = (messages for *_, messages in bag_topics(columns, labels, stamps_ns))
        for stamp_ns, *row in zip(stamps_ns, *rows, strict=True):
            for (channel, kind), message in zip(places, row, strict=True):
                data = types.serialize_cdr(message, kind)
                bag.add_message(channel, stamp_ns, data, stamp_ns)
        stream.flush()  # for readers of a file that grows

    yield append
    bag.finish()  # writes the index


Writer = Callable[[BinaryIO, Labels, Columns], AbstractContextManager[Append]]
"""Begins a table of these columns, here without rows, gives what writes rows, and
finishes it."""

WRITERS: Mapping[str, Writer] = {
    ".csv": csv_writer,
    ".npz": npz_writer,
    ".parquet": parquet_writer,
    ".mcap": mcap_writer,
}
"""By the suffix of a file."""


def checked_columns(columns: Mapping[str, ArrayLike]) -> Columns:
    """Return columns as arrays; `LogError` if `write_table` cannot write them."""
    arrays: dict[str, np.ndarray] = {}
    for name, values in columns.items():
        try:
            arrays[name] = np.asarray(values)
        except ValueError as error:
            raise LogError(
                f"column {name!r} is not an array of numbers: {error}"
            ) from error
    if not arrays:
        raise LogError("no columns to write")
    first = next(iter(arrays.values()))
    rows = len(first) if first.ndim else 0
    for name, values in arrays.items():
        if not name.strip() or name.startswith("#"):
            raise LogError(f"column name {name!r} is empty or starts with '#'")
        if (
            values.dtype.kind not in "fiub"
            or values.ndim not in (1, 2)
            or len(values) != rows
        ):
            raise LogError(
                f"column {name!r} has shape {values.shape} and type {values.dtype}; expected "
                f"numbers of shape ({rows},) or ({rows}, k)"
            )
    return arrays


class OpenTable:
    """A table of `open_table`; `begin` opens its file when the first rows are there."""

    def __init__(self, begin: Callable[[Columns], Append], name: str) -> None:
        self._begin = begin
        self._name = name
        self._write: Append | None = None
        self._kinds: list[str] = []

    def append(self, columns: Mapping[str, ArrayLike]) -> None:
        """Write rows of the same columns in every call; raises as `write_table` does.

        `BrokenPipeError` if the reader of standard output has gone.
        """
        arrays = checked_columns(columns)
        kinds = [f"{name} {v.dtype}{list(v.shape[1:])}" for name, v in arrays.items()]
        with file_errors(self._name, "write"):
            if self._write is None:
                self._write = self._begin({n: v[:0] for n, v in arrays.items()})
                self._kinds = kinds
            if kinds != self._kinds:
                raise LogError(
                    f"rows with the columns {kinds} do not fit those before: {self._kinds}"
                )
            self._write(arrays)


@contextmanager
def open_table(
    path: str | Path, *, is_live: bool = False, labels: Callable[[], Labels] = Labels
) -> Iterator[OpenTable]:
    """Open a table for writing; the file is not touched before there are rows.

    Its name has a suffix of `WRITERS`, or is `-` for CSV on standard output. Live rows
    are written to the file itself as they come, and stay there whatever happens;
    otherwise the file is replaced when all rows are written, or not at all. What cannot
    grow (npz) is always written at the end. `labels` are what formats that have room
    for it say beside the numbers, asked for with the first rows. `FileAccessError` if
    the file cannot be written, or its suffix is not known.
    """
    if str(path) == STANDARD_STREAM:
        if sys.stdout is None:
            raise FileAccessError("cannot write standard output: it is closed")
        name = "standard output"
        writer = csv_writer
        file = nullcontext(sys.stdout.buffer)
    else:
        name = str(path)
        writer = _find_writer(Path(path))
        file = whole_file(
            path, is_in_place=is_live and name.lower().endswith((".csv", ".mcap"))
        )
    with ExitStack() as files:

        def begin(empty: Columns) -> Append:
            return files.enter_context(
                writer(files.enter_context(file), labels(), empty)
            )

        yield OpenTable(begin, name)
        with file_errors(name, "write"):
            files.close()


def _find_writer(path: Path) -> Writer:
    for suffix, writer in WRITERS.items():
        if path.name.lower().endswith(suffix):
            return writer
    if path.name.lower().endswith(".db3"):
        raise FileAccessError(
            f"cannot write {path}: bags are written as MCAP; name it .mcap"
        )
    raise FileAccessError(
        f"{path} has no known suffix; known are: {', '.join(WRITERS)}"
    )


def write_table(
    path: str | Path, columns: Mapping[str, ArrayLike], *, labels: Labels | None = None
) -> None:
    """Write named columns; readers see the old file or the whole new one, never a part.

    Floats are written so that they read back bit for bit. In CSV, a two-dimensional
    column `q_rad` becomes `q_rad_1`, `q_rad_2`, ...; `read_log` joins them again.

    Args:
        path: a file ending in `.csv`, `.npz`, `.parquet` or `.mcap`; replaced if it
            exists.
        columns: name, with its unit, to numbers, shape (n,) or (n, k), all of the same
            n.
        labels: what the formats that have room for it say beside the numbers.

    Raises:
        FileAccessError: the file cannot be written, or its suffix is not known.
        LogError: the columns are not numbers, differ in length, or a name is empty,
            starts with `#` or stands twice.
    """
    with open_table(path, labels=lambda: labels or Labels()) as table:
        table.append(columns)


def write_log(path: str | Path, log: Log) -> None:
    """Write a log's time and channels, in SI units; raises as `write_table`."""
    write_table(
        path, {"t_s": log.t_s, **log.channels}, labels=Labels(start_ns=log.start_ns)
    )


def check_writable(path: str | Path) -> None:
    """Find out before the work that the suffix is not known, or that no file can
    stand there.
    """
    if str(path) != STANDARD_STREAM:
        _find_writer(Path(path))
        require_place(Path(path))


def require_place(path: Path) -> None:
    """Check that a file can stand there; `FileAccessError` if not."""
    with file_errors(path, "write"):
        if not path.parent.is_dir():
            raise FileAccessError(
                f"cannot write {path}: there is no folder {path.parent}"
            )
        if path.is_dir():
            raise FileAccessError(f"cannot write {path}: it is a folder")


def check_outputs(outputs: Mapping[str, Path], source: Path | None = None) -> None:
    """Check that no output, an option and the path that it names, would replace another
    one.

    Nor may it harm the recording that is read, a file or a folder, which need not
    exist.
    """
    for (option, path), (other, place) in combinations(outputs.items(), 2):
        with file_errors(path, "write"):
            if _overlap(path, place):
                raise FileAccessError(
                    f"{option} and {other} both write to {path}; give each a place of its own"
                )
    if source is None or not source.exists():
        return
    whole = source.resolve().parent
    is_part = source.is_file() and is_bag(source) and (whole / METADATA).exists()
    for path in outputs.values():
        with file_errors(path, "write"):
            if path.exists() and path.samefile(source):
                why = "it is the log itself; give another name"
            elif _overlap(path, whole if is_part else source):
                why = f"it and the log {source} lie one inside the other; give a place outside"
            else:
                continue
            raise FileAccessError(f"cannot write {path}: {why}")


def _overlap(path: Path, other: Path) -> bool:
    """Return whether two paths are the same place, or one lies inside the other."""
    if path.exists() and other.exists() and path.samefile(other):
        return True
    path = path.resolve()
    other = other.resolve()
    return path == other or path in other.parents or other in path.parents
