"""The physics of arm, needle and tissue, one controller tick at a time, in MuJoCo."""

# MuJoCo's names live in a compiled module without stubs.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from groundtruth.errors import PlantError
from groundtruth.plant_model import PlantModel, TICK_s, drawn_factors
from groundtruth.rig_contacts import Contact, TouchedPoint
from groundtruth.scenarios import ElbowPush, LateralForce, Scenario, TissueMotion
from groundtruth.tissue import Tissue, TissueForce, no_force
from urdf import NeedleTool, Payload, Robot, load_lwr

try:
    import mujoco
except ModuleNotFoundError:  # The needle without an arm does not need it.
    mujoco = None


SUBSTEPS = 4
"""Physics steps per tick. Runge-Kutta steps of fourth order close the momentum balance
of a moving arm to 7e-7 Nm at any number of them (semi-implicit Euler: 6e-4 Nm with
four), so the number is set by the tissue: four per tick follow the release of a
rupture."""
SUBSTEP_s = TICK_s / SUBSTEPS


# The second link table of the LWR 4+: the end point of the plant's model error, so that
# no estimator is evaluated on an arm that has exactly its own numbers (the nominal
# table of the ``urdf`` package is a fit to KUKA's own interface data).
#
# Read in two public LWR 4 simulators (a course work of Sapienza, models of the KUKA_LWR
# MATLAB simulator); believed to stem from CoppeliaSim's LBR4p.
# Per link: mass [kg]; centre of mass in the joint frame [m]; Ixx, Iyy, Izz, Ixy, Ixz,
# Iyz about the centre of mass [kg m^2].
_CAD_TABLE = (
    (
        2.7,
        (0.00134, 0.02622, 0.11222),
        (0.016341, 0.016172, 0.005026, 1e-6, 3e-6, -0.003533),
    ),
    (
        2.7,
        (0.00134, -0.02622, 0.08778),
        (0.016341, 0.016172, 0.005026, -1e-6, 3e-6, 0.003533),
    ),
    (
        2.7,
        (-0.00134, -0.02622, 0.11222),
        (0.016341, 0.016192, 0.005026, -1e-6, 3e-6, 0.003533),
    ),
    (
        2.7,
        (-0.00134, 0.02622, 0.08778),
        (0.016341, 0.016192, 0.005026, -1e-6, -3e-6, -0.003533),
    ),
    (
        1.7,
        (-0.00099, 0.02696, 0.07835),
        (0.009573, 0.008807, 0.003708, -1e-6, -1e-6, -0.003094),
    ),
    (
        1.6,
        (-0.00026, -0.00596, -0.00533),
        (0.002898, 0.003022, 0.003413, 0.0, 0.0, -1.9e-5),
    ),
    (
        0.3,
        (0.0, 0.0, -0.015),
        (0.000101, 0.000101, 0.000158, 0.0, 0.0, 0.0),
    ),
)


def blended_links(nominal: pin.Model, cad_fraction: float) -> tuple[pin.Inertia, ...]:
    """Return the links of the bare LWR 4+, blended with those of the CAD table.

        phi = (1 - a) phi_nominal + a phi_CAD

    Physically consistent 10-vectors form a convex set: a blend of two consistent links
    is one. Links 1 to 7, each in its joint frame.
    """
    links = []
    for joint, (mass_kg, com_m, inertia) in enumerate(_CAD_TABLE, start=1):
        ixx, iyy, izz, ixy, ixz, iyz = inertia
        about_com = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        cad = pin.Inertia(mass_kg, np.array(com_m), about_com).toDynamicParameters()
        believed = nominal.inertias[joint].toDynamicParameters()
        blend = (1.0 - cad_fraction) * believed + cad_fraction * cad
        links.append(pin.Inertia.FromDynamicParameters(blend))
    return tuple(links)


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantBodies:
    """Kinematics and true inertias of arm, F/T sensor and needle.

    Attributes:
        robot: The estimator's model.
        kinematics: The same with the true positions of its joints; its inertias are not
            used.
        links: Bare links 1 to 7, each in its joint frame.
        sensor: The tool up to the sensor's measuring plane, in the flange frame.
        needle: Everything beyond the measuring plane, in the ``ft_sensor`` frame.
    """

    robot: Robot
    kinematics: Robot
    links: tuple[pin.Inertia, ...]
    sensor: pin.Inertia
    needle: pin.Inertia

    def model(self) -> pin.Model:
        """Return the Pinocchio model of the true arm, with all its true inertias."""
        model = self.kinematics.model.copy()
        for joint, link in enumerate(self.links, start=1):
            model.inertias[joint] = link
        model.inertias[len(self.links)] = (
            self.links[-1]
            + _placement(self.robot, self.robot.flange_frame).act(self.sensor)
            + _placement(self.robot, "ft_sensor").act(self.needle)
        )
        return model


