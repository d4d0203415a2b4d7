"""Pose and Jacobian of the tool, computed once per sample and used by all."""

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Array
from residual.checks.input import vector_of_three
from residual.errors import ConfigurationError
from urdf import Robot

_LOCAL = pin.ReferenceFrame.LOCAL
MAX_OFFSET_M = 10.0
"""Largest distance of the tip from the frame: no tool is longer."""


class ToolKinematics:
    """Pose and Jacobian of one frame of a robot, and the needle's direction in it.

    Args:
        robot: The arm.
        frame: Name of the frame; the robot's tool frame when None.
        insertion_axis: Insertion direction in the frame's axes, normalised here.
        offset_m: Where the needle's tip is in that frame: pose and Jacobian are the
            tip's.

    Attributes:
        axis_in_tool: The insertion direction, of length one, shape (3,).
        needle: What motion of the tip follows from, always of the latest `update`. Of
            the joint that carries the needle: place in the base [m], shape (3,); its
            axes there, one a row, shape (3, 3); its Jacobian at the base's origin in
            base axes, a row per joint, shape (n, 6). In that joint's axes: tip [m] and
            direction of the needle, shape (3,).

    Raises:
        ConfigurationError: For a zero axis, or an offset that cannot be.
        urdf.UrdfError: For an unknown frame.
    """

    def __init__(
        self,
        robot: Robot,
        frame: str | None = None,
        insertion_axis: ArrayLike = (0.0, 0.0, 1.0),
        offset_m: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.axis_in_tool = unit_axis(insertion_axis)
        frame_id = robot.frame_id(frame if frame is not None else robot.tool_frame)
        tool_frame = robot.model.frames[frame_id]
        tip = tool_frame.placement * pin.SE3(np.eye(3), check_offset(offset_m))
        self._model = pin.Model(robot.model)
        self._frame_id = self._model.addFrame(
            pin.Frame(
                "tip of the needle", tool_frame.parentJoint, tip, pin.FrameType.OP_FRAME
            ),
            False,
        )
        self._data = self._model.createData()
        self._joint = tool_frame.parentJoint
        self._tip = tip.translation.copy(), tip.rotation.dot(self.axis_in_tool)
        self._share()

    def _share(self) -> None:
        """Read in place from Pinocchio's workspace, which every `update` fills.

        Calls that copy it take longer.
        """
        joint = self._data.oMi[self._joint]
        workspace = joint.translation, joint.rotation.T, self._data.J.reshape(6, -1).T
        self.needle = (*workspace, *self._tip)

    def __getstate__(self) -> dict[str, Any]:
        state = vars(self).copy()
        del state["needle"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)  # A deep copy has a workspace of its own.
        self._share()

    def update(self, q: Array) -> None:
        """Move to a configuration [rad], shape (n,)."""
        pin.computeJointJacobians(self._model, self._data, q)

    @property
    def jacobian(self) -> Array:
        """Jacobian at the latest `update`, in the frame's own axes, shape (6, n)."""
        jacobian = pin.getFrameJacobian(self._model, self._data, self._frame_id, _LOCAL)
        return jacobian.reshape(6, -1)  # of a single joint it comes as a vector

    @property
    def pose(self) -> Array:
        """Pose of the tip in the base, homogeneous, shape (4, 4)."""
        return pin.updateFramePlacement(
            self._model, self._data, self._frame_id
        ).homogeneous

    @property
    def rotation(self) -> Array:
        """Rotation from the frame's own axes to those of the base, shape (3, 3)."""
        return np.ascontiguousarray(self.pose[:3, :3])

    @property
    def axial_jacobian(self) -> Array:
        """Row of the Jacobian along the insertion axis [m], shape (n,).

        Times dq it is the speed of the needle, minus it the joint torque per newton of
        resistance.
        """
        return self.axis_in_tool.dot(self.jacobian[:3])

    @property
    def axis_in_base(self) -> Array:
        """Insertion direction in base axes, shape (3,)."""
        return self.pose[:3, :3].dot(self.axis_in_tool)


def unit_axis(axis: ArrayLike) -> Array:
    """Return an insertion axis scaled to length one, shape (3,).

    Raises:
        ConfigurationError: If it is not finite, or zero.
    """
    direction = vector_of_three("insertion_axis", axis)
    if not direction.any():
        raise ConfigurationError(
            f"insertion_axis is {axis!r}: they must not all be zero"
        )
    # Scaled first, since the square of a large number overflows.
    direction = direction / np.abs(direction).max()
    return direction / np.linalg.norm(direction)


def check_offset(offset_m: ArrayLike) -> Array:
    """Return a tip offset [m] as an array, shape (3,).

    Raises:
        ConfigurationError: If it is not three numbers, or longer than any tool.
    """
    tip_offset_m = vector_of_three("tool_offset_m", offset_m)
    if np.abs(tip_offset_m).max() > MAX_OFFSET_M:
        raise ConfigurationError(
            f"tool_offset_m is {offset_m!r}, beyond {MAX_OFFSET_M:g} m: is it in "
            "millimetres?"
        )
    return tip_offset_m
