"""Estimates of consecutive rows of a log."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from recordings.columns.force_codes import FORCE_STATUS
from residual.wrench_estimate import Status

STATUS_CODES = {Status(word): code for code, word in enumerate(FORCE_STATUS)}
"""How a status is written to a file of numbers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceRows:
    """One row per row of the log; NaN where a row was skipped.

    Attributes:
        t_s: Time stamps as in the log [s], shape (n,).
        travel_m: Travel of the tool along the needle [m], shape (n,).
        axial_N: Axial force [N], shape (n,).
        axial_std_N: Its standard deviation [N], shape (n,).
        force_N: Force on the tool [N], shape (n, 3).
        torque_Nm: Torque on the tool [Nm], shape (n, 3).
        std: Standard deviations of the estimated components, shape (n, k): k = 1 axial force,
            3 force [N], 6 force and torque [N, Nm].
        misfit: Of the joint torques to the assumed contact, see `WrenchEstimate`, shape (n,).
        cautions: Sum of the values of `Caution`, shape (n,).
        status: `STATUS_CODES`, shape (n,).
        after_gap: Whether the filters started anew because of a gap in time before the row,
            shape (n,).
    """

    t_s: NDArray[np.float64]
    travel_m: NDArray[np.float64]
    axial_N: NDArray[np.float64]
    axial_std_N: NDArray[np.float64]
    force_N: NDArray[np.float64]
    torque_Nm: NDArray[np.float64]
    std: NDArray[np.float64]
    misfit: NDArray[np.float64]
    cautions: NDArray[np.int64]
    status: NDArray[np.int64]
    after_gap: NDArray[np.bool_]

    def has_status(self, status: Status) -> NDArray[np.bool_]:
        """Return which rows have a status, shape (n,)."""
        return self.status == STATUS_CODES[status]

    def columns(self) -> dict[str, NDArray]:
        """Return the fields by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @classmethod
    def of_columns(cls, columns: Mapping[str, NDArray]) -> "ForceRows":
        """Return the rows whose `columns` these are."""
        return cls(**{item.name: columns[item.name] for item in fields(cls)})
