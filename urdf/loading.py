"""Any URDF file as a `Robot`."""

from collections.abc import Iterable, Mapping
from os import PathLike
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from urdf.assembly import STANDARD_GRAVITY_M_S2, assemble_robot
from urdf.description import check_description, read_description
from urdf.errors import InputError, UnknownNameError, UrdfFileError
from urdf.needle_tool import NeedleTool
from urdf.payload import Payload
from urdf.robot import Robot


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
