"""Any URDF file as a `Robot`."""

import sys
from collections.abc import Iterable, Mapping
from importlib import metadata
from importlib.resources import as_file, files
from os import PathLike
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from urdf.description import check_description, read_description
from urdf.errors import (
    InertiaError,
    InputError,
    MissingPackageError,
    UnknownNameError,
    UnsupportedJointError,
    UrdfFileError,
    finite_array,
)
from urdf.payload import NeedleTool, Payload
from urdf.robot import Robot

# From a bare Pinocchio model to a `Robot`: gravity, tool frames, last checks.


STANDARD_GRAVITY_M_S2 = (0.0, 0.0, -9.80665)
"""Straight down along the base's z axis, m/s^2."""

SENSOR_FRAME, TIP_FRAME = "ft_sensor", "needle_tip"
"""Frames that a needle tool adds."""


def assemble_robot(
    model: pin.Model,
    *,
    flange_frame: str,
    payload: Payload | NeedleTool | None,
    gravity_m_s2: ArrayLike,
    check_inertias: bool,
) -> Robot:
    """Complete a model: set gravity, mount the tool, check that it can be simulated and estimated.

    Args:
        model: The bare arm; changed in place.
        flange_frame: Frame that carries the payload.
        payload: A body in the flange frame, or a needle tool, which adds the frames ``ft_sensor``
            and ``needle_tip`` and makes the latter the tool frame.
        gravity_m_s2: Gravity in base axes, shape (3,), m/s^2.
        check_inertias: Whether the mass matrix must be positive definite.

    Raises:
        InputError: Gravity or payload of the wrong kind.
        UnknownNameError: The flange frame does not exist, or the tool's frames exist already.
        UnsupportedJointError: No joint moves, or one has a position of several numbers.
        InertiaError: A joint moves no inertia.
    """
    _check_joints(model)
    model.gravity = pin.Motion(finite_array(gravity_m_s2, (3,), "gravity_m_s2").copy(), np.zeros(3))
    bare = Robot(bare_model=model, tool_frame=flange_frame, flange_frame=flange_frame)
    if isinstance(payload, NeedleTool):
        _add_needle_frames(model, bare, payload)
        robot = Robot(
            bare_model=model,
            tool_frame=TIP_FRAME,
            flange_frame=flange_frame,
            payload=payload.payload,
        )
    elif payload is None or isinstance(payload, Payload):
        robot = bare.with_payload(payload)
    else:
        raise InputError(
            f"payload must be Payload, NeedleTool or None, got {type(payload).__name__}"
        )
    if check_inertias:
        _check_mass_matrix(robot)
    return robot


def _check_joints(model: pin.Model) -> None:
    if model.nv == 0:
        raise UnsupportedJointError(f"robot {model.name!r} has no joint that moves")
    for joint, name in zip(model.joints[1:], list(model.names)[1:], strict=True):
        if joint.nq != 1 or joint.nv != 1:
            raise UnsupportedJointError(
                f"joint {name!r} has {joint.nq} position and {joint.nv} velocity numbers, "
                "expected one of each (continuous, planar and free-floating joints do not work)"
            )


def _add_needle_frames(model: pin.Model, bare: Robot, tool: NeedleTool) -> None:
    for taken in (SENSOR_FRAME, TIP_FRAME):
        if taken in bare.frame_names:
            raise UnknownNameError(
                f"a NeedleTool adds the frame {taken!r}, but robot {model.name!r} has one of "
                "that name; rename it, or attach the tool as a plain payload (tool.payload)"
            )
    flange_id = bare.frame_id(bare.flange_frame)
    flange = model.frames[flange_id]
    heights = {SENSOR_FRAME: tool.sensor_height_m, TIP_FRAME: tool.tip_in_flange_m[2]}
    for name, height_m in heights.items():
        placement = flange.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, height_m]))
        model.addFrame(
            pin.Frame(name, flange.parentJoint, flange_id, placement, pin.FrameType.OP_FRAME)
        )


def _check_mass_matrix(robot: Robot) -> None:
    neutral = pin.neutral(robot.model)
    mass_matrix = pin.crba(robot.model, robot.create_data(), neutral)
    if np.linalg.eigvalsh(mass_matrix)[0] <= 0.0:
        bare_joints = [
            name
            for name, m in zip(robot.joint_names, np.diag(mass_matrix), strict=True)
            if m <= 0.0
        ]
        raise InertiaError(
            f"the mass matrix of robot {robot.model.name!r} is not positive definite; joints that "
            f"move no inertia: {', '.join(bare_joints) or 'none alone'}. "
            "Give the links inertia, or lock joints"
        )


