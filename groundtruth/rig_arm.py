"""The simulated arm in closed loop: joint velocities in, sensor samples out.

The physics, the plant models and the sensors are those of `groundtruth.simulate`; what
is new is that the motion is not known beforehand. Commands arrive late, and the arm's
own loop integrates them and follows with the *nominal* model, as a robot does that does
not know its own errors.

A cycle: `SimulatedArm` reports positions at the cycle's start and the torques held over
the tick that now begins; the caller answers with `SimulatedArm.send`; the next sample
ends the tick.
"""

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple, Self

import numpy as np
import pinocchio as pin
import scipy.linalg
from numpy.typing import ArrayLike

from foundation.arrays import Array
from groundtruth import sensors
from groundtruth.arm_control import MASS_TICKS, BANDWIDTH_rad_s
from groundtruth.arm_motion import LWR_POSTURE_rad, needle_down
from groundtruth.arm_plant import (
    ArmPlant,
    TissueContact,
    bearings,
    lwr_bodies,
    tissue_before,
)
from groundtruth.errors import PlantError
from groundtruth.plant_model import PlantModel, TICK_s, plant_named
from groundtruth.rig_contacts import Contact, HandOnArm, distance_to_axis_m
from groundtruth.scenarios import Scenario
from groundtruth.scenarios import scenario as scenario_named
from groundtruth.tissue import Tissue, TissueForce, TissueTruth, collect_truth
from urdf import NeedleTool, Robot

Servo = Literal["stiff", "impedance"]


class ArmSample(NamedTuple):
    """Report of the arm in one cycle.

    Attributes:
        dt_s: Time since the previous sample, by the arm's stamps.
        q_rad: Joint positions, shape (7,).
        dq_rad_s: Joint velocities, shape (7,); None where the interface reports none.
        tau_Nm: Joint torques, shape (7,).
    """

    dt_s: float
    q_rad: Array
    dq_rad_s: Array | None
    tau_Nm: Array


class ArmTruth(NamedTuple):
    """True state at the last sample, as copies.

    Attributes:
        t_s: Time since the start.
        q_rad: Joint positions, shape (7,).
        dq_rad_s: Joint velocities, shape (7,).
        tau_Nm: Joint torques held over the tick that begins.
        tip_m: Position of the tip, base axes.
        rotation: Axes of the needle in base axes, shape (3, 3); the third points along
            it.
        depth_m: Depth of the tip below the surface; zero without tissue.
        speed_m_s: Speed along the needle, positive inwards.
        tissue: Force of the tissue, one tick ago.
    """

    t_s: float
    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    tip_m: Array
    rotation: Array
    depth_m: float
    speed_m_s: float
    tissue: TissueForce


