"""Errors of the robot package, and the checks of array arguments that raise them."""

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.errors import NeedleforceError

PLAIN_URDF = "Give the path of a plain URDF file; expand a xacro file first."
KEEP_JOINTS = (
    "Name the joints of the log with `keep_joints`; for a real robot raise "
    "`urdf.description.MAX_JOINTS` or `urdf.joint_choice.MAX_MOVING_JOINTS`."
)
GIVE_INERTIA = (
    "Give the links mass, centre and inertia; lock their joints with `locked_joints`, "
    "or all that the log does not have with `keep_joints`; `check_inertias=False` goes "
    "on without their weight."
)


class UrdfError(NeedleforceError):
    """Base of every error raised by `urdf`."""


class UrdfFileError(UrdfError, ValueError):
    """A robot description is missing, unreadable, malformed or too large."""

    usual_advice = "Correct the file; `check_urdf` of ROS names further mistakes."


class UnknownNameError(UrdfError, LookupError):
    """A frame, link, joint or robot of that name does not exist.

    The message lists those that do.
    """


class InertiaError(UrdfError, ValueError):
    """Inertial parameters that no rigid body can have."""

    usual_advice = (
        "Check the numbers, their units and the axes they are expressed in; "
        "`check_inertias=False` accepts them."
    )


class UnsupportedJointError(UrdfError, ValueError):
    """A joint whose position and velocity do not have one number each."""

    usual_advice = (
        "Name the joints of the log with `keep_joints`: all others are locked; "
        "or lock single ones with `locked_joints`."
    )


class InputError(UrdfError, ValueError):
    """An argument of the wrong shape, not finite, or out of its range."""


class MissingPackageError(UrdfError, ImportError):
    """An optional data package is not installed; the advice says how to install it."""

    usual_advice = "Install it: pip install 'needleforce[robots]'."


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
    is_fit = array.ndim == len(shape) and all(
        length > 0 and expected_length in (-1, length)
        for length, expected_length in zip(array.shape, shape, strict=True)
    )
    if not is_fit or not np.isfinite(array).all():
        raise InputError(
            f"{name} has shape {array.shape}, expected {expected}, all numbers finite"
        )
    return array
