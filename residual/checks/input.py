"""Refuses samples and settings that cannot be: every number from outside passes here.

A bad sample raises a `SampleError`, a bad setting a `ConfigurationError`, with its name
and value.
"""

import math
import numbers
import sys
from typing import Any

import numpy as np

from foundation.arrays import Array
from foundation.jit import compiled_inside
from residual.errors import (
    NEXT_TIME_STEP,
    ConfigurationError,
    SampleError,
    named_joints,
)

MAX_PLAUSIBLE = 1e5
"""Largest joint signal in SI units [rad, rad/s, Nm]: none comes near it, and far beyond
it products overflow."""

MIN_STEP_S = 1e-12
"""Shortest time step: no clock ticks faster, and the inverse of a far shorter one
overflows."""

STEP_GRID_S = 2.0**-30
"""Distance of the time steps that are told apart, about a nanosecond. As a power of two
it has steps such as 1/1024 s on the grid, rather than halfway between two points."""

MAX_STEP_S = 86_400.0
"""Longest time step: beyond a day it is no pause but a clock that was set, from boot
time to date perhaps."""

ROUNDING_S = 1e-5
"""Sums of time steps that come this near to a limit have reached it [s]: stamps since
1970 are rounded to a quarter of a microsecond, and rounding must not decide on a tick
more or less."""

MIN_EFFORT_LIMIT = 1e-6
"""Smallest effort limit [Nm, N]: no motor is weaker, and expectations in fractions of
it would vanish."""

FLOAT64 = np.dtype(np.float64)
"""The ``dtype`` of arrays of floats."""


@compiled_inside
def round_step(dt_s: float) -> float:
    """Return the time step on the grid of `STEP_GRID_S` that is nearest.

    On it the steps of an even clock are equal, whatever rounding makes of each. A step
    far below the grid is returned as it is.
    """
    return round(dt_s / STEP_GRID_S) * STEP_GRID_S or dt_s


def check_interval(dt_s: Any) -> float:
    """Return a time step [s], any real number, as a plain float.

    Raises:
        SampleError: If it is not a finite positive number, or beyond `MAX_STEP_S`.
    """
    step_s = as_float(dt_s)
    # A clock that was set, from boot time to date perhaps, steps by more than a day.
    if not MIN_STEP_S <= step_s <= MAX_STEP_S:
        raise SampleError(
            f"dt_s is {step_s:g} s, expected a positive time step as a clock makes it, "
            "a day at most",
            NEXT_TIME_STEP,
        )
    return step_s


def as_float(value: Any) -> float:
    """Return a real number of any type as a float; NaN for anything else.

    An integer beyond all floats, of either sign, becomes the largest one.
    """
    if type(value) is float:  # as nearly always
        return value
    # A time span of numpy counts as an integer there, of a unit that nobody knows here.
    if not isinstance(value, numbers.Real) or isinstance(value, bool | np.timedelta64):
        return math.nan
    try:
        return float(value)
    except OverflowError:
        return sys.float_info.max  # an integer of more digits than floats have


def check_joint_vector(name: str, value: object, joints: int) -> Array:
    """Read a vector of one number per joint, shape (joints,); itself where it fits.

    Raises:
        SampleError: For another shape, or unless all are real, finite and, as a vector,
            shorter than `MAX_PLAUSIBLE`.
    """
    try:
        array = _read_real(value)
    except Exception as error:  # a stranger's type may raise anything
        raise SampleError(f"{name} is not an array of numbers: {error}") from error
    if array.shape != (joints,):
        raise SampleError(
            f"{name} has shape {array.shape}, expected ({joints},): one number per "
            "joint"
        )
    # Almost every sample ends here: one number shows that all are finite and small.
    if math.hypot(*array.tolist()) < MAX_PLAUSIBLE:
        return array
    if not np.isfinite(array).all():
        joints_text = named_joints(np.flatnonzero(~np.isfinite(array)))
        raise SampleError(f"{name} is not finite at {joints_text}")
    raise SampleError(
        f"{name} reaches {np.abs(array).max():.3g}, expected SI units far below "
        f"{MAX_PLAUSIBLE:g}"
    )


