"""Equation (13), weighted, for a force along the needle: one unknown, every tick."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from speedup import StridedVector, Vector, WrittenVector, compiled


class AxialWeights(NamedTuple):
    """How the axial mode weighs the joints, until it is told to weigh them anew.

    Attributes:
        weighted: W a, a the torque per newton; shape (n,).
        variance_N2: Of the axial force.
        damping_share: Share of it that damping removes.
        conditioning: See `WrenchEstimate`.
    """

    weighted: NDArray[np.float64]
    variance_N2: float
    damping_share: float
    conditioning: float


@compiled
def axial_force(
    residual: Vector,
    offset: Vector,
    weighted: Vector,
    advance: Vector,
    axis: StridedVector,
    damping: float,
    corrected: WrittenVector,
    force: WrittenVector,
) -> float:
    """Axial force from external joint torque.

    Args:
        residual: External joint torque with its offset [Nm], shape (n,).
        offset: What it reads without contact [Nm], shape (n,).
        weighted: See `AxialWeights`.
        advance: See `residual.tool_kinematics.ToolKinematics`.
        axis: Insertion direction, shape (3,).
        damping: Inverse variance of the force that is expected at most [1/N^2].
        corrected: Where the residual less its offset is written [Nm], shape (n,).
        force: Where the force on the tool is written [N], in the axes of ``axis``, shape (3,).

    Returns:
        Resistance to insertion [N]; 0 where nothing is seen.
    """
    information = float(weighted.dot(advance)) + damping
    corrected[:] = residual - offset
    along = float(weighted.dot(corrected)) / information if information > 0.0 else 0.0
    force[:] = axis * along
    return -along
