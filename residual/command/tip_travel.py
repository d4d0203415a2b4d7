"""How far the tool has travelled along the needle, for force over depth."""

import numpy as np
from numpy.typing import NDArray

from residual.sensor_config import SensorConfig
from residual.tool_kinematics import ToolKinematics
from urdf import Robot


class TipTravel:
    """Travel along the insertion axis as it stood in the first sound row.

    Args:
        robot: The arm.
        config: Names frame and insertion axis.
    """

    def __init__(self, robot: Robot, config: SensorConfig) -> None:
        self._tool = ToolKinematics(robot, config.frame, config.insertion_axis)
        self._start: NDArray[np.float64] | None = None
        self._axis = self._tool.axis_in_base

    def __call__(self, q_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the travel in further rows.

        Args:
            q_rad: Joint positions [rad], shape (n, joints).

        Returns:
            Travel since the first sound row [m], shape (n,), NaN where positions are not finite.
        """
        positions = np.full((len(q_rad), 3), np.nan)
        for k in np.flatnonzero(np.isfinite(q_rad).all(axis=1)).tolist():
            self._tool.update(q_rad[k])
            positions[k] = self._tool.place_in_base_m
            if self._start is None:
                self._start = positions[k].copy()
                self._axis = self._tool.axis_in_base.copy()
        if self._start is None:
            return positions[:, 0]
        # Not a matrix product, whose rounding may depend on how many rows come at a time.
        x, y, z = (positions - self._start).T * self._axis[:, None]
        return 0.0 + x + y + z
