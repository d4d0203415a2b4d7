"""Depth and speed of the needle by the robot's own kinematics."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.tool_kinematics import ToolKinematics
from speedup import Matrix, Vector, compiled

_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick


class Travel(NamedTuple):
    """Travel of the tip along the needle, and its rate.

    Attributes:
        depth_m: Along the needle's direction at the zero, growing inwards.
        speed_m_s: Along the needle's present direction.
    """

    depth_m: float
    speed_m_s: float


class TravelZero(NamedTuple):
    """Where depth is counted from.

    Attributes:
        start_in_base_m: The tip's place, shape (3,).
        axis_in_base: The needle's direction, shape (3,).
    """

    start_in_base_m: NDArray[np.float64]
    axis_in_base: NDArray[np.float64]


@compiled
def tip_motion(axis: Vector, pose: Matrix, advance: Vector, dq: Vector) -> tuple[float, float]:
    """Place of the tip along an axis [m], and its speed along the needle [m/s].

    Args:
        axis: In base axes, shape (3,).
        pose: See `residual.tool_kinematics.ToolKinematics`, as the next.
        advance: Shape (n,).
        dq: Joint velocities [rad/s], shape (n,).
    """
    tip_m = np.ascontiguousarray(pose[:3, 3])
    return float(axis.dot(tip_m)), float(advance.dot(dq))


class TipTravel:
    """Reads depth and speed off kinematics that somebody else keeps up to date.

    Args:
        kinematics: Of the tool; the virtual sensor's own, or one's own.
    """

    def __init__(self, kinematics: ToolKinematics) -> None:
        self._kinematics = kinematics
        self.zero()

    def zero(self) -> None:
        """Count depth from where the tip is, along the needle as it stands."""
        tool = self._kinematics
        self.restore(TravelZero(tool.place_in_base_m.copy(), tool.axis_in_base.copy()))

    def read(self, dq: NDArray[np.float64]) -> Travel:
        """Depth and speed where the kinematics stand, for joint velocities [rad/s], shape (n,)."""
        tool = self._kinematics
        along_m, speed_m_s = tip_motion(self._axis, tool.pose, tool.advance, dq)
        return _new(Travel, (along_m - self._start_m, speed_m_s))

    @property
    def state(self) -> TravelZero:
        """Where depth is counted from."""
        return self._zero

    def restore(self, state: TravelZero) -> None:
        """Count from a `state` taken earlier."""
        self._zero = state
        self._axis = state.axis_in_base
        self._start_m = float(self._axis.dot(state.start_in_base_m))