def load_urdf(
    path: str | PathLike[str],
    *,
    tool_frame: str | None = None,
    locked_joints: Iterable[str] | Mapping[str, float] = (),
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    payload: Payload | NeedleTool | None = None,
    check_inertias: bool = True,
) -> Robot:
    """Load a URDF file. Meshes are neither needed nor looked for.

    Args:
        path: The file.
        tool_frame: Link or joint whose frame is both the tool frame and the flange that carries the
            payload (a needle tool then moves the tool frame on to its tip). Default: the last link,
            if there is one only.
        locked_joints: Joints to weld, at zero, or at the positions (rad or m) of a mapping.
        gravity_m_s2: Gravity in base axes, shape (3,), m/s^2.
        payload: What hangs on the flange.
        check_inertias: False accepts links no rigid body could be; identified models often have
            such.

    Raises:
        UrdfFileError: Missing, unreadable or malformed file.
        UnknownNameError: No such tool frame or joint, or no single last link to take by default.
        UnsupportedJointError: A joint that is continuous, planar, floating or a mimic, and not
            locked.
        InertiaError: A link with inertia no rigid body can have, or a joint that moves none.
        InputError: Gravity, payload or locked positions of the wrong kind.
    """
    text, source = read_description(Path(path)), str(path)
    locked = _locked_positions(locked_joints)
    check_description(text, source, locked=locked, check_inertias=check_inertias)
    try:
        model = pin.buildModelFromXML(text)
    except (ValueError, RuntimeError) as error:
        raise UrdfFileError(f"{source}: is not a valid URDF: {error}") from error
    flange_frame = tool_frame if tool_frame is not None else _last_link(model, source)
    return assemble_robot(
        _lock(model, locked, source),
        flange_frame=flange_frame,
        payload=payload,
        gravity_m_s2=gravity_m_s2,
        check_inertias=check_inertias,
    )


def _locked_positions(locked_joints: Iterable[str] | Mapping[str, float]) -> dict[str, float]:
    if isinstance(locked_joints, str):
        raise InputError(f"locked_joints is the string {locked_joints!r}, expected a list of names")
    if isinstance(locked_joints, Mapping):
        positions = {str(name): float(value) for name, value in locked_joints.items()}
    else:
        positions = dict.fromkeys(locked_joints, 0.0)
    for name, value in positions.items():
        if not np.isfinite(value):
            raise InputError(f"locked_joints: position of {name!r} is {value}, expected a number")
    return positions


def _lock(model: pin.Model, locked: dict[str, float], source: str) -> pin.Model:
    if not locked:
        return model
    names = list(model.names)
    step = np.zeros(model.nv)
    for name, position in locked.items():
        if name not in names[1:]:
            raise UnknownNameError(
                f"{source}: cannot lock {name!r}, there is no such joint; "
                f"joints: {', '.join(names[1:])}"
            )
        # Through the tangent, so that a continuous joint (a point on the circle) locks like any
        # other.
        step[model.joints[names.index(name)].idx_v] = position
    where = pin.integrate(model, pin.neutral(model), step)
    return pin.buildReducedModel(model, [names.index(name) for name in locked], where)


def _last_link(model: pin.Model, source: str) -> str:
    """Return the one link that moves and carries no other."""
    parents = {frame.parentFrame for frame in model.frames}
    ends = [
        frame.name
        for index, frame in enumerate(model.frames)
        if index not in parents and frame.parentJoint != 0
    ]
    if len(ends) != 1:
        raise UnknownNameError(
            f"{source}: give tool_frame, for there is no single last link; "
            f"it ends in: {', '.join(ends) or 'none'}"
        )
    return ends[0]


# The KUKA LWR 4+ of the paper.


LWR_GEAR_RATIO = (160.0, 160.0, 160.0, 160.0, 100.0, 100.0, 100.0)
"""Harmonic drives of the LWR 4+, joints 1 to 7 (sources give 60 or 160 for joint 4); the torque
sensors ripple with the motor angle."""


def load_lwr(
    payload: Payload | NeedleTool | None = None,
    *,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
) -> Robot:
    """Load the KUKA LWR 4+ that ships with the package.

    Joints ``lwr_joint_1`` to ``lwr_joint_7`` in the order of KUKA's interface (A1, A2, E1, A3, A4,
    A5, A6), zero when the arm points straight up. The frame ``flange`` lies in the flange's face, z
    outward.

    Args:
        payload: A body in the flange frame; or a needle tool, which adds the frames ``ft_sensor``
            and ``needle_tip`` (z in the direction of insertion) and makes ``needle_tip`` the tool
            frame. Without one the tool frame is ``flange``.
        gravity_m_s2: Gravity in base axes, shape (3,), m/s^2.

    Raises:
        InputError: Payload or gravity of the wrong kind.
    """
    with as_file(files("urdf.data").joinpath("lwr4plus.urdf")) as path:
        return load_urdf(path, tool_frame="flange", payload=payload, gravity_m_s2=gravity_m_s2)


# Where to find the arms of the optional data package ``example-robot-data``.


_ROBOTS = {
    "panda": "panda_description/urdf/panda.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
}
_PACKAGE = "example-robot-data"


def example_robot_path(name: str) -> Path:
    """Return the URDF file of an arm of ``example-robot-data``, for `urdf.load_urdf`.

    Panda needs ``tool_frame`` (such as ``panda_hand_tcp``) and its two finger joints locked; the UR
    arms need ``tool_frame`` (``tool0``).

    Args:
        name: One of panda, ur3, ur5, ur10.

    Raises:
        UnknownNameError: Another name.
        MissingPackageError: The package is not installed.
    """
    if name not in _ROBOTS:
        raise UnknownNameError(f"there is no example robot {name!r}; robots: {', '.join(_ROBOTS)}")
    for prefix in _prefixes():
        path = prefix / "share" / _PACKAGE / "robots" / _ROBOTS[name]
        if path.is_file():
            return path
    raise MissingPackageError(
        f"the description of {name!r} comes with {_PACKAGE}, which is not installed; "
        f"install it with: pip install {_PACKAGE}"
    )


def _prefixes() -> list[Path]:
    """Return where pip (a cmeel wheel) and conda put shared data."""
    prefixes = [Path(sys.prefix)]
    try:
        located = metadata.distribution(_PACKAGE).locate_file("cmeel.prefix")
    except metadata.PackageNotFoundError:
        return prefixes
    return [Path(str(located)), *prefixes]
