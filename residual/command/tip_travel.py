"""How far the tool has travelled along the needle, for force over depth."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from residual.sensor_config import SensorConfig
from urdf import Robot


def tip_travel_m(
    robot: Robot, config: SensorConfig, q_rad: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Travel along the insertion axis as it stood in the first sound row.

    Args:
        robot: The arm.
        config: Names frame and insertion axis.
        q_rad: Joint positions [rad], shape (n, joints).

    Returns:
        Travel since the first sound row [m], shape (n,), NaN where positions are not finite.
    """
    frame_id = robot.frame_id(config.frame if config.frame is not None else robot.tool_frame)
    axis_in_tool = np.asarray(config.insertion_axis) / np.linalg.norm(config.insertion_axis)
    data = robot.create_data()
    positions = np.full((len(q_rad), 3), np.nan)
    start = axis = None
    for k in np.flatnonzero(np.isfinite(q_rad).all(axis=1)):
        pin.forwardKinematics(robot.model, data, q_rad[k])
        placement = pin.updateFramePlacement(robot.model, data, frame_id)
        positions[k] = placement.translation
        if axis is None:
            axis, start = placement.rotation @ axis_in_tool, placement.translation.copy()
    if start is None or axis is None:
        return positions[:, 0]
    return (positions - start) @ axis