def lwr_bodies(
    tool: NeedleTool, plant_model: PlantModel, rng: np.random.Generator
) -> PlantBodies:
    """Draw the true LWR 4+ and needle.

    They are the estimator's but for the plant model's errors of payload and kinematics.
    """
    robot = kinematics = load_lwr(payload=tool)
    mass_factor = 1.0 + plant_model.payload_error * rng.choice((-1.0, 1.0))
    com_shift_m = plant_model.payload_com_spread_m * rng.standard_normal(3)
    size_m = plant_model.kinematic_error_m
    size_rad = plant_model.kinematic_error_rad
    if size_m or size_rad:
        displaced = pin.Model(robot.bare_model)
        for joint in range(1, displaced.njoints):
            turn = pin.exp3(size_rad * rng.standard_normal(3))
            displaced.jointPlacements[joint] *= pin.SE3(
                turn, size_m * rng.standard_normal(3)
            )
        kinematics = replace(robot, bare_model=displaced)

    def with_error(part: Payload) -> pin.Inertia:
        inertia_kg_m2 = part.inertia_kg_m2 * mass_factor
        return pin.Inertia(
            part.mass_kg * mass_factor, part.com_m + com_shift_m, inertia_kg_m2
        )

    return PlantBodies(
        robot=robot,
        kinematics=kinematics,
        links=blended_links(robot.bare_model, plant_model.cad_fraction),
        sensor=with_error(tool.sensor),
        needle=with_error(tool.beyond_sensor),
    )


def _placement(robot: Robot, frame: str) -> pin.SE3:
    return robot.model.frames[robot.frame_id(frame)].placement


def arm_model(bodies: PlantBodies, substep_s: float) -> Any:
    """Build the MuJoCo model of the arm: truth and estimator share no dynamics code.

    Bodies: one per joint; ``sensor``, rigid on the flange; ``needle``, all that lies
    beyond the F/T sensor's measuring plane; and the massless ``tip``, so that a force
    on it acts at the needle's tip. No geometry, contacts, joint limits, damping,
    armature or friction: the torque of a joint is the link-side torque its sensor
    reads. Friction of the bearings, which no sensor reads, is added by `ArmPlant`.

    The force and torque sensors sit at the ``ft_sensor`` frame and report, in its axes,
    what the arm exerts on the needle body: everything beyond the measuring plane.
    """
    robot = bodies.kinematics
    spec = mujoco.MjSpec()
    without = mujoco.mjtDisableBit
    spec.option.timestep = substep_s
    spec.option.gravity = robot.gravity_m_s2
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    spec.option.disableflags = without.mjDSBL_CONSTRAINT | without.mjDSBL_CONTACT
    model = robot.model
    data = robot.create_data()
    body = spec.worldbody
    pin.computeJointJacobians(model, data, pin.neutral(model))
    for joint, (name, link) in enumerate(
        zip(robot.joint_names, bodies.links, strict=True), 1
    ):
        body = _add_body(body, f"link_{joint}", model.jointPlacements[joint], link)
        local = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
        body.add_joint(name=name, axis=local[3:, model.joints[joint].idx_v])
    sensor = _placement(robot, "ft_sensor")
    _add_body(body, "sensor", _placement(robot, robot.flange_frame), bodies.sensor)
    needle = _add_body(body, "needle", sensor, bodies.needle)
    needle.add_site(name="ft_sensor")
    tip = _add_body(needle, "tip", sensor.actInv(_placement(robot, "needle_tip")), None)
    tip.add_site(name="tip")
    for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
        spec.add_sensor(
            type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="ft_sensor"
        )
    return spec.compile()


