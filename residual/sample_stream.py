"""From samples of joint signals to external joint torque.

A stream has joint torques, or the robot's own estimate of the external torque.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Array, Vector, WrittenVector
from foundation.jit import compiled
from residual.checks.input import ROUNDING_S, check_rows, read_rows
from residual.checks.noise import NoiseProbe, white_noise
from residual.checks.outliers import FaultDetector, GuardState
from residual.config import SensorConfig
from residual.errors import SampleError
from residual.momentum_observer import MomentumObserver, MomentumState
from residual.tool_kinematics import ToolKinematics
from residual.velocity_filter import VelocityEstimator, VelocityState
from urdf import Robot

TURN_RAD = 2.0 * math.pi
"""A full turn."""


@compiled
def unwrap(q: WrittenVector, q_before: Vector, turns: Vector, is_angle: Vector) -> bool:
    """Make angles on a circle continuous, in place.

    Args:
        q: Position as it came [rad], shape (n,).
        q_before: Position of the sample before, unwrapped [rad], shape (n,).
        turns: Turns that it was unwrapped by, shape (n,).
        is_angle: 1 for a joint that turns, 0 for one that slides, shape (n,).

    Returns:
        Whether a joint has stepped by a turn since, give or take what an arm can move.
    """
    max_motion_rad = 1.0
    has_stepped = False
    for j in range(len(q)):
        q[j] += TURN_RAD * turns[j]
        step_rad = q[j] - q_before[j]
        turned_rad = TURN_RAD * is_angle[j] * np.rint(step_rad / TURN_RAD)
        if turned_rad != 0.0 and abs(step_rad - turned_rad) < max_motion_rad:
            q[j] -= turned_rad
            has_stepped = True
    return has_stepped


class TorqueSample(NamedTuple):
    """External joint torque with the motion of the same instant; arrays (n,).

    Attributes:
        q: Position [rad], delayed like the residual when velocity is estimated.
        dq: Velocity [rad/s].
        tau: Measured torque [Nm]; the external torque where the robot sends that.
        residual: External joint torque before offset removal [Nm].
        settled: Whether the filters have forgotten their start.
    """

    q: Array
    dq: Array
    tau: Array
    residual: Array
    settled: bool


@dataclass(slots=True, eq=False)
class StreamState:
    """State of a `SampleStream`.

    Attributes:
        velocity: Of the velocity estimator; None where velocities are measured.
        guard: Of the fault detector; None where there is none.
        observer: Of the momentum observer; None for external torques.
        probe: Of the noise to smooth; None once it is known, and without smoothing.
        q: Position of the last sample, unwrapped [rad], shape (n,).
        turns: Turns that positions are unwrapped by, shape (n,).
        age_s: Time since the filters started.
        missed_s: Time that the observer has not seen yet.
        started: Whether there was a sample.
    """

    velocity: VelocityState | None
    guard: GuardState | None
    observer: MomentumState | None
    probe: NoiseProbe | None
    q: Array
    turns: Array
    age_s: float = 0.0
    missed_s: float = 0.0
    started: bool = False


class SampleStream:
    """Positions, velocities if there are any, and torques; all or none with velocities.

    Samples are copied, checked once and judged; then the momentum observer makes
    external torque of measured ones. Where the robot estimates external torque itself,
    and velocities are estimated here, position is as late as they are; how late the
    robot's own estimate is cannot be known.

    Args:
        robot: The arm with its payload.
        config: Settings of the sensor.
        has_velocity: Whether samples carry a measured velocity.
        is_external: Whether the torques are the robot's own estimates of the external
            torque.

    Attributes:
        is_external: See the arguments.
        has_velocity: See the arguments.
        filter_lag_s: Time by which the estimate follows the positions that it is
            reported with.
        lag_s: Time by which it follows the torque, where that is known here.
        memory: Its state.
        guard: The fault detector; None where there is none.
        is_stale: Whether signals have not changed for a while.
        has_turned: Whether a position of the last sample has stepped by a whole turn.
    """

    def __init__(
        self,
        robot: Robot,
        config: SensorConfig,
        *,
        has_velocity: bool,
        is_external: bool = False,
    ) -> None:
        self._joints = robot.nv
        self._model = robot.model
        self._data = robot.create_data()
        self._adds_gravity = config.torque_is_gravity_compensated and not is_external
        self._max_gap_s = config.max_gap_s + ROUNDING_S
        self.is_external = is_external
        self.has_velocity = has_velocity
        torque = "external_torque" if is_external else "tau"
        self._names = ("q", "dq", torque) if has_velocity else ("q", torque)
        self._velocity: VelocityEstimator | None = None
        delay_s = 0.0
        if not has_velocity:
            self._velocity = VelocityEstimator(
                self._joints,
                config.velocity_bandwidth_per_s,
                alignment=config.alignment,
                max_gap_s=self._max_gap_s,
            )
            delay_s = self._velocity.delay_s
        self.is_stale = False
        self.has_turned = False
        self.guard: FaultDetector | None = None
        if config.guard:
            # Without an offset forces are tried at the tool frame, whatever frame is
            # asked for.
            frame = config.frame if any(config.tool_offset_m) else None
            tip = ToolKinematics(robot, frame, offset_m=config.tool_offset_m)
            self.guard = FaultDetector(robot, tip, delay_s, self._names)
        self._observer: MomentumObserver | None = None
        self.filter_lag_s = 0.0
        self.lag_s = 0.0
        if not is_external:
            self._observer = MomentumObserver(
                robot,
                config.gain_per_s,
                # The velocity filter hands on a continuous torque.
                alignment=config.alignment if has_velocity else "trapezoid",
                friction=config.friction,
                max_gap_s=self._max_gap_s,
            )
            self.filter_lag_s = 1.0 / config.slowest_gain_per_s
            self.lag_s = self.filter_lag_s + delay_s
        # After five lags the start of the residual has faded to 1 %.
        self._settling_s = 5.0 * self.filter_lag_s - ROUNDING_S
        learns_noise = config.smooth_momentum and not is_external
        self.memory = StreamState(
            velocity=self._velocity and self._velocity.memory,
            guard=self.guard and self.guard.memory,
            observer=self._observer and self._observer.memory,
            probe=NoiseProbe.of_size(robot.nv) if learns_noise else None,
            q=np.zeros(robot.nv),
            turns=np.zeros(robot.nv),
        )
        kinds = [joint.shortname() for joint in list(robot.model.joints)[1:]]
        self._is_angle = np.array(
            [float(kind.startswith("JointModelR")) for kind in kinds]
        )

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, torque: ArrayLike, dt_s: float
    ) -> TorqueSample:
        """Take one sample; arguments as of `VirtualForceSensor.update`.

        Raises:
            SampleError: For a wrong shape, numbers that are not finite, a velocity that
                comes and goes, or, with a warning, for a spike, frozen signals or a
                saturated torque; nothing has then changed but what the fault detector
                knows of it.
        """
        memory = self.memory
        guard = self.guard
        rows = self._read(q, dq, torque)
        is_continued = memory.started and dt_s <= self._max_gap_s
        self.has_turned = is_continued and unwrap(
            rows[0], memory.q, memory.turns, self._is_angle
        )
        rows.setflags(write=False)
        if guard is None:
            check_rows(self._names, rows)
        elif guard.check(rows, dt_s) and self._velocity is not None:
            self._velocity.reset()  # the position has jumped, and stayed there
        sample = self._estimate(rows, dt_s)
        if guard is not None:
            self.is_stale = guard.accept(rows, sample.dq, dt_s)
        if self.has_turned:
            memory.turns = np.rint((rows[0] - np.asarray(q)) / TURN_RAD)
        elif not is_continued:
            memory.turns = np.zeros(self._joints)
        memory.q = rows[0]
        memory.started = True
        return sample

    def _read(self, q: ArrayLike, dq: ArrayLike | None, torque: ArrayLike) -> Array:
        """Copy a sample, shape (2 or 3, n), and add gravity where it lacks."""
        if (dq is None) == self.has_velocity:
            raise SampleError(
                "dq was given before and is missing now, or the reverse",
                "Keep to `update` or to `update_external_torque`, and to "
                "velocities or none; or call `start_tare_recording` or "
                "`reset` first.",
            )
        values = (q, torque) if dq is None else (q, dq, torque)
        rows = read_rows(self._names, values, self._joints)
        if self._adds_gravity:
            rows[-1] += pin.computeGeneralizedGravity(self._model, self._data, rows[0])
        return rows

    def _estimate(self, rows: Array, dt_s: float) -> TorqueSample:
        """Estimate the external torque of a checked sample, shape (2 or 3, n)."""
        memory = self.memory
        observer = self._observer
        matched = rows
        is_settled = True
        if self._velocity is not None:
            matched, is_settled = self._velocity.step(rows, dt_s)
            # A position that jumps far makes a velocity that no arm has.
            check_rows(("q", "dq", "tau"), matched)
        if observer is None:
            torque = rows[-1]
            return TorqueSample(matched[0], matched[1], torque, torque, is_settled)
        memory.missed_s += dt_s
        if not is_settled:  # the velocity filter has just started
            memory.age_s = 0.0
            residual = observer.residual
            return TorqueSample(matched[0], matched[1], matched[2], residual, False)
        elapsed_s = memory.missed_s
        memory.missed_s = 0.0
        residual = observer.step(matched, elapsed_s)
        memory.age_s = 0.0 if elapsed_s > self._max_gap_s else memory.age_s + elapsed_s
        if memory.probe is not None:
            self._learn_noise(observer, memory.probe, rows, matched[0], dt_s)
        is_settled = memory.age_s >= self._settling_s and memory.probe is None
        return TorqueSample(matched[0], matched[1], matched[2], residual, is_settled)

    def _learn_noise(
        self,
        observer: MomentumObserver,
        probe: NoiseProbe,
        rows: Array,
        q: Array,
        dt_s: float,
    ) -> None:
        """Learn the velocity's noise from the first samples, then smooth the momentum.

        Where velocities are estimated, their noise follows from that of positions.
        """
        samples = probe.add(rows[0] if self._velocity is not None else rows[1], dt_s)
        if samples is None:
            return
        noise = white_noise(samples)
        if self._velocity is not None:
            # At rest a coarse encoder may show no noise; in motion its steps are not
            # white: they last longer than a sample, and count twice.
            position_noise = np.full_like(noise, 2.0 * noise.max())
            noise = position_noise * self._velocity.noise_per_position_noise(dt_s)
        observer.smooth_momentum(noise, q)
        self.memory.probe = None

    def stale_signals(self) -> tuple[str, str]:
        """Return what `FaultDetector.stale_signals` does, if there is one."""
        return ("", "") if self.guard is None else self.guard.stale_signals()

    def restore(self, memory: StreamState) -> None:
        """Go on from the `memory` of a stream of the same kind and settings.

        It is not copied.
        """
        self.memory = memory
        for name, part in (
            ("velocity", self._velocity),
            ("guard", self.guard),
            ("observer", self._observer),
        ):
            if part is not None:
                part.memory = getattr(memory, name)
