"""How far the tool has travelled along the needle, for force over depth."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from residual.sensor_config import SensorConfig
from urdf import Robot


class TipTravel:
    """Travel along the insertion axis as it stood in the first sound row.

    Args:
        robot: The arm.
        config: Names frame and insertion axis.
    """

    def __init__(self, robot: Robot, config: SensorConfig) -> None:
        self._model, self._data = robot.model, robot.create_data()
        self._frame_id = robot.frame_id(
            config.frame if config.frame is not None else robot.tool_frame
        )
        self._axis_in_tool = np.asarray(config.insertion_axis) / np.linalg.norm(
            config.insertion_axis
        )
        self._start: NDArray[np.float64] | None = None
        self._axis = self._axis_in_tool

    def __call__(self, q_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the travel in further rows.

        Args:
            q_rad: Joint positions [rad], shape (n, joints).

        Returns:
            Travel since the first sound row [m], shape (n,), NaN where positions are not finite.
        """
        positions = np.full((len(q_rad), 3), np.nan)
        for k in np.flatnonzero(np.isfinite(q_rad).all(axis=1)).tolist():
            pin.forwardKinematics(self._model, self._data, q_rad[k])
            placement = pin.updateFramePlacement(self._model, self._data, self._frame_id)
            positions[k] = placement.translation
            if self._start is None:
                self._start = placement.translation.copy()
                self._axis = placement.rotation @ self._axis_in_tool
        if self._start is None:
            return positions[:, 0]
        # Not a matrix product, whose rounding may depend on how many rows come at a time.
        x, y, z = (positions - self._start).T * self._axis[:, None]
        return 0.0 + x + y + z