def _add_body(
    parent: Any, name: str, placement: pin.SE3, inertia: pin.Inertia | None
) -> Any:
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs()
    body = parent.add_body(name=name, pos=placement.translation, quat=(w, x, y, z))
    if inertia is not None:
        body.mass = inertia.mass
        body.ipos = inertia.lever
        body.explicitinertial = True
        body.fullinertia = inertia.inertia[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]
    return body


STRIBECK_PEAK = 1.5
"""Friction at the onset of sliding over that of fast sliding. Chosen; with it one
Coulomb level meets both errors published for the real arm."""
STRIBECK_SPEED_rad_s = 0.05
"""Speed over which the peak falls off. Chosen between the joint speeds of an insertion
(0.005 rad/s) and of the tare stroke (0.1 rad/s): the stroke in air shows less friction
than the insertion meets."""
PRESLIDING_rad = 1e-4
"""Rotation until a bearing slides. Chosen: 5 um at a radius of 50 mm."""


def bearings(
    plant_model: PlantModel, limit_Nm: Array, rng: np.random.Generator
) -> "BearingFriction | None":
    """Return the bearings of an arm; None without friction.

    Args:
        plant_model: States the friction.
        limit_Nm: Effort limits of the joints, shape (n,).
        rng: Draws the bearings.
    """
    if plant_model.joint_coulomb == 0.0 and not any(
        plant_model.joint_viscous_Nms_per_rad
    ):
        return None
    return BearingFriction(plant_model, limit_Nm, rng)


class BearingFriction:
    """Friction torque of all joint bearings, one physics step at a time.

    It begins at rest without load.

    The sensor sits between gear and link; the bearing that carries the link runs beside
    it, from link to link, so its friction does not pass through the sensor:

        sensor torque + tissue torque + friction torque = M ddq + C dq + g.

    It is against the joint's motion. A momentum observer takes it for an external
    torque: while a needle goes in it looks like tissue that pushes back, and it changes
    sign in withdrawal. An insertion turns the joints by 5 mrad/s and ends in rest, so
    standstill decides. MuJoCo's ``frictionloss`` creeps under load and has no Stribeck
    peak; the bristle of the LuGre model (Canudas de Wit et al. 1995) holds a joint at
    rest elastically, for ever, up to the peak.
    """

    def __init__(
        self, plant_model: PlantModel, limit_Nm: Array, rng: np.random.Generator
    ) -> None:
        """Draw the bearings of an arm with these effort limits, shape (n,)."""
        factors = drawn_factors(plant_model, limit_Nm.shape, rng)
        coulomb_Nm = factors * plant_model.joint_coulomb * limit_Nm
        viscous_Nms = factors * np.array(plant_model.joint_viscous_Nms_per_rad)
        self._levels = [*zip(coulomb_Nm.tolist(), viscous_Nms.tolist(), strict=True)]
        self._bristles = [0.0] * len(limit_Nm)  # in units of the Coulomb level

    def step(self, dq_rad_s: Array, dt_s: float) -> Array:
        """Advance at a held speed and return the torque on the links, shape (n,), Nm.

        The step is exact:

            w' = s + (w - s) exp(-|dq| dt / (PRESLIDING_rad g)),  s = g sign(dq),
            g = 1 + (STRIBECK_PEAK - 1) exp(-(dq / STRIBECK_SPEED_rad_s)^2),
            torque = -coulomb w' - viscous dq.
        """
        torque_Nm = np.empty(len(dq_rad_s))
        joints = zip(dq_rad_s.tolist(), self._levels, strict=True)
        # Numbers one by one: faster than arrays of seven.
        for i, (dq, (coulomb_Nm, viscous_Nms)) in enumerate(joints):
            stribeck = math.exp(-((dq / STRIBECK_SPEED_rad_s) ** 2))
            level = 1.0 + (STRIBECK_PEAK - 1.0) * stribeck
            sliding = math.copysign(level, dq)
            remaining = math.exp(-abs(dq) * dt_s / (PRESLIDING_rad * level))
            bristle = sliding + (self._bristles[i] - sliding) * remaining
            self._bristles[i] = bristle
            torque_Nm[i] = -coulomb_Nm * bristle - viscous_Nms * dq
        return torque_Nm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TissueContact:
    """Contact of the arm with tissue in front of the needle, and with a hand.

    Attributes:
        law: The tissue; one without layers is free air.
        surface_in_base_m: Point of the surface that the tip meets, shape (3,).
        axis_in_base: Direction of insertion along which depth is measured, shape (3,).
        motion: Motion of the surface along that direction.
        lateral: Force of the tissue across the needle.
        elbow: Pushes of a hand on the elbow.
    """

    law: Tissue
    surface_in_base_m: Array
    axis_in_base: Array
    motion: TissueMotion | None = None
    lateral: LateralForce | None = None
    elbow: ElbowPush | None = None


