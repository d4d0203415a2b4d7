"""What an online step may be fed: the one place where samples are refused."""

import math
import numbers
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from residual.errors import ConfigurationError, SampleError

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


# What the stateful estimators may be set to: the one place where settings are refused.


def check_positive(name: str, value: object) -> None:
    """Refuse a setting that is not a finite positive number.

    Raises:
        ConfigurationError: With the name and what came.
    """
    is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
    try:
        is_sound = is_number and 0.0 < float(value) < math.inf  # type: ignore[arg-type]
    except OverflowError:
        is_sound = False
    if not is_sound:
        raise ConfigurationError(f"{name} is {value!r}, expected a finite number > 0")


def check_switch(name: str, value: object) -> None:
    """Refuse a setting that is neither true nor false.

    Raises:
        ConfigurationError: With the name and what came.
    """
    if not isinstance(value, bool | np.bool_):
        raise ConfigurationError(f"{name} is {value!r}, expected True or False")


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Refuse a setting that is none of the choices.

    Raises:
        ConfigurationError: With the name, what came and the choices.
    """
    if not (isinstance(value, str) and value in choices):
        raise ConfigurationError(f"{name} is {value!r}, expected one of {list(choices)}")


def check_alignment(alignment: object) -> None:
    """Refuse a torque alignment that does not exist.

    Raises:
        ConfigurationError: With the choices.
    """
    check_choice("alignment", alignment, ("hold", "trapezoid"))


def check_gap(max_gap_s: object) -> None:
    """Refuse a longest time step that is not a finite positive number.

    Raises:
        ConfigurationError: With what came.
    """
    check_positive("max_gap_s", max_gap_s)


# Time between the samples that were absorbed, over those that were not.


ROUNDING_S = 1e-5
"""Sums of time steps that come this near to a limit have reached it [s]: stamps since 1970 are
rounded to a quarter of a microsecond, and rounding must not decide on a tick more or less."""


class SampleClock:
    """Adds the time of skipped samples to that of the next sound one.

    A clock that goes back a little comes forward again: samples are skipped until it has caught
    up. One that was set back by more, or forward by more than a day, goes on from there.

    Args:
        most_back_s: How far back still counts as a little [s].
    """

    def __init__(self, most_back_s: float) -> None:
        self._most_back_s = most_back_s
        self.missed_s = 0.0
        """Time since the last sample that was absorbed [s], negative after a step back."""

    def elapsed(self, dt_s: float) -> float:
        """Time since the last sample that was absorbed [s].

        Raises:
            SampleError: For a time step that does not advance, or for a clock that was set.
        """
        dt_s = check_interval(dt_s)
        if not self.missed_s:
            return dt_s
        elapsed_s = dt_s + self.missed_s
        if elapsed_s <= 0.0:
            raise SampleError(
                f"dt_s is {dt_s!r} s after a clock that went back by {-self.missed_s:.3g} s; "
                "skipped until it has caught up"
            )
        return min(elapsed_s, LONGEST_STEP_S)

    def miss(self, dt_s: float) -> None:
        """A sample was skipped: its time still passes, if it has a sound one."""
        is_number = isinstance(dt_s, numbers.Real) and not isinstance(dt_s, bool)
        if is_number and -self._most_back_s < dt_s <= LONGEST_STEP_S:
            self.missed_s += float(dt_s)
