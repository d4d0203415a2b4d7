"""Drive the simulated arm along a motion and write down what is true at each tick."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundtruth.arm_plant import ArmPlant
from groundtruth.errors import PlantError
from groundtruth.joint_controller import joint_torque
from groundtruth.joint_reference import MASS_TICKS, JointReference
from groundtruth.tissue_force import TissueForce

Array = NDArray[np.float64]

_REPORT_TICKS = 500
_MAX_POSITION_ERROR_rad = 0.02


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmTrace:
    """True signals of n ticks of an arm with m joints; row k belongs to the tick's start.

    Attributes:
        q_rad: Joint positions, shape (n, m).
        dq_rad_s: Joint velocities, shape (n, m).
        tau_Nm: Joint torques held over the tick, shape (n, m).
        ft_wrench: Reading of the F/T sensor, shape (n, 6), see `ArmPlant`.
        axial_jacobian: Speed of the tip along the needle per joint velocity, shape (n + 1, m).
        depth_m: Depth of the tip, shape (n,).
        mean_axial_N: Axial force of the tissue, mean over the tick, shape (n,).
        forces: The tissue's answer, n of them.
    """

    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    ft_wrench: Array
    axial_jacobian: Array
    depth_m: Array
    mean_axial_N: Array
    forces: list[TissueForce]

    @property
    def speed_m_s(self) -> Array:
        """Speed of the tip along the needle, shape (n,)."""
        return np.vecdot(self.axial_jacobian[:-1], self.dq_rad_s)

    @property
    def external_torque_Nm(self) -> Array:
        """Torque of the tissue on the joints, mean over each tick, shape (n, m)."""
        middle = 0.5 * (self.axial_jacobian[:-1] + self.axial_jacobian[1:])
        return -self.mean_axial_N[:, None] * middle


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

    Raises:
        PlantError: The arm has lost the motion.
    """
    wanted_q, wanted_dq = reference.motion.q_rad, reference.motion.dq_rad_s
    trace = _empty_trace(*reference.feed_forward_Nm.shape)
    plant.place(wanted_q[0], wanted_dq[0])
    for k, feed_forward in enumerate(reference.feed_forward_Nm):
        error = wanted_q[k] - plant.q_rad
        torque = joint_torque(
            error,
            wanted_dq[k] - plant.dq_rad_s,
            reference.mass_matrix[k // MASS_TICKS],
            feed_forward,
        )
        if k % _REPORT_TICKS == 0:
            _check(error, k)
            if progress is not None:
                progress(k / len(reference.feed_forward_Nm))
        trace.q_rad[k], trace.dq_rad_s[k], trace.tau_Nm[k] = plant.q_rad, plant.dq_rad_s, torque
        trace.axial_jacobian[k], trace.depth_m[k] = plant.axial_jacobian, plant.depth_m
        plant.tick(torque)
        trace.ft_wrench[k], trace.mean_axial_N[k] = plant.ft_wrench, plant.mean_axial_N
        trace.forces.append(plant.tissue_force)
    trace.axial_jacobian[-1] = plant.axial_jacobian
    if progress is not None:
        progress(1.0)
    return trace


def _empty_trace(ticks: int, joints: int) -> ArmTrace:
    return ArmTrace(
        q_rad=np.empty((ticks, joints)),
        dq_rad_s=np.empty((ticks, joints)),
        tau_Nm=np.empty((ticks, joints)),
        ft_wrench=np.empty((ticks, 6)),
        axial_jacobian=np.empty((ticks + 1, joints)),
        depth_m=np.empty(ticks),
        mean_axial_N=np.empty(ticks),
        forces=[],
    )


def _check(error_rad: Array, tick: int) -> None:
    worst = np.abs(error_rad).max()
    if not worst < _MAX_POSITION_ERROR_rad:
        raise PlantError(
            f"a joint is {worst:.3g} rad off its motion at tick {tick}, expected less than "
            f"{_MAX_POSITION_ERROR_rad}; use softer tissue or a slower motion"
        )
