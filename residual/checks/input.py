"""What an online step and its settings may be: the one place where samples are refused.

A bad sample raises a `SampleError`, a bad setting a `ConfigurationError`, with its name
and value.
"""

import math
import numbers
import sys
from typing import Any

import numpy as np

from residual.errors import Array, ConfigurationError, SampleError, named_joints

MOST_PLAUSIBLE = (
    1e5  # no joint signal in SI units comes near it; far beyond it products overflow
)
SHORTEST_STEP_S = (
    1e-12  # no clock ticks faster, and the inverse of what is far shorter overflows
)
LONGEST_STEP_S = 86_400.0
"""A time step beyond a day is no pause but a clock that was set, from boot time to
date perhaps."""
ROUNDING_S = 1e-5
"""Sums of time steps that come this near to a limit have reached it [s]: stamps since
1970 are rounded to a quarter of a microsecond, and rounding must not decide on a tick
more or less."""
MILLISECONDS_S = (
    0.5  # time steps from here on are in milliseconds, or of a very slow log
)
_ndarray = np.ndarray
FLOAT64 = np.dtype(
    np.float64
)  # The ``dtype`` of arrays of floats: comparing it takes no call


def check_interval(dt_s: Any) -> float:
    """A time step [s], any real number, as a plain float.

    `SampleError` if it is not a finite positive number, or beyond `LONGEST_STEP_S`.
    """
    step_s = dt_s if type(dt_s) is float else as_float(dt_s)
    if not 0.0 < step_s < math.inf:
        raise SampleError(
            f"dt_s is {shown(dt_s)} s, expected a finite positive time step; "
            "skip this sample or repair the clock"
        )
    if step_s < SHORTEST_STEP_S:
        raise SampleError(
            f"dt_s is {step_s:.4g} s, shorter than any clock ticks; repair the clock"
        )
    if step_s > LONGEST_STEP_S:
        raise SampleError(
            f"dt_s is {step_s:.4g} s, more than a day: the clock was set; skip this sample and "
            "go on with the next time step"
        )
    return step_s


def long_step(dt_s: float, max_gap_s: float) -> str:
    """What to say of a time step [s] that is too long to be integrated; empty if it
    is not.
    """
    if dt_s <= max_gap_s + ROUNDING_S:
        return ""
    unit = "; is it in milliseconds?" if dt_s >= MILLISECONDS_S else ""
    return (
        f"dt_s = {dt_s:g} s is longer than max_gap_s = {max_gap_s:g} s, so the filters start "
        f"anew{unit}"
    )


def as_float(value: Any) -> float:
    """A real number of any type as a float, the largest one for what is beyond; else
    NaN.
    """
    # A time span of numpy counts as an integer there, of a unit that nobody knows here.
    if not _is_real(value):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return sys.float_info.max if value > 0 else -sys.float_info.max
    except Exception:  # whatever a stranger's type makes of it
        return math.nan


def shown(value: object) -> str:
    """A value as a message can show it, whatever its type makes of that."""
    try:
        text = repr(value)
    except (
        Exception
    ):  # an integer of more digits than Python prints, or a stranger's type
        text = f"a {type(value).__name__} that cannot be shown"
    return text if len(text) <= 200 else f"{text[:200]}..."


def _is_real(value: object) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(
        value, bool | np.timedelta64
    )


def check_joint_vector(name: str, value: object, joints: int) -> Array:
    """Anything numpy can read as a float array of shape (joints,); the array itself if
    it fits.

    `SampleError` for another shape, or unless real, finite and below `MOST_PLAUSIBLE`
    as a vector.
    """
    try:
        array = _real(value)
    except Exception as error:  # a stranger's type may raise anything
        raise SampleError(f"{name} is not an array of numbers: {error}") from error
    if array.shape != (joints,):
        raise SampleError(
            f"{name} has shape {array.shape}, expected ({joints},): one number per joint"
        )
    # Almost every sample ends here: one number shows that all are finite and small.
    if math.hypot(*array.tolist()) < MOST_PLAUSIBLE:
        return array
    if not np.isfinite(array).all():
        bad = named_joints(np.flatnonzero(~np.isfinite(array)))
        raise SampleError(f"{name} is not finite at {bad}; skip this sample")
    most = np.abs(array).max()
    raise SampleError(
        f"{name} reaches {most:.3g}, expected SI units far below {MOST_PLAUSIBLE:g}"
    )


