"""Files of named columns: npz, Parquet, Feather, HDF5, MATLAB, TDMS; data frames."""

import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from needleforce.recordings.errors import (
    UnpackedSize,
    damage_errors,
    optional_library,
)
from needleforce.recordings.table import MAX_LIST_NUMBERS, START_KEY, Table
from needleforce.recordings.time_stamps import (
    start_of_clock,
    to_nanoseconds,
    to_seconds,
)

ARROW_SUFFIXES = (".parquet", ".feather")
"""Of files that pyarrow reads."""


def read_npz(path: Path, unpacked: UnpackedSize) -> Table:
    """Read an npz archive: arrays of numbers become columns; single numbers do not.

    Args:
        path: Of the archive.
        unpacked: Counts what is in it.

    Raises:
        FormatError: It is no such archive, damaged or too large.
    """
    arrays: dict[str, np.ndarray] = {}
    with (
        damage_errors(path, "npz archive"),
        np.load(path, allow_pickle=False) as archive,
    ):
        names = archive.files
        size = sum(member.file_size for member in archive.zip.infolist())
        unpacked.add(size, path)
        for name in names:
            with suppress(ValueError):  # objects
                arrays[name] = archive[name]

    single = {name: array for name, array in arrays.items() if not array.ndim}
    columns = {
        name: array
        for name, array in arrays.items()
        if array.dtype.kind in "fiub" and array.ndim in (1, 2) and array.size
    }
    return Table(
        columns=columns,
        warnings=tuple(
            f"array {name!r} was left out: no columns"
            for name in names
            if name not in (*single, *columns)
        ),
        start_ns=int(single.get(START_KEY, 0)),
    )


def read_arrow(path: Path, unpacked: UnpackedSize) -> Table:
    """Read the columns of numbers, lists and time stamps of a Parquet or Feather file.

    Args:
        path: Of the file.
        unpacked: Counts what is in it.

    Raises:
        FormatError: It is no such file, damaged or too large.
    """
    kind = path.suffix.lower().removeprefix(".")
    reader = optional_library(f"pyarrow.{kind}", "Parquet and Feather files")
    size = 0
    with damage_errors(path, f"{kind} file"):
        if kind == "parquet":  # whose size is known before it is unpacked
            about = reader.ParquetFile(path).metadata
            groups = map(about.row_group, range(about.num_row_groups))
            size = sum(group.total_byte_size for group in groups)
            unpacked.add(size, path)
        content = reader.read_table(path, use_threads=False)
        unpacked.add(content.nbytes - size, path)
        table = table_of_frame(content.to_pandas(ignore_metadata=True))

    own_start = (content.schema.metadata or {}).get(START_KEY.encode())
    return table if own_start is None else replace(table, start_ns=int(own_start))


def table_of_frame(frame: pd.DataFrame) -> Table:
    """Return the columns of numbers, lists and times; warnings name the others."""
    columns: dict[str, np.ndarray] = {}
    notes: list[str] = []
    texts: dict[str, str] = {}
    seconds: set[str] = set()
    start_ns = 0
    for name in map(str, frame):
        cells = frame[name]
        filled = cells.notna().to_numpy()
        known = cells[filled]
        if not len(known):
            notes.append(f"column {name!r} is empty and was left out")
        elif (numbers := _numbers_of(cells)) is not None:
            columns[name] = numbers
            odd = (
                np.count_nonzero(filled & np.isnan(numbers)) if numbers.ndim < 2 else 0
            )
            notes += [f"column {name!r}: cells that are not numbers: {odd}"] * bool(odd)
        elif (stamps_ns := _clock_ns(known)) is not None:
            start_ns = start_ns or start_of_clock(stamps_ns)
            columns[name] = np.full(len(cells), np.nan)
            columns[name][filled] = to_seconds(stamps_ns, start_ns)
            seconds.add(name)
        else:
            texts[name] = str(known.iloc[0]).strip()

    groups = find_joint_groups(columns, texts)
    for name, text in texts.items():
        advice = ": write its numbers as columns" if text.startswith("[") else ""
        if not groups or "name" not in name:
            notes.append(
                f"column {name!r} holds text ({text[:40]!r}) and was left out{advice}"
            )
    for group, members in groups.items():
        columns[group] = np.stack([columns.pop(e) for e in members.values()], axis=1)

    return Table(
        columns=columns,
        joint_names={group: tuple(members) for group, members in groups.items()},
        start_ns=start_ns,
        seconds=frozenset(seconds),
        warnings=tuple(notes),
    )


def _numbers_of(cells: pd.Series) -> np.ndarray | None:
    """Return cells as numbers, NaN for those that are none; None if most are none.

    Returns:
        Shape (n,); of lists of one length, which are signals of joints, (n, k).
    """
    if cells.dtype.kind in "iub":
        return cells.to_numpy()
    if cells.dtype.kind == "M":
        return None

    lengths = {len(cell) for cell in cells if isinstance(cell, list | np.ndarray)}
    if lengths:
        width = max(lengths)
        rows = [[np.nan] * width if cell is None else cell for cell in cells]
        is_signal = len(lengths) == 1 and width <= MAX_LIST_NUMBERS
        return np.array(rows, dtype=np.float64) if is_signal else None

    numbers = pd.to_numeric(cells.replace({True: 1, False: 0}), errors="coerce")
    are_most = 2 * numbers.count() >= cells.count()
    return numbers.to_numpy(np.float64) if are_most else None


