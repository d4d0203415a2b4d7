"""Robots from files: any URDF, and well-known arms by name."""

import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from importlib import metadata
from importlib.resources import files
from os import PathLike
from pathlib import Path

import pinocchio as pin
from numpy.typing import ArrayLike

from urdf.description import build_model, read_description
from urdf.errors import (
    MissingPackageError,
    UnknownNameError,
    finite_array,
)
from urdf.joint_choice import last_link, lock_joints
from urdf.payload import NeedleTool, Payload
from urdf.robot import STANDARD_GRAVITY_M_S2, Robot, build_robot

LWR_GEAR_RATIO = (160.0, 160.0, 160.0, 160.0, 100.0, 100.0, 100.0)
"""Harmonic drives of the LWR 4+, joints 1 to 7 (sources give 60 or 160 for joint 4);
the torque sensors ripple with the motor angle."""


def load_urdf(
    path: str | PathLike[str],
    *,
    tool_frame: str | None = None,
    tool_placement: pin.SE3 | ArrayLike | None = None,
    locked_joints: Iterable[str] | Mapping[str, float] = (),
    keep_joints: Iterable[str] | None = None,
    without: Iterable[str] = (),
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    payload: Payload | NeedleTool | None = None,
    check_inertias: bool = True,
) -> Robot:
    """Load a URDF file. Meshes are neither needed nor looked for.

    A continuous joint is an angle without limits; what is odd in the description and
    could be loaded stands in the robot's ``warnings``.

    Args:
        path: The file.
        tool_frame: Link or joint whose frame is both the tool frame and the flange that
            carries the payload (a needle tool then moves the tool frame on to its tip).
            Default: the last moving link, if there is one only.
        tool_placement: Where the tool is mounted in that frame, if not at its origin or
            not along its z axis: ``pin.SE3``, a homogeneous matrix of shape (4, 4), or
            an offset of shape (3,), m. It adds the frame ``tool``, which is then tool
            frame and flange.
        locked_joints: Joints to weld, at zero, or at the positions (rad or m) of a
            mapping. A joint that mimics one of them is welded with it.
        keep_joints: Joints that move, as those that a log has; all others are welded.
            Default: all that are not locked.
        without: Links to leave out, such as a hand that has been taken off, each with
            its joint, its inertia and all that it carries.
        gravity_m_s2: Gravity in base axes, shape (3,), m/s^2.
        payload: What hangs on the flange, in its frame.
        check_inertias: False accepts, with a warning, links without inertia or with one
            that no rigid body can have, as identified models have.

    Raises:
        UrdfFileError: Missing, unreadable, malformed or too large a file.
        UnknownNameError: No such tool frame, link or joint, or no single last link.
        UnsupportedJointError: Joints of several numbers or mimics, not locked; none
            that moves, or more than `joint_choice.MAX_MOVING_JOINTS`.
        InertiaError: Links that move without inertia, or with one that no rigid body
            can have; with the checks off only if none has any.
        InputError: Gravity, payload, placement or locked positions of the wrong kind.
    """
    source = str(path)
    if not isinstance(locked_joints, Mapping):
        locked_joints = dict.fromkeys(locked_joints, 0.0)
    for name, position in locked_joints.items():
        finite_array(position, (), f"locked_joints: position of {name!r}")
    root = read_description(Path(path), without)
    model = build_model(root, source)
    model = lock_joints(root, model, source, locked=locked_joints, kept=keep_joints)
    return build_robot(
        model,
        flange_frame=tool_frame or last_link(root, model, source),
        tool_placement=tool_placement,
        gravity_m_s2=gravity_m_s2,
        payload=payload,
        check_inertias=check_inertias,
    )


def load_lwr(
    payload: Payload | NeedleTool | None = None,
    *,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
) -> Robot:
    """Load the KUKA LWR 4+ that ships with the package.

    Joints ``lwr_joint_1`` to ``lwr_joint_7`` in the order of KUKA's interface (A1, A2,
    E1, A3, A4, A5, A6), zero when the arm points straight up. The frame ``flange`` lies
    in the flange's face, z outward; it is the tool frame. A needle tool as payload adds
    the frames ``ft_sensor`` and ``needle_tip`` (z in the direction of insertion), and
    ``needle_tip`` is the tool frame then. Arguments and errors are those of
    `load_urdf`.
    """
    return load_example("lwr4plus", payload=payload, gravity_m_s2=gravity_m_s2)


EXAMPLES = {
    "panda": "panda_description/urdf/panda.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "ur5e": "ur5e.urdf",
    "ur10e": "ur10e.urdf",
    "lwr4plus": "lwr4plus.urdf",
}
"""File of each known arm, in urdf/data or below robots/ of example-robot-data."""

# Of these, the first that an arm has is its tool frame.
_TOOL_FRAMES = (
    "panda_hand_tcp",
    "panda_hand",
    "panda_link8",
    "tool0",
    "link_eef",
    "flange",
)
_FINGERS = ("panda_finger_joint1", "panda_finger_joint2")


def load_example(
    name: str,
    *,
    tool_frame: str | None = None,
    tool_placement: pin.SE3 | ArrayLike | None = None,
    without: Iterable[str] = (),
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    payload: Payload | NeedleTool | None = None,
) -> Robot:
    """Load a well-known arm by name, with its tool frame set and its fingers locked.

    The UR arms have their tool frame in the flange face (``tool0``, z outward), xArm 7
    in ``link_eef``, Panda between the finger tips (``panda_hand_tcp``) or, with
    ``without=["panda_hand"]`` and 0.76 kg less, in the flange face (``panda_link8``).

    Names are panda, ur3, ur5, ur10, xarm7 (from the package example-robot-data), ur5e,
    ur10e and lwr4plus (shipped here). The other arguments and errors are those of
    `load_urdf`.

    Raises:
        UnknownNameError: Another name.
        MissingPackageError: example-robot-data is needed and not installed.
    """
    path = example_robot_path(name)
    without = tuple(without)
    names = {element.get("name") for element in read_description(path, without)}
    default_frame = next((frame for frame in _TOOL_FRAMES if frame in names), None)
    return load_urdf(
        path,
        tool_frame=tool_frame or default_frame,
        tool_placement=tool_placement,
        locked_joints=[joint for joint in _FINGERS if joint in names],
        without=without,
        gravity_m_s2=gravity_m_s2,
        payload=payload,
    )


def example_robot_path(name: str) -> Path:
    """Return the URDF file of an arm that `load_example` loads.

    With `load_urdf` Panda needs ``tool_frame`` (such as ``panda_hand_tcp``) and its two
    finger joints locked; the UR arms need ``tool_frame`` (``tool0``). Names and errors
    as there.
    """
    package = "example-robot-data"
    if name not in EXAMPLES:
        raise UnknownNameError(
            f"there is no example robot {name!r}; robots: {', '.join(EXAMPLES)}",
            "Give one of the names that the message lists; `load_urdf` loads "
            "any other.",
        )
    # Conda puts shared data below the prefix of Python, pip into a cmeel wheel.
    prefixes = [Path(sys.prefix)]
    with suppress(metadata.PackageNotFoundError):
        prefixes.insert(
            0, Path(str(metadata.distribution(package).locate_file("cmeel.prefix")))
        )
    folders = [prefix / "share" / package / "robots" for prefix in prefixes]
    for folder in (Path(str(files("urdf.data"))), *folders):
        if (folder / EXAMPLES[name]).is_file():
            return folder / EXAMPLES[name]
    raise MissingPackageError(
        f"the description of {name!r} comes with {package}, which is not installed"
    )
