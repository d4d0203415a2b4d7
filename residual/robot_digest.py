"""A short name for everything about a robot that an estimate depends on."""

import hashlib

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from urdf import Robot


def robot_digest(robot: Robot) -> str:
    """Hash of joints with their axes and parents, links, payload, frames, limits and gravity.

    Args:
        robot: Any robot.

    Returns:
        64 hexadecimal digits; equal for robots that no estimator can tell apart.
    """
    model = robot.model
    names = (*robot.joint_names, robot.tool_frame, *robot.frame_names)
    arrays = [
        np.array(list(model.parents)),
        np.array([frame.parentJoint for frame in model.frames]),
        *(_axis(joint) for joint in list(model.joints)[1:]),
        *(inertia.toDynamicParameters() for inertia in model.inertias),
        *(placement.homogeneous for placement in model.jointPlacements),
        *(frame.placement.homogeneous for frame in model.frames),
        robot.gravity_m_s2,
        robot.position_lower_rad,
        robot.position_upper_rad,
        robot.effort_limit_Nm,
        model.armature,
    ]
    found = hashlib.sha256("\n".join(names).encode())
    for array in arrays:
        found.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
    return found.hexdigest()


def _axis(joint: pin.JointModel) -> NDArray[np.float64]:
    """How a joint of one number moves its link: velocity and rotation for a rate of one."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq))
    return np.asarray(data.S)