class _Servo:
    """The arm's own loop: it integrates the commanded velocity and follows it.

    A commanded velocity is reached at the end of its tick, at constant acceleration.
    The torque is the inverse dynamics of that motion, of the nominal arm, plus spring
    and damper: stiff, M (w^2 e + 2 w de); impedance, K e + D de with the same K at all
    joints, reduced where a mode of (K, M) would be faster than w, critically damped
    mode by mode.
    """

    def __init__(self, robot: Robot, q_rad: Array, kind: Servo) -> None:
        if kind not in ("stiff", "impedance"):
            raise PlantError(f"no servo {kind!r}; expected 'stiff' or 'impedance'")
        self._data = robot.create_data()
        self._model = robot.model
        self._is_stiff = kind == "stiff"
        self._q_rad = q_rad.copy()
        self._dq_rad_s = np.zeros_like(q_rad)
        self._tick = 0
        self._spring = self._damper = np.zeros((len(q_rad), len(q_rad)))

    def torque(self, velocity_rad_s: Array, q_rad: Array, dq_rad_s: Array) -> Array:
        """Return the torque to hold over the next tick, Nm, shape (n,).

        Args:
            velocity_rad_s: Commanded for that tick.
            q_rad: True positions.
            dq_rad_s: True velocities.
        """
        if self._tick % MASS_TICKS == 0:
            self._refresh(q_rad)
        self._tick += 1
        start_rad_s = self._dq_rad_s
        step = velocity_rad_s - start_rad_s
        mean = start_rad_s + 0.5 * step
        ahead = pin.rnea(
            self._model,
            self._data,
            self._q_rad + (0.5 * TICK_s) * mean,
            mean,
            step / TICK_s,
        )
        torque = (
            ahead
            + self._spring @ (self._q_rad - q_rad)
            + self._damper @ (start_rad_s - dq_rad_s)
        )
        self._q_rad = self._q_rad + TICK_s * mean
        self._dq_rad_s = start_rad_s + step
        return torque

    def _refresh(self, q_rad: Array) -> None:
        """Compute spring and damper for a posture."""
        # Stiffness of the impedance servo, per rad: the most that the real arm's joint
        # impedance mode takes.
        joint_stiffness_Nm = 2000.0
        mass = pin.crba(self._model, self._data, q_rad).copy()
        if self._is_stiff:
            self._spring = BANDWIDTH_rad_s**2 * mass
            self._damper = 2.0 * BANDWIDTH_rad_s * mass
            return
        square, modes = scipy.linalg.eigh(joint_stiffness_Nm * np.eye(len(mass)), mass)
        capped = np.minimum(square, BANDWIDTH_rad_s**2)
        dual = mass @ modes
        self._spring = (dual * capped) @ dual.T
        self._damper = (dual * (2.0 * np.sqrt(capped))) @ dual.T


class _Commands:
    """The line from the controller to the arm's loop, one command a tick."""

    def __init__(self, joints: int, latency_s: float) -> None:
        ticks = round(latency_s / TICK_s)
        # What is sent during a tick can at the earliest act in the next one.
        if ticks < 1:
            raise PlantError(
                f"latency_s is {latency_s!r}; expected at least a tick, {TICK_s} s"
            )
        self._line: deque[Array | None] = deque([None] * ticks)
        self._velocity_rad_s = np.zeros(joints)
        self._silent_ticks = 0
        self.new: Array | None = None

    def next_rad_s(self) -> Array:
        """Return the velocity for the tick that begins."""
        # Time for which the arm goes on at its last velocity when commands stay away;
        # then it brakes. Chosen, nothing public says what an LWR does; a Panda stops
        # after 20 missed cycles of 1 ms (Polymetis, troubleshooting:
        # `communication_constraints_violation`).
        command_hold_s = 5e-3
        # Deceleration with which it then brakes. Chosen, too.
        braking_rad_s2 = 10.0
        arrived = self._line.popleft()
        self._silent_ticks = 0 if arrived is not None else self._silent_ticks + 1
        if arrived is not None:
            self._velocity_rad_s = arrived
        elif self._silent_ticks * TICK_s > command_hold_s:
            step_rad_s = braking_rad_s2 * TICK_s
            self._velocity_rad_s = self._velocity_rad_s - np.clip(
                self._velocity_rad_s, -step_rad_s, step_rad_s
            )
        return self._velocity_rad_s

    def end_tick(self) -> None:
        """Put the command that has come during the tick on the line."""
        self._line.append(self.new)
        self.new = None