def tissue_before(
    needle: pin.SE3, distance_m: float, scenario: Scenario
) -> TissueContact:
    """Return a scenario's tissue in front of a needle, along its z axis.

    Args:
        needle: Placement of the needle's tip in the base.
        distance_m: From the tip to the surface.
        scenario: Has the layers, the motion of the tissue and the forces aside.
    """
    axis = needle.rotation[:, 2].copy()
    return TissueContact(
        law=Tissue(scenario.layers),
        surface_in_base_m=needle.translation + distance_m * axis,
        axis_in_base=axis,
        motion=scenario.tissue_motion,
        lateral=scenario.lateral,
        elbow=scenario.elbow,
    )


class ArmPlant:
    """MuJoCo arm with a needle, driven by joint torques held over each tick.

    Attributes:
        q_rad: Present joint positions, shape (7,), a view.
        dq_rad_s: Present joint velocities, shape (7,), a view.
        tip_m: Present position of the needle's tip, base axes, a view.
        tip_axes: Axes of the needle in base axes, shape (3, 3), a view; the third
            points along it.
        axial_jacobian: Speed of the tip along the needle per joint velocity, shape
            (7,).
        depth_m: Depth of the tip below the surface; zero without tissue.
        ft_wrench: Reading of the F/T sensor at the start of the last tick: force and
            torque of the environment on the needle, plus weight, minus inertia, in
            ``ft_sensor`` axes, N and Nm.
        tissue_force: Force of the tissue at the start of the last tick.
        mean_axial_N: Its axial force, mean over that tick.
        friction_Nm: Torque of the bearings on the links, mean over that tick, shape
            (7,).
    """

    def __init__(
        self,
        bodies: PlantBodies,
        contact: TissueContact,
        friction: BearingFriction | None = None,
        touching: Sequence[Contact] = (),
    ) -> None:
        """Compile the true arm, with its contacts; `PlantError` without MuJoCo.

        Args:
            bodies: Kinematics and true inertias.
            contact: The tissue.
            friction: Of the bearings; None for none.
            touching: Contacts besides the tissue.
        """
        if mujoco is None:
            raise PlantError(
                "the simulated arm needs mujoco, which is not installed",
                "Install it: pip install 'needleforce[demo]'.",
            )
        self._model = arm_model(bodies, SUBSTEP_s)
        self._data = mujoco.MjData(self._model)
        self._contact = contact
        self._friction = friction
        self._tip = self._model.body("tip").id
        self._tip_force: Array = self._data.xfrc_applied[self._tip, :3]
        self.tip_axes: Array = self._data.xmat[self._tip].reshape(3, 3)
        self._tip_axis: Array = self.tip_axes[:, 2]
        self._elbow_force: Array = self._data.xfrc_applied[
            self._model.body("link_4").id, :3
        ]
        self.tip_m: Array = self._data.xpos[self._tip]
        self._jacobian = np.zeros((3, self._model.nv))
        self.q_rad: Array = self._data.qpos
        self.dq_rad_s: Array = self._data.qvel
        self.ft_wrench = np.zeros(6)
        self.tissue_force: TissueForce = no_force(len(contact.law.layers))
        self.mean_axial_N = 0.0
        self.friction_Nm = np.zeros(self._model.nv)
        self._held_Nm = np.zeros(self._model.nv)
        self._time_s = 0.0
        self._surface_m_s = 0.0
        self._touched = [
            TouchedPoint(
                self._model, self._data, [item for item in touching if item.at == place]
            )
            for place in dict.fromkeys(item.at for item in touching)
        ]
        self._locate()

    def place(self, q_rad: Array, dq_rad_s: Array) -> None:
        """Put the arm into a state, shape (7,) each.

        All contacts but the tissue begin there.
        """
        self.q_rad[:] = q_rad
        self.dq_rad_s[:] = dq_rad_s
        self._locate()
        for point in self._touched:
            point.begin()

    def tick(self, torque_Nm: Array) -> None:
        """Hold a joint torque, shape (7,), for one tick.

        The tissue acts at each substep, along the needle and held over the substep. The
        Jacobian of the tick's start serves all its substeps: the arm turns by less than
        1e-4 rad meanwhile.
        """
        if self._contact.elbow is not None:
            self._elbow_force[:] = self._contact.elbow.at(self._time_s)
        self._held_Nm = self._data.qfrc_applied[:] = torque_Nm
        self.friction_Nm = np.zeros(self._model.nv)
        law = self._contact.law
        rate = self.axial_jacobian
        back = -self._tip_axis
        aside: Array | float = 0.0
        if self._contact.lateral is not None:
            aside = self.tip_axes[:, :2] @ self._contact.lateral.at(self.depth_m)
        away = self._surface_m_s
        depth = self.depth_m
        speed = float(rate.dot(self.dq_rad_s)) - away
        force = self.tissue_force = law.step(depth, speed, SUBSTEP_s)
        total = force.axial_N
        self._tip_force[:] = total * back + aside
        self._step()
        # MuJoCo evaluates its sensors at the state the step starts from, and reports
        # what the arm exerts on the needle; the reading is what the needle exerts on
        # the arm.
        np.negative(self._data.sensordata, out=self.ft_wrench)
        for _ in range(SUBSTEPS - 1):
            speed_before = speed
            speed = float(rate.dot(self.dq_rad_s)) - away
            depth += 0.5 * SUBSTEP_s * (speed_before + speed)
            axial = law.step(depth, speed, SUBSTEP_s).axial_N
            total += axial
            self._tip_force[:] = axial * back + aside
            self._step()
        self.mean_axial_N = total / SUBSTEPS
        self._time_s += TICK_s
        self._locate()

    def _step(self) -> None:
        """Step once, with contacts and the bearings' friction held over the step."""
        for point in self._touched:
            point.act(self._time_s, self.dq_rad_s, SUBSTEP_s)
        if self._friction is not None:
            friction = self._friction.step(self.dq_rad_s, SUBSTEP_s)
            self._data.qfrc_applied[:] = self._held_Nm + friction
            self.friction_Nm += friction / SUBSTEPS
        mujoco.mj_step(self._model, self._data)

    def _locate(self) -> None:
        """Update the tip's position and Jacobian.

        A Runge-Kutta step leaves them at one of its stages.
        """
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jac(
            self._model, self._data, self._jacobian, None, self.tip_m, self._tip
        )
        self.axial_jacobian = self._tip_axis @ self._jacobian
        from_surface = self.tip_m - self._contact.surface_in_base_m
        depth = float(from_surface.dot(self._contact.axis_in_base))
        if self._contact.motion is not None:
            moved_m, self._surface_m_s = map(
                float, self._contact.motion.at(self._time_s)
            )
            depth -= moved_m
        self.depth_m = 0.0 if self._contact.law.is_air else depth
        for point in self._touched:
            point.locate()
