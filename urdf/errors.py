"""Errors of the robot package, and the checks of array arguments that raise them."""

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array


class UrdfError(Exception):
    """Base of every error raised by `urdf`."""


class UrdfFileError(UrdfError, ValueError):
    """A robot description is missing, unreadable, malformed or too large."""


class UnknownNameError(UrdfError, LookupError):
    """A frame, link, joint or robot of that name does not exist.

    The message lists those that do.
    """


class InertiaError(UrdfError, ValueError):
    """Inertial parameters that no rigid body can have."""


class UnsupportedJointError(UrdfError, ValueError):
    """A joint whose position and velocity do not have one number each."""


class InputError(UrdfError, ValueError):
    """An argument of the wrong shape, not finite, or out of its range."""


class MissingPackageError(UrdfError, ImportError):
    """An optional data package is not installed; the message says how to install it."""


def read_only(array: ArrayLike) -> Array:
    """Return a read-only float copy of ``array``."""
    copy = np.array(array, dtype=np.float64)
    copy.setflags(write=False)
    return copy


def finite_array(value: ArrayLike, shape: tuple[int, ...], name: str) -> Array:
    """Return a read-only copy of an array of finite numbers.

    Args:
        value: Array or nested list of numbers.
        shape: Expected shape; -1 stands for any length above zero.
        name: Name in the message.

    Raises:
        InputError: Another shape, or an entry that is not a finite number.
    """
    expected = str(shape).replace("-1", "n")
    try:
        if np.iscomplexobj(value):
            raise TypeError("complex numbers")
        array = read_only(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(
            f"{name} is not an array of numbers of shape {expected}: {error}"
        ) from error
    if array.ndim != len(shape) or any(
        length == 0 or expected_length not in (-1, length)
        for length, expected_length in zip(array.shape, shape, strict=True)
    ):
        raise InputError(f"{name} has shape {array.shape}, expected {expected}")
    if not np.isfinite(array).all():
        raise InputError(
            f"{name} has NaN or infinite entries; drop or repair those samples first"
        )
    return array
