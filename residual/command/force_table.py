"""The columns of the table of forces; every name carries its unit."""

import numpy as np
from numpy.typing import NDArray

from residual.command.force_rows import ForceRows
from residual.sensor_config import SensorConfig

Columns = dict[str, NDArray[np.float64] | NDArray[np.int64]]


def force_table(rows: ForceRows, config: SensorConfig) -> Columns:
    """Return the columns in the order in which they are written.

    Args:
        rows: The estimates.
        config: The sensor's settings, for mode and axes.

    Returns:
        Name to values, each of shape (n,).
    """
    columns: Columns = {
        "t_s": rows.t_s,
        "travel_m": rows.travel_m,
        "axial_N": rows.axial_N,
        "axial_std_N": rows.axial_std_N,
    }
    columns |= _vector("force", "N", config.axes, rows.force_N)
    if config.mode != "axial":
        columns |= _vector("force_std", "N", config.axes, rows.std[:, :3])
    if config.mode == "full":
        columns |= _vector("torque", "Nm", config.axes, rows.torque_Nm)
        columns |= _vector("torque_std", "Nm", config.axes, rows.std[:, 3:])
    columns |= {
        "misfit": rows.misfit,
        "force_cautions": rows.cautions,
        "force_status": rows.status,
    }
    return columns


def _vector(name: str, unit: str, axes: str, values: NDArray[np.float64]) -> Columns:
    return {f"{name}_{xyz}_in_{axes}_{unit}": values[:, i] for i, xyz in enumerate("xyz")}
