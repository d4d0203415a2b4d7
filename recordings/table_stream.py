"""A recording as tables of consecutive rows, whatever its format, so that memory stays bounded."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from recordings.bag_storage.files import is_bag
from recordings.bags.format import bag_chunks
from recordings.bags.growing import growing_chunks
from recordings.columnar.npz_format import npz_chunks
from recordings.columnar.parquet_format import parquet_chunks
from recordings.columns.wanted import Wanted
from recordings.errors import FileAccessError, RecordingError
from recordings.open_table import STANDARD_STREAM
from recordings.read_log import read_table
from recordings.sources.byte_source import Patience, byte_blocks
from recordings.sources.piped_binary import peek, spooled
from recordings.tables.table import Table
from recordings.text.format import CSV_SUFFIXES, csv_tables

CHUNK_ROWS = 2048
"""The most rows of a table of a binary format."""

# A format that can be read in part has a line here; of any other the whole file is read.
_CHUNKED: Mapping[str, Callable[[Path, int], Iterator[Table]]] = {
    ".npz": npz_chunks,
    ".parquet": parquet_chunks,
}


def stream_tables(
    source: str | Path, patience: Patience, wanted: Wanted | None = None
) -> Iterator[Table]:
    """Read a recording as it comes.

    Args:
        source: a file, see `read_table`, or `-` for standard input: CSV, plain or compressed, or
            a binary format, which is kept in a temporary file until all of it has come.
        patience: how long more is waited for where the source is text, MCAP or a pipe; any source
            is left when it says to stop.
        wanted: what is read of a bag; of other sources everything is.

    Yields:
        Tables of consecutive rows with equal columns, the first with `HEAD_ROWS` rows at least,
        if there are so many; the last may have none, but warnings.

    Raises:
        FileAccessError: the source cannot be read, is neither text nor MCAP but to be followed, or
            its suffix is not known.
        FormatError: nothing usable is in it.
        ColumnError: a bag has not what is wanted.
    """
    path = None if str(source) == STANDARD_STREAM else Path(source)
    name = "standard input" if path is None else str(path)
    if path is None or is_text(path):
        suffix, blocks = peek(byte_blocks(path, patience))
        if suffix and (path is None or path.is_fifo()):
            yield from _piped(blocks, suffix, name, patience, wanted)
            return
        yield from csv_tables(
            blocks, name, is_growing=patience.follow, is_stopped=patience.should_stop
        )
        return
    if patience.follow:
        yield from _growing(path, wanted, patience)
        return
    for table in _chunks(path, wanted):
        yield table
        if patience.should_stop():
            return


def _growing(path: Path, wanted: Wanted | None, patience: Patience) -> Iterator[Table]:
    if path.is_dir():
        raise FileAccessError(
            f"{path} is a folder, which cannot be followed while it grows; name the .mcap file in "
            "it, or read it when it is complete"
        )
    if not path.name.lower().endswith(".mcap"):
        raise FileAccessError(
            f"{path} cannot be followed while it grows; only CSV and MCAP can. Record one of them "
            "(ros2 bag record -s mcap), or read it when it is complete"
        )
    return growing_chunks(path, CHUNK_ROWS, wanted or Wanted(), patience)


def _piped(
    blocks: Iterator[bytes], suffix: str, name: str, patience: Patience, wanted: Wanted | None
) -> Iterator[Table]:
    patience.warn(
        f"{name} is {suffix[1:]}, not text: it is read to its end, into a temporary file, before "
        "anything is estimated"
    )
    with spooled(blocks, suffix) as path:
        try:
            # What stopped the pipe has not stopped the reading of what came.
            yield from _chunks(path, wanted)
        except RecordingError as error:
            raise type(error)(str(error).replace(str(path), name)) from error


def _chunks(path: Path, wanted: Wanted | None) -> Iterator[Table]:
    if is_bag(path):
        return bag_chunks(path, CHUNK_ROWS, wanted)
    for suffix, reader in _CHUNKED.items():
        if path.name.lower().endswith(suffix):
            return reader(path, CHUNK_ROWS)
    return iter((read_table(path),))


def is_text(path: Path) -> bool:
    """Return whether a path is read as CSV: by its suffix, or because it is a pipe."""
    return path.name.lower().endswith(CSV_SUFFIXES) or path.is_fifo()
