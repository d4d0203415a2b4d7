"""Reading a recording, whatever its format."""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from recordings.bag_storage.files import BAG_SUFFIXES, is_bag
from recordings.bags.format import read_bag
from recordings.columnar.npz_format import read_npz
from recordings.columnar.parquet_format import read_parquet
from recordings.columns.mapping import ColumnMapping
from recordings.columns.wanted import Wanted
from recordings.errors import FileAccessError
from recordings.log import Log
from recordings.select_channels import select_channels
from recordings.tables.table import Table
from recordings.text.format import CSV_SUFFIXES, read_csv

# A new format is a reader in a file of its own and a line here.
_READERS: Mapping[str, Callable[[Path], Table]] = {
    **dict.fromkeys(CSV_SUFFIXES, read_csv),
    ".npz": read_npz,
    ".parquet": read_parquet,
}


def read_table(path: str | Path, wanted: Wanted | None = None) -> Table:
    """Read a file's columns as they stand, without saying what they mean.

    Args:
        path: a file ending in `.csv`, `.tsv` or `.txt` (the first two also with `.gz`), `.npz` or
            `.parquet`; or a ROS 2 bag: a file ending in `.mcap` or `.db3`, or a folder of them.
        wanted: what is read of a bag; of other files everything is.

    Returns:
        The columns in the file's units.

    Raises:
        FileAccessError: the file cannot be read, or its suffix is not known.
        FormatError: nothing usable is in it.
        ColumnError: a bag has not what is wanted.
    """
    path = Path(path)
    if is_bag(path):
        return read_bag(path, wanted)
    for suffix, reader in _READERS.items():
        if path.name.lower().endswith(suffix):
            return reader(path)
    known = (*_READERS, *BAG_SUFFIXES)
    raise FileAccessError(f"{path} has no known suffix; known are: {', '.join(known)}")


def read_log(
    path: str | Path,
    mapping: ColumnMapping | None = None,
    *,
    required: Iterable[str] = (),
    optional: Iterable[str] = (),
    joints: Iterable[str] = (),
) -> Log:
    """Read a recording into SI units.

    Args:
        path: see `read_table`.
        mapping: which columns are which channels; channels it does not list, or all without a
            mapping, are found by their usual names.
        required: channels that must be there: `q`, `dq`, `tau`, `tau_ext`, `depth`, `speed`,
            `force`.
        optional: channels taken if they are there. With neither given, all are optional.
        joints: names of the robot's joints; a recording that names joints is put into this order.

    Returns:
        The log. Its `warnings` tell what is wrong with the recording.

    Raises:
        FileAccessError: the file cannot be read, or its suffix is not known.
        FormatError: nothing usable is in it.
        ColumnError: time, a required or a mapped channel was not found, or is ambiguous.
        MappingError: a channel name is unknown, or a scale does not fit its columns.
        LogError: the channels do not form a log.
    """
    mapping, required, optional = mapping or ColumnMapping(), tuple(required), tuple(optional)
    wanted = Wanted(mapping=mapping, required=required, optional=optional, joints=tuple(joints))
    return select_channels(read_table(path, wanted), mapping, required, optional)
