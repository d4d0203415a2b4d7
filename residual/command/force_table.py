"""The columns of the table of forces; every name carries its unit."""

import numpy as np
from numpy.typing import NDArray

from residual.command.replay import Replay
from residual.sensor_config import SensorConfig

Columns = dict[str, NDArray[np.float64] | NDArray[np.int64]]


def force_table(result: Replay, config: SensorConfig, travel_m: NDArray[np.float64]) -> Columns:
    """Return the columns in the order in which they are written.

    Args:
        result: The estimates.
        config: The sensor's settings, for mode and axes.
        travel_m: Travel of the tip [m], shape (n,).

    Returns:
        Name to values, each of shape (n,).
    """
    columns: Columns = {
        "t_s": result.t_s,
        "travel_m": travel_m,
        "axial_N": result.axial_N,
        "axial_std_N": result.axial_std_N,
    }
    columns |= _vector("force", "N", config.axes, result.force_N)
    if config.mode != "axial":
        columns |= _vector("force_std", "N", config.axes, result.std[:, :3])
    if config.mode == "full":
        columns |= _vector("torque", "Nm", config.axes, result.torque_Nm)
        columns |= _vector("torque_std", "Nm", config.axes, result.std[:, 3:])
    columns["status"] = result.status
    return columns


def _vector(name: str, unit: str, axes: str, values: NDArray[np.float64]) -> Columns:
    return {f"{name}_{xyz}_in_{axes}_{unit}": values[:, i] for i, xyz in enumerate("xyz")}