def _read_real(value: Any) -> Array:
    """Read an array of floats.

    Raises:
        TypeError: For text, truth values, dates, and complex or masked numbers.
    """
    array = np.asanyarray(value)
    if array.dtype is FLOAT64 and type(array) is np.ndarray:
        return array
    # Objects may be numbers of any kind: what is none cannot be converted.
    if array.dtype.kind not in "fiuO" or np.ma.is_masked(array):
        raise TypeError(f"it holds {array.dtype}, or masked numbers")
    return np.asarray(array, dtype=np.float64)


def read_rows(names: tuple[str, ...], values: tuple[Any, ...], joints: int) -> Array:
    """Read k named signals into a copy of shape (k, joints), of any numbers.

    Raises:
        SampleError: As of `check_joint_vector`, where numpy cannot read them so.
    """
    shape = (joints,)
    rows = np.empty((len(values), joints))
    for k, value in enumerate(values):
        is_plain = type(value) is np.ndarray and value.shape == shape
        # Arrays that were pickled bring a dtype of their own, equal and not the same.
        if is_plain and (value.dtype is FLOAT64 or value.dtype == FLOAT64):
            rows[k] = value  # almost every sample
        else:
            rows[k] = check_joint_vector(names[k], value, joints)
    return rows


def check_rows(names: tuple[str, ...], rows: Array) -> None:
    """Refuse numbers that `read_rows` has read, as `check_joint_vector` does."""
    # One number stands for all; `hypot` does not overflow, and a NaN fails.
    if not math.hypot(*rows.ravel().tolist()) < MAX_PLAUSIBLE:
        for name, row in zip(names, rows, strict=True):
            check_joint_vector(name, row, len(row))


def check_positive(
    name: str, value: object, *, minimum: float = 1e-30, maximum: float = 1e30
) -> None:
    """Refuse a setting that is not a positive number between two limits.

    The limits that are there by default keep its square from over- and underflow.
    """
    number = as_float(value)
    if not minimum <= number <= maximum:
        raise ConfigurationError(
            f"{name} is {number:g}, expected a number > 0, between {minimum:g} and "
            f"{maximum:g}"
        )


def check_choice(name: str, value: object, choices: tuple[str, ...]) -> None:
    """Refuse a setting that is none of the choices."""
    if not (isinstance(value, str) and value in choices):
        raise ConfigurationError(
            f"{name} is {value!r}, expected one of {list(choices)}"
        )


def vector_of_three(name: str, value: object) -> Array:
    """Read a setting of three finite numbers, shape (3,)."""
    try:
        vector = _read_real(value)
    except Exception:  # a stranger's type may raise anything
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise ConfigurationError(f"{name} is {value!r}, expected three finite numbers")
    return vector


def elapsed_time(dt_s: Any, missed_s: float) -> float:
    """Return the time since the last sample that was used [s].

    A clock that goes back a little comes forward again: samples are rejected until it
    has caught up.

    Args:
        dt_s: Time since the last sample.
        missed_s: Time from the last sample that was used to that one; negative after a
            step back.

    Raises:
        SampleError: For a time step that does not advance, or a clock that was set.
    """
    step_s = check_interval(dt_s)
    if not missed_s:
        return step_s
    elapsed_s = step_s + missed_s
    if elapsed_s <= 0.0:
        raise SampleError(
            f"dt_s is {step_s!r} s after a clock that went back by {-missed_s:.3g} s; "
            "rejected until it has caught up",
            NEXT_TIME_STEP,
        )
    return min(elapsed_s, MAX_STEP_S)


def known_limits(limits: Array, instead: float) -> Array:
    """Return effort limits, shape (n,), with ``instead`` where one is not known.

    Robot descriptions write 0, Pinocchio infinity or the largest float for "unknown".

    Raises:
        ConfigurationError: For a limit that no motor has.
    """
    absurd = np.flatnonzero((limits > 0.0) & (limits < MIN_EFFORT_LIMIT))
    if absurd.size:
        raise ConfigurationError(
            f"effort limits at {named_joints(absurd)} are {limits[absurd].tolist()}, "
            f"expected at least {MIN_EFFORT_LIMIT:g} Nm, or 0 where it is unknown",
            "Correct the effort limits in the robot's description; 0 where "
            "one is unknown.",
        )
    return np.where((limits > 0.0) & (limits < MAX_PLAUSIBLE), limits, instead)