def _real(value: Any) -> Array:
    """As floats; a TypeError for text, truth values, dates, and complex or masked
    numbers.
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


def all_fit(values: tuple[object, ...], joints: int) -> bool:
    """Whether all are arrays of one float per joint, and nothing but arrays."""
    shape = (joints,)
    for value in values:
        if type(value) is not _ndarray or value.shape != shape:
            return False
        # Arrays that were pickled bring a dtype of their own, equal and not the same.
        if value.dtype is not FLOAT64 and value.dtype != FLOAT64:
            return False
    return True


def read_rows(names: tuple[str, ...], values: tuple[object, ...], joints: int) -> Array:
    """Read k named signals into a read-only copy of shape (k, joints), of any numbers.

    `SampleError` if they cannot be read so: as `check_joint_vector`.
    """
    if all_fit(values, joints):  # almost every sample
        rows = np.array(values)
    else:
        vectors = zip(names, values, strict=True)
        rows = np.stack(
            [check_joint_vector(name, value, joints) for name, value in vectors]
        )
    rows.setflags(False)  # pyright: ignore[reportCallIssue]  # by name it takes thrice as long
    return rows


def check_rows(names: tuple[str, ...], rows: Array) -> None:
    """Refuse, as `check_joint_vector` does, numbers in what `read_rows` has read."""
    # One number stands for all; `hypot` does not overflow, and a NaN fails.
    if not math.hypot(*rows.ravel().tolist()) < MOST_PLAUSIBLE:
        for name, row in zip(names, rows, strict=True):
            check_joint_vector(name, row, len(row))


def check_positive(
    name: str, value: object, *, least: float = 1e-30, most: float = 1e30
) -> None:
    """Refuse a setting that is not a positive number, or one whose square over- or
    underflows.
    """
    number = as_float(value)
    if not 0.0 < number < math.inf:
        raise ConfigurationError(
            f"{name} is {shown(value)}, expected a finite number > 0"
        )
    if not least <= number <= most:
        raise ConfigurationError(
            f"{name} is {number:g}, expected a number between {least:g} and {most:g}"
        )


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Refuse a setting that is none of the choices."""
    if not (isinstance(value, str) and value in choices):
        raise ConfigurationError(
            f"{name} is {shown(value)}, expected one of {list(choices)}"
        )


def vector_of_three(name: str, value: object) -> Array:
    """A setting of three finite numbers, shape (3,)."""
    try:
        given = _real(value)
    except Exception:  # a stranger's type may raise anything
        given = np.zeros(0)
    if given.shape != (3,) or not np.isfinite(given).all():
        raise ConfigurationError(
            f"{name} is {shown(value)}, expected three finite numbers"
        )
    return given


class SampleClock:
    """Adds the time of rejected samples to that of the next valid one.

    A clock that goes back a little comes forward again: samples are rejected until it
    has caught up. One that was set back by more than ``most_back_s``, or forward by
    more than a day, goes on from there.
    """

    def __init__(self, most_back_s: float) -> None:
        self._most_back_s = most_back_s
        self.missed_s = 0.0
        """Time since the last sample that was used [s], negative after a step back."""

    def elapsed(self, dt_s: float) -> float:
        """Time since the last sample that was used [s].

        `SampleError` for a time step that does not advance, or for a clock that was
        set.
        """
        if type(dt_s) is not float or not SHORTEST_STEP_S <= dt_s <= LONGEST_STEP_S:
            dt_s = check_interval(dt_s)
        if not self.missed_s:
            return dt_s
        elapsed_s = dt_s + self.missed_s
        if elapsed_s <= 0.0:
            raise SampleError(
                f"dt_s is {dt_s!r} s after a clock that went back by {-self.missed_s:.3g} s; "
                "rejected until it has caught up"
            )
        return min(elapsed_s, LONGEST_STEP_S)

    def miss(self, dt_s: object) -> None:
        """A sample was rejected: its time still passes, if it has a valid one."""
        step_s = as_float(dt_s)
        if -self._most_back_s < step_s <= LONGEST_STEP_S:
            self.missed_s += step_s


LEAST_LIMIT = (
    1e-6  # no motor is weaker [Nm, N]; what is expected in fractions of it would vanish
)


def known_limits(limits: Array, instead: float) -> Array:
    """Effort limits of a description, shape (n,), with another number where it gives
    none.

    Files write 0, Pinocchio infinity or the largest float for "unknown".
    `ConfigurationError` for a limit that no motor has.
    """
    absurd = np.flatnonzero((limits > 0.0) & (limits < LEAST_LIMIT))
    if absurd.size:
        raise ConfigurationError(
            f"effort limits at {named_joints(absurd)} are {limits[absurd].tolist()}, expected at "
            f"least {LEAST_LIMIT:g} Nm, or 0 where it is unknown: correct the robot's description"
        )
    return np.where((limits > 0.0) & (limits < MOST_PLAUSIBLE), limits, instead)
