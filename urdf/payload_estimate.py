"""What a payload identification returns: the payload, and how far to believe it."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from urdf.finite_array import read_only
from urdf.payload import Payload


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PayloadEstimate:
    """An identified payload with its uncertainty. Arrays are read-only copies.

    The ten parameters are in Pinocchio's order (m, m c, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz),
    inertia about the flange's origin, in flange axes.

    Attributes:
        payload: The physically consistent payload, in the flange frame.
        covariance: Covariance of the ten parameters before the consistency constraint, shape (10,
            10); infinite variance for what the data do not determine.
        rank: Number of parameter combinations the data determine.
        parameter_count: Number of parameters asked for: ten from motion, four at rest.
        unconstrained_parameters: Least-squares answer before the consistency constraint, shape
            (10,); zero for what was not asked for.
        is_constrained: True if that answer was no rigid body and had to be moved to the nearest
            one. Far away (by many standard deviations) it means a wrong sign, frame, torque scale
            or robot model.
        offsets_Nm: Constant torque per joint fitted along with it, zero if not asked for, shape
            (nv,), Nm.
        offsets_std_Nm: Standard deviation of the offsets, shape (nv,), Nm.
        residual_rms_Nm: Torque the estimate leaves unexplained, per joint, shape (nv,), Nm.
    """

    payload: Payload
    covariance: NDArray[np.float64]
    rank: int
    parameter_count: int
    unconstrained_parameters: NDArray[np.float64]
    is_constrained: bool
    offsets_Nm: NDArray[np.float64]
    offsets_std_Nm: NDArray[np.float64]
    residual_rms_Nm: NDArray[np.float64]

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                object.__setattr__(self, item.name, read_only(value))

    @property
    def is_identified(self) -> bool:
        """Whether the data determine every parameter that was asked for."""
        return self.rank == self.parameter_count

    @property
    def standard_deviations(self) -> NDArray[np.float64]:
        """Standard deviations of the ten parameters, shape (10,), kg, kg m, kg m^2."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def mass_std_kg(self) -> float:
        """Standard deviation of the mass, kg."""
        return float(self.standard_deviations[0])

    @property
    def com_std_m(self) -> NDArray[np.float64]:
        """Standard deviation of the centre of mass to first order, shape (3,), m."""
        block = self.covariance[:4, :4]
        if self.payload.mass_kg == 0.0 or not np.isfinite(block).all():
            return np.full(3, np.inf)
        slope = np.column_stack([-self.payload.com_m, np.eye(3)]) / self.payload.mass_kg
        return np.sqrt(np.diag(slope @ block @ slope.T))
