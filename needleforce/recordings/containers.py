"""Files of named arrays in groups: HDF5, MATLAB and TDMS, as columns `group/name`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from needleforce.recordings.errors import (
    RECOVER,
    FormatError,
    RecordingError,
    optional_library,
    require_size,
)
from needleforce.recordings.table import Table
from needleforce.recordings.time_stamps import to_nanoseconds

CONTAINER_SUFFIXES = (".h5", ".hdf5", ".mat", ".tdms")
"""Of files whose arrays have names in groups."""


def read_container(path: Path, max_bytes: int) -> Table:
    """Read the numbers of shape (n,) or (n, k), n > 1, that a file holds.

    Raises:
        FileAccessError: The library that reads it is not installed.
        FormatError: It is damaged, or of another kind.
    """
    with path.open("rb") as stream:
        is_hdf5 = stream.read(8) == b"\x89HDF\r\n\x1a\n"

    is_matlab = path.suffix.lower() == ".mat"
    try:
        if path.suffix.lower() == ".tdms":
            return _read_tdms(path, max_bytes)
        if is_hdf5 or not is_matlab:
            arrays = _read_hdf5(path, max_bytes, is_matlab=is_matlab)
        else:
            library = optional_library("scipy.io", "MATLAB files")
            arrays = _flat(library.loadmat(path, simplify_cells=True))
    except (RecordingError, OSError) as error:
        if isinstance(error, RecordingError) or error.errno:
            raise

        raise FormatError(f"{path} cannot be read ({error})", RECOVER) from error
    except Exception as error:  # whatever damaged bytes make the library run into
        raise FormatError(f"{path} cannot be read ({error})", RECOVER) from error

    columns = {
        name: values
        for name, values in arrays.items()
        if values.dtype.kind in "fiub" and values.ndim in (1, 2) and len(values) > 1
    }
    require_size(sum(v.nbytes for v in columns.values()), max_bytes, f"{path}")
    return Table(columns=columns)


def _read_hdf5(path: Path, max_bytes: int, *, is_matlab: bool) -> dict[str, np.ndarray]:
    """Return the datasets of an HDF5 file; MATLAB writes columns as its rows."""
    library = optional_library("h5py", "HDF5 files")
    arrays: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, library.Dataset) and item.ndim in (1, 2):
            require_size(item.nbytes, max_bytes, f"{path}: {name}")
            values = item[()]
            values = values.T if is_matlab else values
            arrays[name] = values[:, 0] if values.shape[1:] == (1,) else values

    with library.File(path) as file:
        file.visititems(visit)

    return arrays


def _flat(content: Mapping[str, Any], start: str = "") -> dict[str, np.ndarray]:
    """Return the arrays of structures in structures, by the names that lead there."""
    arrays: dict[str, np.ndarray] = {}
    for name, value in content.items():
        if isinstance(value, Mapping):
            arrays |= _flat(value, f"{start}{name}/")
        elif isinstance(value, np.ndarray):
            arrays[f"{start}{name}"] = value

    return arrays


def _read_tdms(path: Path, max_bytes: int) -> Table:
    """Return the channels of a TDMS file, with their units and the clock of each."""
    library = optional_library("nptdms", "TDMS files")
    require_size(path.stat().st_size, max_bytes, f"{path}")
    columns: dict[str, np.ndarray] = {}
    units: dict[str, str] = {}
    stamps_ns: dict[str, np.ndarray] = {}
    for group in library.TdmsFile.read(path).groups():
        for channel in group.channels():
            name = f"{group.name}/{channel.name}"
            values = channel[:]
            if values.dtype.kind not in "fiub" or len(values) < 2:
                continue

            columns[name] = values
            if unit := channel.properties.get("unit_string"):
                units[name] = unit
            if "wf_increment" in channel.properties:
                stamps_ns[name] = to_nanoseconds(channel.time_track(), 0)

    # Either every channel has a clock, or one of them is the time.
    if stamps_ns.keys() != columns.keys():
        return Table(columns=columns, units=units)

    clocks = {name: name for name in columns}
    return Table(columns=columns, units=units, clocks=clocks, stamps_ns=stamps_ns)
