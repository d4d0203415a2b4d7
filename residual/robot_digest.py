"""A short name for everything about a robot that an estimate depends on."""

import hashlib

import numpy as np

from urdf import Robot


def robot_digest(robot: Robot) -> str:
    """Hash of joints, links, payload, frames, limits and gravity of a robot.

    Args:
        robot: Any robot.

    Returns:
        64 hexadecimal digits; equal for robots that no estimator can tell apart.
    """
    model = robot.model
    names = (*robot.joint_names, robot.tool_frame, *robot.frame_names)
    arrays = [
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
