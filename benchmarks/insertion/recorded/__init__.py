"""Benchmarks on recordings of real arms and of real tissue.

Reading order: `panda` and `ur10e` (real arms), `liver` and `bovine` (real tissue).
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import msgspec
import numpy as np
import pinocchio as pin

from benchmarks import DataError
from foundation.arrays import Array


def add_link(
    model: pin.Model, name: str, placement: pin.SE3, axis: Array, link: pin.Inertia
) -> None:
    """Add a revolute joint without limits, and its link, behind the last of a model.

    Args:
        model: The model.
        name: Name of joint and link.
        placement: Frame of the joint at zero in that of the joint before.
        axis: Axis of rotation in the joint's frame, shape (3,), of length 1.
        link: Inertia of the link in the joint's frame.
    """
    unlimited = np.array([np.inf])
    number = model.addJoint(
        model.njoints - 1,
        pin.JointModelRevoluteUnaligned(axis),
        placement,
        name,
        unlimited,
        unlimited,
        -unlimited,
        unlimited,
    )
    model.addJointFrame(number, -1)
    model.inertias[number] = link


def read_arrays(path: Path, names: Sequence[str]) -> list[Array]:
    """Read the named arrays of an npz file.

    Raises:
        DataError: The file cannot be read, an array is missing, empty or not finite.
    """
    try:
        with np.load(path, allow_pickle=False) as content:
            has = ", ".join(content)
            arrays = {
                n: np.asarray(content[n], dtype=np.float64)
                for n in names
                if n in content
            }
    except (OSError, EOFError, BadZipFile, ValueError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    if missing := [name for name in names if name not in arrays]:
        raise DataError(f"{path} lacks {', '.join(missing)}; it has {has}")
    for name, array in arrays.items():
        if array.size == 0 or not np.isfinite(array).all():
            raise DataError(
                f"{name} of {path} is empty or has values that are not finite"
            )
    return [arrays[name] for name in names]


def read_table(path: Path) -> dict[str, Any]:
    """Read the table of numbers in a JSON file.

    Raises:
        DataError: The file cannot be read or is no JSON object.
    """
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
    except msgspec.ValidationError as error:
        raise DataError(f"{path} holds no table of named numbers") from error
    except (OSError, msgspec.DecodeError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
