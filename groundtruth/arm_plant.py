"""The physics of arm, needle and tissue, one controller tick at a time."""

# MuJoCo's names live in a compiled module without stubs.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundtruth.errors import PlantError
from groundtruth.mjcf import arm_mjcf
from groundtruth.plant_bodies import PlantBodies
from groundtruth.tissue_force import TissueForce, TissueLaw, no_force

try:
    import mujoco
except ModuleNotFoundError:  # The needle without an arm does not need it.
    mujoco = None

Array = NDArray[np.float64]

TICK_s = 1e-3
"""Period of controller and sensors."""

SUBSTEPS = 4
"""Physics steps per tick. Runge-Kutta steps of fourth order close the momentum balance of a moving
arm to 7e-7 Nm at any number of them (semi-implicit Euler: 6e-4 Nm with four), so the number is set
by the tissue: four per tick follow the release of a rupture."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TissueContact:
    """Tissue in front of the needle.

    Attributes:
        law: The tissue; one without layers is free air.
        surface_in_base_m: Point of the surface that the tip meets, shape (3,).
        axis_in_base: Direction of insertion along which depth is measured, shape (3,).
    """

    law: TissueLaw
    surface_in_base_m: Array
    axis_in_base: Array


class ArmPlant:
    """MuJoCo arm with a needle, driven by joint torques held over each tick.

    Attributes:
        q_rad: Joint positions now, shape (7,), a view.
        dq_rad_s: Joint velocities now, shape (7,), a view.
        axial_jacobian: Speed of the tip along the needle per joint velocity, shape (7,), now.
        depth_m: Travel of the tip below the surface, now; zero where there is no tissue.
        ft_wrench: Reading of the F/T sensor at the start of the last tick, shape (6,), a view:
            force (N) and torque (Nm) of the environment on the needle, plus weight, minus
            inertia, in ``ft_sensor`` axes.
        tissue_force: Force of the tissue at the start of the last tick.
        mean_axial_N: Its axial part, mean over the last tick.
    """

    def __init__(
        self, bodies: PlantBodies, contact: TissueContact, *, substeps: int = SUBSTEPS
    ) -> None:
        """Compile the model.

        Args:
            bodies: The true arm.
            contact: The tissue.
            substeps: Physics steps per tick.

        Raises:
            PlantError: MuJoCo is not installed.
        """
        if mujoco is None:
            raise PlantError(
                "the simulated arm needs the library mujoco: pip install 'needleforce[sim]'"
            )
        self._substep_s = TICK_s / substeps
        self._repeats = range(substeps - 1)
        self._model = mujoco.MjModel.from_xml_string(arm_mjcf(bodies, self._substep_s))
        self._data = mujoco.MjData(self._model)
        self._contact = contact
        self._has_tissue = bool(contact.law.layers)
        self._tip = self._model.body("tip").id
        self._tip_force: Array = self._data.xfrc_applied[self._tip, :3]
        self._tip_axis: Array = self._data.xmat[self._tip].reshape(3, 3)[:, 2]
        self._tip_position: Array = self._data.xpos[self._tip]
        self._jacobian = np.zeros((3, self._model.nv))
        self.q_rad: Array = self._data.qpos
        self.dq_rad_s: Array = self._data.qvel
        self.ft_wrench = np.zeros(6)
        self.tissue_force: TissueForce = no_force(len(contact.law.layers))
        self.mean_axial_N = 0.0
        self._locate()

    def place(self, q_rad: Array, dq_rad_s: Array) -> None:
        """Put the arm into a state.

        Args:
            q_rad: Joint positions, shape (7,).
            dq_rad_s: Joint velocities, shape (7,).
        """
        self.q_rad[:] = q_rad
        self.dq_rad_s[:] = dq_rad_s
        self._locate()

    def tick(self, torque_Nm: Array) -> None:
        """Hold a joint torque for one tick.

        Args:
            torque_Nm: Shape (7,).
        """
        self._data.qfrc_applied[:] = torque_Nm
        if self._has_tissue:
            self._tissue_tick(self._contact.law)
        else:
            self._step_and_read()
            for _ in self._repeats:
                mujoco.mj_step(self._model, self._data)
        self._locate()

    def _tissue_tick(self, law: TissueLaw) -> None:
        """Let the tissue act at each substep, along the needle and held over the substep.

        The Jacobian of the tick's start serves all its substeps: the arm turns by less than
        1e-4 rad meanwhile.
        """
        step_s, rate, back = self._substep_s, self.axial_jacobian, -self._tip_axis
        depth, speed = self.depth_m, float(rate.dot(self.dq_rad_s))
        force = self.tissue_force = law.step(depth, speed, step_s)
        total = force.axial_N
        self._tip_force[:] = total * back
        self._step_and_read()
        for _ in self._repeats:
            before, speed = speed, float(rate.dot(self.dq_rad_s))
            depth += 0.5 * step_s * (before + speed)
            axial = law.step(depth, speed, step_s).axial_N
            total += axial
            self._tip_force[:] = axial * back
            mujoco.mj_step(self._model, self._data)
        self.mean_axial_N = total / (len(self._repeats) + 1)

    def _step_and_read(self) -> None:
        """Step once and read the F/T sensor.

        MuJoCo evaluates its sensors at the state the step starts from, and reports what the arm
        exerts on the needle; the reading is what the needle exerts on the arm.
        """
        mujoco.mj_step(self._model, self._data)
        np.negative(self._data.sensordata, out=self.ft_wrench)

    def _locate(self) -> None:
        """Update the tip's position and Jacobian, which a Runge-Kutta step leaves at a stage."""
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jac(self._model, self._data, self._jacobian, None, self._tip_position, self._tip)
        self.axial_jacobian = self._tip_axis @ self._jacobian
        from_surface = self._tip_position - self._contact.surface_in_base_m
        depth = float(from_surface.dot(self._contact.axis_in_base))
        self.depth_m = depth if self._has_tissue else 0.0