class _OnlineSensors:
    """The sensors of `groundtruth.sensors`, sample by sample.

    The same seed gives the same errors.
    """

    def __init__(
        self,
        plant_model: PlantModel,
        limit_Nm: Array,
        ticks: int,
        seed: np.random.SeedSequence,
    ) -> None:
        clock, loss, position, velocity, torque, wrench = map(
            np.random.default_rng, seed.spawn(6)
        )
        self._plant_model = plant_model
        self._position = position
        self._velocity = velocity
        self._torque = sensors.TorqueSensor(
            (ticks, len(limit_Nm)), limit_Nm, plant_model, torque
        )
        self._lagging_Nm: Array | None = None
        self._wrench_error = sensors.measured_wrench(
            np.zeros((ticks, 6)), plant_model, wrench
        )
        time_s = np.arange(ticks, dtype=np.float64) * TICK_s
        self._stamp_s = sensors.time_stamps(time_s, plant_model, clock)
        self._is_received = np.zeros(ticks, dtype=bool)
        self._is_received[sensors.received_samples(ticks, plant_model, loss)] = True
        self._last_stamp_s = -TICK_s

    def read(
        self, k: int, q_rad: Array, dq_rad_s: Array, tau_Nm: Array
    ) -> ArmSample | None:
        """Return the sample of tick k; None if it is not sent or gets lost."""
        width = self._torque.backlash_Nm
        lagging = tau_Nm if self._lagging_Nm is None else self._lagging_Nm
        self._lagging_Nm = lagging = np.minimum(
            np.maximum(lagging, tau_Nm - width), tau_Nm + width
        )
        q = sensors.measured_position(q_rad, self._plant_model, self._position)
        dq = sensors.measured_velocity(dq_rad_s, self._plant_model, self._velocity)
        tau = self._torque.reading(tau_Nm, lagging, q_rad, k)
        if not self._is_received[k]:
            return None
        dt_s = float(self._stamp_s[k] - self._last_stamp_s)
        self._last_stamp_s = self._stamp_s[k]
        return ArmSample(dt_s, q, dq, tau)

    def wrench(self, k: int, wrench: Array) -> Array:
        """Return the reading of the reference F/T sensor."""
        return wrench + self._wrench_error[k]


