"""Validated, read-only arrays: what comes in is checked once, what goes out cannot be written."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from urdf.errors import InputError


def read_only(array: ArrayLike) -> NDArray[np.float64]:
    """Return a read-only float copy of ``array``."""
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy


def finite_array(value: ArrayLike, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    """Return a read-only copy of ``value`` after checking its shape and that it is finite.

    Args:
        value: Anything numpy can turn into floats.
        shape: Expected shape; -1 stands for any length of at least one.
        name: Name of the argument, for the message.

    Raises:
        InputError: Not numeric, of another shape, or with NaN or infinite entries.
    """
    wanted = str(shape).replace("-1", "n")
    try:
        array = read_only(value)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is not an array of numbers of shape {wanted}: {error}") from error
    if array.ndim != len(shape) or any(
        have == 0 or want not in (-1, have) for have, want in zip(array.shape, shape, strict=True)
    ):
        raise InputError(f"{name} has shape {array.shape}, expected {wanted}")
    if not np.isfinite(array).all():
        raise InputError(f"{name} has NaN or infinite entries; drop or repair those samples first")
    return array
