"""Drive the simulated arm along a motion and write down everything, without any sensor's faults."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundtruth.arm_plant import ArmPlant
from groundtruth.errors import PlantError
from groundtruth.joint_controller import joint_torque
from groundtruth.joint_reference import MASS_TICKS, JointReference

Array = NDArray[np.float64]

_REPORT_TICKS = 500
_MAX_POSITION_ERROR_rad = 0.02


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmTrace:
    """True signals at each tick, n rows; row k belongs to the instant t_k = k dt."""

    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    """Joint torque held from t_k to t_k+1, shape (n, 7)."""
    ft_wrench: Array
    """Shape (n, 6), see `ArmPlant`."""
    depth_m: Array
    speed_m_s: Array
    axial_N: Array
    tip_N: Array
    friction_N: Array
    layer: NDArray[np.int64]
    external_torque_Nm: Array
    """Torque of the tissue on the joints, mean from t_k to t_k+1, shape (n, 7)."""


def drive(
    plant: ArmPlant,
    reference: JointReference,
    progress: Callable[[float], None] | None = None,
) -> ArmTrace:
    """Let the controller follow the motion from its first sample on.

    Args:
        plant: The arm; it is placed at the start of the motion.
        reference: The motion, n ticks.
        progress: Called with the share done, 0 to 1.

    Returns:
        n rows.

    Raises:
        PlantError: The arm has lost the motion.
    """
    motion, feed_forward = reference.motion, reference.feed_forward_Nm
    ticks, joints = feed_forward.shape
    q, dq, tau = (np.empty((ticks, joints)) for _ in range(3))
    jacobian = np.empty((ticks + 1, joints))
    ft = np.empty((ticks, 6))
    scalar = np.empty((ticks, 5))
    layer = np.empty(ticks, dtype=np.int64)
    plant.place(motion.q_rad[0], motion.dq_rad_s[0])
    for k in range(ticks):
        q[k], dq[k], jacobian[k] = plant.q_rad, plant.dq_rad_s, plant.axial_jacobian
        error = motion.q_rad[k] - q[k]
        tau[k] = torque = joint_torque(
            error,
            motion.dq_rad_s[k] - dq[k],
            reference.mass_matrix[k // MASS_TICKS],
            feed_forward[k],
        )
        depth = plant.depth_m
        plant.tick(torque)
        ft[k] = plant.ft_wrench
        force = plant.tissue_force
        scalar[k] = depth, force.axial_N, force.tip_N, force.friction_N, plant.mean_axial_N
        layer[k] = force.layer
        if k % _REPORT_TICKS == 0:
            _check(error, k)
            if progress is not None:
                progress(k / ticks)
    jacobian[ticks] = plant.axial_jacobian
    if progress is not None:
        progress(1.0)
    mean_jacobian = 0.5 * (jacobian[:-1] + jacobian[1:])
    return ArmTrace(
        q_rad=q,
        dq_rad_s=dq,
        tau_Nm=tau,
        ft_wrench=ft,
        depth_m=scalar[:, 0],
        speed_m_s=np.vecdot(jacobian[:-1], dq),
        axial_N=scalar[:, 1],
        tip_N=scalar[:, 2],
        friction_N=scalar[:, 3],
        layer=layer,
        external_torque_Nm=-scalar[:, 4, None] * mean_jacobian,
    )


def _check(error: Array, tick: int) -> None:
    worst = np.abs(error).max()
    if not worst < _MAX_POSITION_ERROR_rad:
        raise PlantError(
            f"a joint is {worst:.3g} rad off its motion at tick {tick}; the tissue is too stiff or the "
            "motion too fast for the arm's controller"
        )
