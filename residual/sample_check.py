"""What an online step may be fed: the one place where samples are refused."""

import math
import numbers
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residual.errors import SampleError

MOST_PLAUSIBLE = 1e9
"""No joint signal in SI units comes near it; beyond it products overflow."""

LONGEST_STEP_S = 86_400.0
"""A time step beyond a day is no pause but a clock that was set, from boot time to date perhaps."""


FLOAT64 = np.dtype(np.float64)
"""What an array of floats has as its ``dtype``: comparing it takes no call."""


def check_interval(dt_s: float) -> float:
    """Refuse a time step that does not advance.

    Args:
        dt_s: Time since the previous sample [s], any real number.

    Returns:
        The same as a plain float.

    Raises:
        SampleError: If it is not a finite positive number, or beyond `LONGEST_STEP_S`.
    """
    if type(dt_s) is float and 0.0 < dt_s <= LONGEST_STEP_S:  # the quick way for almost every one
        return dt_s
    if not isinstance(dt_s, numbers.Real) or isinstance(dt_s, bool) or not 0.0 < dt_s < math.inf:
        raise SampleError(
            f"dt_s is {dt_s!r} s, expected a finite positive time step; "
            "skip this sample or repair the clock"
        )
    if dt_s > LONGEST_STEP_S:
        # An integer may be beyond all floats.
        shown = min(dt_s, sys.float_info.max)
        raise SampleError(
            f"dt_s is {shown:.4g} s, more than a day: the clock was set; skip this sample and "
            "go on with the next time step"
        )
    return float(dt_s)


def read_joint_vector(name: str, value: object, joints: int) -> NDArray[np.float64]:
    """Return the value as a float array of one number per joint; they may still be anything.

    Args:
        name: What the value is, for the message.
        value: Anything numpy can read.
        joints: Number of joints.

    Returns:
        The same numbers, shape (joints,); the array itself when it already fits.

    Raises:
        SampleError: If the shape is wrong, or these are no real numbers.
    """
    try:
        array = _real(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise SampleError(f"{name} is not an array of numbers: {error}") from error
    if array.shape != (joints,):
        raise SampleError(
            f"{name} has shape {array.shape}, expected ({joints},): one number per joint"
        )
    return array


def check_joint_vector(name: str, value: object, joints: int) -> NDArray[np.float64]:
    """Return the value as a float array of one number per joint.

    Args:
        name: What the value is, for the message.
        value: Anything numpy can read.
        joints: Number of joints.

    Returns:
        As `read_joint_vector`.

    Raises:
        SampleError: If the shape is wrong, these are no real numbers, or one is not finite or
            beyond `MOST_PLAUSIBLE`.
    """
    array = read_joint_vector(name, value, joints)
    # Almost every sample ends here: one number tells that all are finite and small.
    if math.hypot(*array.tolist()) < MOST_PLAUSIBLE:
        return array
    if not np.isfinite(array).all():
        bad = [int(i) for i in np.flatnonzero(~np.isfinite(array))]
        raise SampleError(f"{name} is not finite at joint index {bad}; skip this sample")
    if np.abs(array).max(initial=0.0) > MOST_PLAUSIBLE:
        raise SampleError(
            f"{name} reaches {np.abs(array).max():.3g}, expected SI units below {MOST_PLAUSIBLE:g}"
        )
    return array


def _real(value: Any) -> NDArray[np.float64]:
    """As floats, but not what numpy makes floats of though nobody measures it: text, truth, dates.

    Raises:
        TypeError: For such values, and for complex or masked ones.
    """
    array = np.asanyarray(value)
    if array.dtype is FLOAT64 and type(array) is np.ndarray:
        return array
    if np.ma.is_masked(array):
        raise TypeError("some of its numbers are masked")
    if array.dtype.kind == "O":
        wrong = {type(one).__name__ for one in array.flat if not _is_real(one)}
    else:
        wrong = set() if array.dtype.kind in "fiu" else {str(array.dtype)}
    if wrong:
        raise TypeError(f"it holds {', '.join(sorted(wrong))}")
    return np.asarray(array, dtype=np.float64)


def _is_real(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)


def read_rows(
    names: tuple[str, ...], values: tuple[object, ...], joints: int
) -> NDArray[np.float64]:
    """Read all signals of a sample into one new array; its numbers may still be anything.

    Args:
        names: What each signal is called.
        values: Its numbers: anything numpy can read.
        joints: Number of joints.

    Returns:
        A row for each signal, shape (k, joints): a read-only copy.

    Raises:
        SampleError: If they cannot be read so: as `check_joint_vector`.
    """
    shape = (joints,)
    for value in values:
        # Arrays that were pickled bring a dtype of their own, equal and not the same.
        if not (
            type(value) is np.ndarray
            and (value.dtype is FLOAT64 or value.dtype == FLOAT64)
            and value.shape == shape
        ):
            vectors = zip(names, values, strict=True)
            rows = np.stack([check_joint_vector(name, value, joints) for name, value in vectors])
            break
    else:  # almost every sample
        rows = np.array(values)
    rows.setflags(False)  # pyright: ignore[reportCallIssue]  # by name it takes thrice as long
    return rows


def check_rows(names: tuple[str, ...], rows: NDArray[np.float64]) -> None:
    """Refuse numbers that no sample has.

    Args:
        names: What each signal is called.
        rows: What `read_rows` has read.

    Raises:
        SampleError: As `check_joint_vector`.
    """
    # One number tells of all; `hypot` does not overflow, and a NaN fails.
    if not math.hypot(*rows.ravel().tolist()) < MOST_PLAUSIBLE:
        for name, row in zip(names, rows, strict=True):
            check_joint_vector(name, row, len(row))