class SimulatedArm:
    """A simulated LWR 4+ with a needle, driven by joint velocities.

    Iterate over it for the samples: each step is one tick of 1 ms, or more where
    samples get lost. It ends after the duration that sensor errors were drawn for.

    Attributes:
        robot: The arm as its user knows it.
        tool: The needle as its user knows it.
        home_rad: Where it starts, needle straight down, shape (7,).
        contacts: What touches it besides the tissue.
        preset: Name of its limits for a controller.
    """

    preset = "lwr"

    def __init__(
        self,
        scenario: Scenario | str | None = None,
        plant: PlantModel | str = "clean",
        seed: int = 0,
        *,
        servo: Servo = "stiff",
        latency_s: float = 2e-3,
        contacts: Sequence[Contact] = (),
        standoff_m: float | None = None,
        duration_s: float = 120.0,
    ) -> None:
        """Place the arm at rest.

        Args:
            scenario: Its tissue lies under the needle; None for free air. Its motion is
                not used.
            plant: Plant model or its name.
            seed: Of everything drawn; the arm and its sensors are those of `simulate`.
            servo: The arm's own loop.
            latency_s: From `send` to its effect, at least one tick.
            contacts: What touches it; they begin where the arm starts.
            standoff_m: Height of the tip above the tissue at the start; None for the
                scenario's.
            duration_s: After this time the samples end.

        Raises:
            ScenarioError: There is no scenario of that name.
            PlantModelError: There is no plant model of that name.
            PlantError: A servo or a latency that does not exist.
        """
        chosen = (
            scenario_named(scenario, seed) if isinstance(scenario, str) else scenario
        )
        plant_model = plant_named(plant)
        mass, sensing, bearing = np.random.SeedSequence(seed).spawn(3)
        self.tool = NeedleTool()
        bodies = lwr_bodies(self.tool, plant_model, np.random.default_rng(mass))
        self.robot = bodies.robot
        self.home_rad = needle_down(self.robot, np.array(LWR_POSTURE_rad))
        limit_Nm = self.robot.effort_limit_Nm
        friction = bearings(plant_model, limit_Nm, np.random.default_rng(bearing))
        tissue = _tissue_below(bodies.kinematics, self.home_rad, chosen, standoff_m)
        self.contacts = tuple(contacts)
        if chosen is not None and chosen.elbow is not None:
            self.contacts += (HandOnArm(at="elbow", force_N=chosen.elbow.at),)
        self._law = tissue.law
        self._plant = ArmPlant(bodies, tissue, friction, self.contacts)
        self._plant.place(self.home_rad, np.zeros(self.robot.nv))
        self._ticks = round(duration_s / TICK_s)
        self._sensors = _OnlineSensors(plant_model, limit_Nm, self._ticks, sensing)
        self._servo = _Servo(self.robot, self.home_rad, servo)
        self._commands = _Commands(self.robot.nv, latency_s)
        self._tick = 0
        self._is_begun = False
        self._torque_Nm = np.zeros(self.robot.nv)
        self._depths_m: list[float] = []
        self._forces: list[TissueForce] = []
        self._faults: list[tuple[int, Callable[[ArmSample], ArmSample | None]]] = []
        self._lost_until = 0
        self._refused_until = 0
        self._unreported_s = 0.0  # of samples that a fault has lost

    def __iter__(self) -> Iterator[ArmSample]:
        return self

    def close(self) -> None:
        """End the samples, as the connection to a real arm is ended."""
        self._tick = self._ticks

    def __enter__(self) -> Self:
        """Return the arm itself."""
        return self

    def __exit__(self, *error: object) -> None:
        """End the samples."""
        self.close()

    def __next__(self) -> ArmSample:
        """Let the tick pass, and those after it whose samples are not received."""
        while True:
            if self._is_begun and self._tick < self._ticks:
                self._pass_tick()
            if self._tick >= self._ticks:
                raise StopIteration
            self._is_begun = True
            plant = self._plant
            self._torque_Nm = self._servo.torque(
                self._commands.next_rad_s(), plant.q_rad, plant.dq_rad_s
            )
            sample = self._sensors.read(
                self._tick, plant.q_rad, plant.dq_rad_s, self._torque_Nm
            )
            sample = self._with_faults(sample)
            if sample is not None:
                return sample

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """Command a joint velocity [rad/s], shape (7,); return False if it is refused.

        It is reached a latency later.

        Of several in one tick the last counts. The arm refuses numbers that are not
        finite.
        """
        velocity = np.array(dq_rad_s, dtype=np.float64)
        if self._tick < self._refused_until or not np.isfinite(velocity).all():
            return False
        if self._tick >= self._lost_until:
            self._commands.new = velocity
        return True

    @property
    def time_s(self) -> float:
        """Time of the last sample since the start."""
        return self._tick * TICK_s

    @property
    def truth(self) -> ArmTruth:
        """True state at the last sample."""
        plant = self._plant
        return ArmTruth(
            t_s=self.time_s,
            q_rad=plant.q_rad.copy(),
            dq_rad_s=plant.dq_rad_s.copy(),
            tau_Nm=self._torque_Nm.copy(),
            tip_m=plant.tip_m.copy(),
            rotation=plant.tip_axes.copy(),
            depth_m=plant.depth_m,
            speed_m_s=float(plant.axial_jacobian.dot(plant.dq_rad_s)),
            tissue=plant.tissue_force,
        )

    @property
    def ft_wrench(self) -> Array:
        """Reading of the reference F/T sensor one tick ago, shape (6,).

        See `Signals`.
        """
        return self._sensors.wrench(max(self._tick - 1, 0), self._plant.ft_wrench)

    @property
    def depths_m(self) -> Array:
        """True depth of the tip at the start of every tick that has passed."""
        return np.array(self._depths_m)

    def tissue_truth(self) -> TissueTruth:
        """Return forces of the tissue and ruptures of the run so far, at all ticks.

        `PlantError` before the first tick has passed.
        """
        if not self._forces:
            raise PlantError("nothing has happened yet; iterate over the arm first")
        time = np.arange(len(self._forces), dtype=np.float64) * TICK_s
        return collect_truth(self._law, time, np.array(self._depths_m), self._forces)

    def distance_to_axis_m(self, point_m: ArrayLike) -> float:
        """Return the true distance of a point, base axes, from the needle's axis."""
        return distance_to_axis_m(
            point_m, self._plant.tip_m, self._plant.tip_axes[:, 2]
        )

    def inject(
        self, fault: Callable[[ArmSample], ArmSample | None], seconds: float
    ) -> None:
        """Pass all samples of the coming time through a fault.

        A fault that returns None loses the sample.
        """
        self._faults.append((self._ticks_ahead(seconds), fault))

    def lose(self, what: str, seconds: float) -> None:
        """Lose something for some time from the next sample on.

        Args:
            what: ``q_rad``, ``dq_rad_s`` or ``tau_Nm``, which then read nan;
                ``sample``, none of which comes; ``command``, none of which arrives,
                though the arm does not refuse it.
            seconds: For so long.

        Raises:
            PlantError: There is no such thing to lose.
        """
        if what == "command":
            self._lost_until = self._ticks_ahead(seconds)
        elif what == "sample":
            self.inject(lambda sample: None, seconds)
        elif what in ("q_rad", "dq_rad_s", "tau_Nm"):
            gone = np.full(self.robot.nv, np.nan)
            self.inject(lambda sample: sample._replace(**{what: gone.copy()}), seconds)
        else:
            raise PlantError(
                f"no {what!r} to lose; expected q_rad, dq_rad_s, tau_Nm, sample or "
                "command"
            )

    def refuse_commands(self, seconds: float) -> None:
        """Refuse all commands for some time from now on."""
        self._refused_until = self._ticks_ahead(seconds)

    def _ticks_ahead(self, seconds: float) -> int:
        """Return the tick after some seconds from the next sample on."""
        return self._tick + 1 + round(seconds / TICK_s)

    def _with_faults(self, sample: ArmSample | None) -> ArmSample | None:
        """Return the sample behind all faults; None where it is lost."""
        if sample is None:
            return None
        self._faults = [item for item in self._faults if item[0] > self._tick]
        sample = sample._replace(dt_s=sample.dt_s + self._unreported_s)
        self._unreported_s = sample.dt_s
        for _, fault in self._faults:
            sample = fault(sample)
            if sample is None:
                return None
        self._unreported_s = 0.0
        return sample

    def _pass_tick(self) -> None:
        """Let the arm move for a tick, and record the tissue."""
        plant = self._plant
        self._commands.end_tick()
        self._depths_m.append(plant.depth_m)
        plant.tick(self._torque_Nm)
        self._forces.append(plant.tissue_force)
        self._tick += 1


def with_kinematic_error(plant_model: PlantModel) -> PlantModel:
    """Return the same plant on an arm whose kinematics were never calibrated.

    The errors are 0.2 mm and 0.3 mrad.

    Where controller and plant have the same kinematics, errors of micrometres mean
    nothing.
    """
    return replace(
        plant_model,
        name=f"{plant_model.name}, kinematic error",
        kinematic_error_m=0.2e-3,
        kinematic_error_rad=0.3e-3,
    )


def _tissue_below(
    arm: Robot, home_rad: Array, scenario: Scenario | None, standoff_m: float | None
) -> TissueContact:
    """Lay the tissue under the true needle at home."""
    data = arm.create_data()
    pin.framesForwardKinematics(arm.model, data, home_rad)
    tip = data.oMf[arm.frame_id("needle_tip")]
    if scenario is None:
        return TissueContact(
            law=Tissue(()),
            surface_in_base_m=tip.translation.copy(),
            axis_in_base=tip.rotation[:, 2].copy(),
        )
    height_m = -scenario.motion.start_m if standoff_m is None else standoff_m
    # A push on the elbow is one of the arm's contacts.
    return replace(tissue_before(tip, height_m, scenario), elbow=None)
