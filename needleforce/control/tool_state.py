"""Where the needle is and how joint motion moves it: one pass of Pinocchio a tick."""

import numpy as np
import pinocchio as pin

from needleforce.control.ports import Array
from urdf import Robot

_BASE_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


class ToolState:
    """Pose and Jacobian of the needle's tip, which all tasks of a tick read.

    Args:
        robot: The arm; the z axis of its tool frame is the needle, growing inwards.

    Attributes:
        q_rad: Joint positions of the last `update`, shape (n,).
        jacobian: Velocity of the tip (rows 0 to 2) and angular velocity (3 to 5) per joint
            velocity, both in base axes, shape (6, n).
        pose: Of the tip in the base, homogeneous, shape (4, 4).
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._data = robot.model, robot.create_data()
        self._frame_id = robot.tool_frame_id
        self.update(pin.neutral(robot.model))

    def update(self, q_rad: Array) -> None:
        """Move to a configuration, shape (n,)."""
        model, data, frame = self._model, self._data, self._frame_id
        jacobian = pin.computeFrameJacobian(model, data, q_rad, frame, _BASE_AXES)
        # Of a single joint it comes as a vector.
        self.jacobian: Array = jacobian if jacobian.ndim == 2 else jacobian[:, None]
        self.pose: Array = pin.updateFramePlacement(model, data, frame).homogeneous
        self.q_rad = q_rad

    @property
    def tip_m(self) -> Array:
        """Where the tip is, shape (3,), a copy."""
        return self.pose[:3, 3].copy()

    @property
    def rotation(self) -> Array:
        """Axes of the tool in base axes, shape (3, 3), a copy."""
        return np.ascontiguousarray(self.pose[:3, :3])

    @property
    def axis(self) -> Array:
        """Direction of insertion in base axes, of length one, shape (3,), a copy."""
        return self.pose[:3, 2].copy()
