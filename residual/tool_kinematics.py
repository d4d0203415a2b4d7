"""Where the tool is and how joint motion moves it: computed once per sample, used by all."""

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from residual.errors import ConfigurationError
from urdf import Robot

_LOCAL = pin.ReferenceFrame.LOCAL


class ToolKinematics:
    """Pose and Jacobian of one frame of a robot, and the needle's direction in it.

    Args:
        robot: The arm.
        frame: Name of the frame; the robot's tool frame when None.
        insertion_axis: Insertion direction in the frame's axes, normalised here.

    Attributes:
        jacobian: Of the latest `update`, in the frame's own axes, shape (6, n).
        advance: Its row along the insertion axis [m]: advance · dq is the speed of the needle,
            and minus advance the joint torque per newton of resistance, shape (n,).
        axis_in_base: Insertion direction in base axes, shape (3,).
        pose: Of the frame in the base, homogeneous, shape (4, 4).

    Raises:
        ConfigurationError: For a zero axis.
        urdf.UrdfError: For an unknown frame.
    """

    def __init__(
        self,
        robot: Robot,
        frame: str | None = None,
        insertion_axis: ArrayLike = (0.0, 0.0, 1.0),
    ) -> None:
        self._model, self._data = robot.model, robot.create_data()
        self._frame_id = robot.frame_id(frame if frame is not None else robot.tool_frame)
        self.axis_in_tool = unit_axis(insertion_axis)
        # One row of the Jacobian is the row along the axis, where the axis is one of the frame's.
        aligned = np.flatnonzero(self.axis_in_tool == 1.0)
        self._row = int(aligned[0]) if len(aligned) else None
        self.jacobian = np.zeros((6, robot.nv))
        self.advance = np.zeros(robot.nv)
        self.axis_in_base = self.axis_in_tool
        self.pose = np.eye(4)

    def update(self, q: NDArray[np.float64], computed: pin.Data | None = None) -> None:
        """Move to a configuration [rad], shape (n,).

        Args:
            q: Joint positions.
            computed: Workspace in which joint placements and Jacobians of q stand already.
        """
        data = self._data
        if computed is None:
            pin.computeJointJacobians(self._model, data, q)
        else:
            data = computed
        model, frame, row = self._model, self._frame_id, self._row
        self.jacobian = jacobian = pin.getFrameJacobian(model, data, frame, _LOCAL)
        self.pose = pose = pin.updateFramePlacement(model, data, frame).homogeneous
        if row is None:
            self.advance = self.axis_in_tool.dot(jacobian[:3])
            self.axis_in_base = pose[:3, :3].dot(self.axis_in_tool)
        else:
            self.advance = jacobian[row].copy()
            self.axis_in_base = pose[:3, row]

    @property
    def rotation_tool_to_base(self) -> NDArray[np.float64]:
        """Axes of the frame in base axes, shape (3, 3)."""
        return self.pose[:3, :3]

    @property
    def place_in_base_m(self) -> NDArray[np.float64]:
        """Where the frame's origin is, shape (3,)."""
        return self.pose[:3, 3]


def unit_axis(axis: ArrayLike) -> NDArray[np.float64]:
    """An insertion axis of length one, shape (3,).

    Raises:
        ConfigurationError: If it is not three finite numbers, or all of them are zero.
    """
    try:
        given = np.zeros(0) if np.iscomplexobj(axis) else np.asarray(axis, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        given = np.zeros(0)
    if given.shape != (3,) or not np.isfinite(given).all() or not given.any():
        raise ConfigurationError(
            f"insertion_axis is {axis!r}, expected three numbers, not all zero"
        )
    given = given / np.abs(given).max()
    return given / np.linalg.norm(given)
