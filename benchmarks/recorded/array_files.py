"""Reads the files of real recordings, and says plainly what is wrong with one."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from benchmarks.errors import DataError

Array = NDArray[np.float64]


def read_arrays(path: Path, names: Sequence[str]) -> list[Array]:
    """The named arrays of an npz file.

    Raises:
        DataError: The file cannot be read, an array is missing, empty or not finite.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            missing = [name for name in names if name not in content]
            if missing:
                raise DataError(f"{path} lacks {', '.join(missing)}; it has {', '.join(content)}")
            arrays = [np.asarray(content[name], dtype=np.float64) for name in names]
    except (OSError, EOFError, BadZipFile) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    except ValueError as error:
        if isinstance(error, DataError):
            raise
        raise DataError(f"cannot read {path}: {error}") from error
    for name, array in zip(names, arrays, strict=True):
        if array.size == 0 or not np.isfinite(array).all():
            raise DataError(f"{name} of {path} is empty or has values that are not finite")
    return arrays


def read_table(path: Path) -> dict[str, Any]:
    """The table of numbers in a JSON file.

    Raises:
        DataError: The file cannot be read or is no JSON object.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    if not isinstance(table, dict):
        raise DataError(f"{path} holds no table of named numbers")
    return table