def _clock_ns(cells: pd.Series) -> np.ndarray | None:
    """Return dates with times, or times of one day, in ns; None for anything else."""
    try:
        if re.match(r"\s*\d+:\d+:\d", str(cells.iloc[0])):
            return pd.to_timedelta(cells).to_numpy("m8[ns]").astype(np.int64)

        dates = pd.to_datetime(cells, utc=True, format="ISO8601")
        return dates.dt.tz_localize(None).to_numpy("M8[ns]").astype(np.int64)
    except (ValueError, OverflowError):
        return None


def find_joint_groups(
    names: Iterable[str], texts: Mapping[str, str]
) -> dict[str, dict[str, str]]:
    """Find the joints that text exported from ROS topics names.

    `field.name0` holds the name of `field.position0`, or `name` the list of the names
    of `position_0`, `position_1`, ...; these columns become one of two dimensions.

    Args:
        names: Of all columns of numbers.
        texts: Of each column of text, what its first row holds.

    Returns:
        By name of the column that they become: the columns by joint.
    """
    joints: dict[str, dict[str, str]] = {}  # by number, by what is before `name`
    for name, text in texts.items():
        if match := re.fullmatch(r"((?:.*[./])?)name[_.]?\[?(\d{0,3})\]?", name):
            listed = re.findall(r"['\"]([^'\"]+)['\"]", text)
            numbered = {str(number): each for number, each in enumerate(listed)}
            joints.setdefault(match[1], {}).update(
                {match[2]: text} if match[2] else numbered
            )

    groups: dict[str, dict[str, str]] = {}
    for (head, joint_of), field in product(
        joints.items(), ("position", "velocity", "effort")
    ):
        expression = re.compile(rf"{re.escape(head + field)}[_.]?\[?(\d{{1,3}})\]?")
        matches = filter(None, map(expression.fullmatch, names))
        column_of = {match[1]: match[0] for match in matches}
        if joint_of and column_of.keys() == joint_of.keys():
            members = {joint: column_of[number] for number, joint in joint_of.items()}
            groups[head.replace(".", "/") + field] = members

    return groups


CONTAINER_SUFFIXES = (".h5", ".hdf5", ".mat", ".tdms")
"""Of files whose arrays have names in groups."""


def read_container(path: Path, unpacked: UnpackedSize) -> Table:
    """Read the numbers of shape (n,) or (n, k), n > 1, that a file holds.

    Args:
        path: Of the file.
        unpacked: Counts what is in it.

    Raises:
        FileAccessError: The library that reads it is not installed.
        FormatError: It is damaged, too large or of another kind.
    """
    suffix = path.suffix.lower()
    with path.open("rb") as stream:
        is_hdf5 = stream.read(8) == b"\x89HDF\r\n\x1a\n"

    with damage_errors(path, f"{suffix} file"):
        if suffix == ".tdms":
            return _read_tdms(path)
        if is_hdf5 or suffix != ".mat":
            arrays = _read_hdf5(path, unpacked, is_matlab=suffix == ".mat")
        else:
            from scipy.io import loadmat  # when it is needed: it takes a while

            content = loadmat(path, simplify_cells=True)
            # Of structures in structures, by the names that lead there.
            arrays = pd.json_normalize(content, sep="/").iloc[0]

    return Table(columns={str(n): v for n, v in arrays.items() if _is_signal(v)})


def _is_signal(values: Any) -> bool:
    """Return whether values are an array of numbers, more than one in each column."""
    is_array = isinstance(values, np.ndarray) and values.dtype.kind in "fiub"
    return is_array and values.ndim in (1, 2) and len(values) > 1


def _read_hdf5(
    path: Path, unpacked: UnpackedSize, *, is_matlab: bool
) -> dict[str, np.ndarray]:
    """Return the datasets of an HDF5 file; MATLAB writes columns as its rows."""
    library = optional_library("h5py", "HDF5 files")
    arrays: dict[str, np.ndarray] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, library.Dataset) and item.ndim in (1, 2):
            unpacked.add(item.nbytes, path)
            values = item[()].T if is_matlab else item[()]
            arrays[name] = values.ravel() if 1 in values.shape else values

    with library.File(path) as file:
        file.visititems(visit)

    return arrays


def _read_tdms(path: Path) -> Table:
    """Return the channels of a TDMS file, with their units and the clock of each."""
    library = optional_library("nptdms", "TDMS files")
    found = {
        f"{group.name}/{channel.name}": channel
        for group in library.TdmsFile.read(path).groups()
        for channel in group.channels()
    }
    channels = {name: each for name, each in found.items() if _is_signal(each[:])}
    properties = {name: channel.properties for name, channel in channels.items()}
    # Either every channel has a clock, or one of them is the time.
    has_clocks = all("wf_increment" in each for each in properties.values())
    clocked = channels if has_clocks else {}
    return Table(
        columns={name: channel[:] for name, channel in channels.items()},
        units={
            n: p["unit_string"] for n, p in properties.items() if "unit_string" in p
        },
        clocks={name: name for name in clocked},
        stamps_ns={name: _stamps_of(channel) for name, channel in clocked.items()},
    )


def _stamps_of(channel: Any) -> np.ndarray:
    """Return the time stamps [ns] of a channel of a TDMS file, shape (n,)."""
    waveform = channel.properties
    start = np.datetime64(waveform.get("wf_start_time", 0), "ns")
    first_s = waveform.get("wf_start_offset", 0.0)
    t_s = first_s + waveform["wf_increment"] * np.arange(len(channel))
    return to_nanoseconds(t_s, int(start.astype(np.int64)))
