"""Drive the simulated arm along a motion and record what is true at each tick.

The inner position loop is torque feed-forward and a stiff, mass-weighted PD, held over
each tick: tau = tau_ff + M (w^2 e + 2 w de). The mass matrix makes all directions of
the arm equally fast, whatever its posture. The loop reads the true joint state: it runs
inside the robot on the fine motor encoders, while the noise of a plant model belongs to
what the robot's interface reports.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from groundtruth.arm_motion import JointMotion
from groundtruth.arm_plant import ArmPlant
from groundtruth.errors import PlantError
from groundtruth.plant_model import TICK_s
from groundtruth.tissue import TissueForce

BANDWIDTH_rad_s = 200.0
"""Natural frequency of the loop, critically damped: stiff enough that the few newtons
of a rupture move the tip by less than 0.1 mm, slow against the 1 kHz tick."""

MASS_TICKS = 10
"""Ticks for which one mass matrix serves: the arm turns by 5 mrad at most meanwhile."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmTrace:
    """True signals of n ticks of an arm with m joints.

    Row k belongs to the start of tick k.

    Attributes:
        q_rad: Joint positions, shape (n, m).
        dq_rad_s: Joint velocities, shape (n, m).
        tau_Nm: Joint torques held over the tick, shape (n, m).
        ft_wrench: Reading of the F/T sensor, shape (n, 6), see `ArmPlant`.
        axial_jacobian: Speed of the tip along the needle per joint velocity, shape (n +
            1, m).
        depth_m: Depth of the tip, shape (n,).
        mean_axial_N: Force of the tissue, mean over the tick, shape (n,).
        joint_friction_Nm: Torque of the bearings on the links, mean over the tick,
            shape (n, m).
        forces: Forces of the tissue, n of them.
    """

    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    ft_wrench: Array
    axial_jacobian: Array
    depth_m: Array
    mean_axial_N: Array
    joint_friction_Nm: Array
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
    model: pin.Model,
    motion: JointMotion,
    progress: Callable[[float], None] = lambda _: None,
) -> ArmTrace:
    """Let the controller follow a motion of n ticks, and return the true signals.

    Args:
        plant: The arm; it is placed at the start of the motion.
        model: Model of the true arm, which gives the feed-forward.
        motion: Commanded joint positions and velocities.
        progress: Called with the fraction done, 0 to 1.

    Raises:
        PlantError: The arm has lost the motion.
    """
    # Between reports of the progress
    report_ticks = 500
    max_position_error_rad = 0.02
    feed_forward, mass = _dynamics_along(model, motion)
    ticks = len(feed_forward)
    rows = []
    forces = []
    plant.place(motion.q_rad[0], motion.dq_rad_s[0])
    for k, ahead in enumerate(feed_forward):
        error = motion.q_rad[k] - plant.q_rad
        slip = motion.dq_rad_s[k] - plant.dq_rad_s
        acceleration = BANDWIDTH_rad_s**2 * error + 2.0 * BANDWIDTH_rad_s * slip
        torque = ahead + mass[k // MASS_TICKS] @ acceleration
        if k % report_ticks == 0:
            if not (worst := np.abs(error).max()) < max_position_error_rad:
                raise PlantError(
                    f"a joint is {worst:.3g} rad off its motion at tick {k}, expected "
                    f"less than {max_position_error_rad}"
                )
            progress(k / ticks)
        state = (plant.q_rad.copy(), plant.dq_rad_s.copy(), torque)
        place = (plant.axial_jacobian, plant.depth_m)
        plant.tick(torque)
        felt = (plant.ft_wrench.copy(), plant.mean_axial_N, plant.friction_Nm)
        rows.append((*state, *place, *felt))
        forces.append(plant.tissue_force)
    progress(1.0)
    columns = map(np.array, zip(*rows, strict=True))
    q, dq, tau, jacobian, depth, wrench, axial, friction = columns
    return ArmTrace(
        q_rad=q,
        dq_rad_s=dq,
        tau_Nm=tau,
        axial_jacobian=np.vstack([jacobian, plant.axial_jacobian]),
        depth_m=depth,
        ft_wrench=wrench,
        mean_axial_N=axial,
        joint_friction_Nm=friction,
        forces=forces,
    )


def _dynamics_along(model: pin.Model, motion: JointMotion) -> tuple[Array, Array]:
    """Return feed-forward torques and mass matrices along a motion.

    Returns:
        Torques, shape (n, 7), and mass matrices, shape (ceil(n / MASS_TICKS), 7, 7).
    """
    # At the middle of each tick: a torque held over it sets the mean acceleration.
    q = motion.q_rad
    dq = motion.dq_rad_s
    middles = zip(
        0.5 * (q[1:] + q[:-1]),
        0.5 * (dq[1:] + dq[:-1]),
        np.diff(dq, axis=0) / TICK_s,
        strict=True,
    )
    data = model.createData()
    return (
        np.array([pin.rnea(model, data, *middle) for middle in middles]),
        np.array([pin.crba(model, data, row).copy() for row in q[:-1:MASS_TICKS]]),
    )
