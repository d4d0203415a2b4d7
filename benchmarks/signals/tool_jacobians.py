"""What joints feel of a force at the tool."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from urdf import Robot

Array = NDArray[np.float64]


def tool_jacobians(robot: Robot, q_rad: Array) -> Array:
    """Jacobians of the tool frame in its own axes, shape (n, 6, j); row 2 is along the needle.

    Args:
        robot: An arm of j joints.
        q_rad: Joint positions, shape (n, j).
    """
    model, data, frame = robot.model, robot.create_data(), robot.tool_frame_id
    axes = pin.ReferenceFrame.LOCAL
    return np.array([pin.computeFrameJacobian(model, data, q, frame, axes) for q in q_rad])
