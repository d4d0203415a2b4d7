"""From a bare Pinocchio model to a `Robot`: gravity, tool frames, last checks."""

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from urdf.errors import InertiaError, InputError, UnknownNameError, UnsupportedJointError
from urdf.finite_array import finite_array
from urdf.needle_tool import NeedleTool
from urdf.payload import Payload
from urdf.robot import Robot

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
