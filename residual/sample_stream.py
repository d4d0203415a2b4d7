"""One stream of samples into external torque: joint torques, or the robot's own
estimate of it.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from residual.checks.input import ROUNDING_S, check_rows, read_rows
from residual.checks.outliers import FaultDetector, GuardState
from residual.checks.stuck_signals import MOST_SAMPLES, NoiseProbe, white_noise
from residual.config import SensorConfig
from residual.errors import Array, SampleError
from residual.momentum_observer import MomentumObserver, MomentumState
from residual.tool_kinematics import ToolKinematics
from residual.velocity_filter import VelocityEstimator, VelocityState
from urdf import Robot

COARSE = 2.0  # times the white noise of positions: steps of an encoder last longer than a sample
SETTLING_LAGS = 5.0  # lags after which the start of the residual has faded to 1 %
_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick


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
    """All that a stream remembers.

    Attributes:
        velocity: Of the velocity estimator; None where velocities are measured.
        guard: Of the fault detector; None where there is none.
        observer: Of the momentum observer; None for external torques.
        probe: Of the noise to smooth; None once it is known, and without smoothing.
        age_s: Time since the filters started [s].
        missed_s: Time that the observer has not seen yet [s].
    """

    velocity: VelocityState | None
    guard: GuardState | None
    observer: MomentumState | None
    probe: NoiseProbe | None
    age_s: float = 0.0
    missed_s: float = 0.0


class SampleStream:
    """Positions, velocities if there are any, and torques; all or none with velocities.

    Samples are copied, checked once and judged; then the momentum observer makes
    external torque of measured ones. Where the robot estimates external torque itself,
    and velocities are estimated here, position is as late as they are; how late the
    robot's own estimate is cannot be known.

    Attributes:
        is_external: Whether the torques are such estimates of the robot.
        has_velocity: Whether samples carry a measured velocity.
        filter_lag_s: Time by which the estimate follows the positions that it is
            reported with [s].
        lag_s: Time by which it follows the torque [s], where that is known here.
        memory: All that it remembers.
    """

    def __init__(
        self,
        robot: Robot,
        config: SensorConfig,
        *,
        has_velocity: bool,
        is_external: bool = False,
    ) -> None:
        n = self._joints = robot.nv
        self.is_external = is_external
        self.has_velocity = has_velocity
        torque = "external_torque" if is_external else "tau"
        self._names = ("q", "dq", torque) if has_velocity else ("q", torque)
        self._velocity = self._guard = self._observer = None
        delay_s = self.lag_s = self.filter_lag_s = 0.0
        alignment = config.alignment
        gap_s = config.max_gap_s + ROUNDING_S
        if not has_velocity:
            self._velocity = VelocityEstimator(
                n, config.velocity_bandwidth_per_s, alignment=alignment, max_gap_s=gap_s
            )
            # The matched filter hands on a continuous torque.
            delay_s = self._velocity.delay_s
            alignment = "trapezoid"
        if config.guard:
            # Without an offset forces are tried at the tool frame, whatever frame is
            # asked for.
            frame = config.frame if any(config.tool_offset_m) else None
            tip = ToolKinematics(robot, frame, offset_m=config.tool_offset_m)
            self._guard = FaultDetector(robot, tip, delay_s, has_velocity=has_velocity)
        if not is_external:
            self._observer = MomentumObserver(
                robot,
                config.gain_per_s,
                alignment=alignment,
                friction=config.friction,
                max_gap_s=gap_s,
            )
            self.filter_lag_s = 1.0 / config.slowest_gain_per_s
            self.lag_s = self.filter_lag_s + delay_s
        self._data = robot.create_data()
        self._model = robot.model
        self._adds_gravity = config.torque_is_gravity_compensated and not is_external
        self._max_gap_s = gap_s
        self._settling_s = SETTLING_LAGS * self.filter_lag_s - ROUNDING_S
        probes = config.smooth_momentum and not is_external
        parts = self._velocity, self._guard, self._observer
        velocity, guard, observer = (getattr(part, "memory", None) for part in parts)
        probe = NoiseProbe(np.zeros((MOST_SAMPLES, n))) if probes else None
        self.memory = StreamState(velocity, guard, observer, probe)

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, torque: ArrayLike, dt_s: float
    ) -> TorqueSample:
        """Take one sample; arguments as of `VirtualForceSensor.update`.

        `SampleError` for a wrong shape, numbers that are not finite, a velocity that
        comes and goes, or, with a warning, for a spike, frozen signals or a saturated
        torque; nothing has then changed but what the fault detector knows of it.
        """
        if (dq is None) == self.has_velocity:
            raise SampleError(
                "dq was given before and is missing now, or the reverse; keep to one of the two "
                "for a stream, or reset() first"
            )
        values = (q, torque) if dq is None else (q, dq, torque)
        rows = read_rows(self._names, values, self._joints)
        if self._adds_gravity:
            rows = rows.copy()
            rows[-1] += pin.computeGeneralizedGravity(self._model, self._data, rows[0])
            rows.setflags(write=False)
        now = rows.ravel()
        guard = self._guard
        # What is hardly off the last sample needs no other check, nor one of its
        # numbers.
        if guard is None or not guard.surely_passes(now):
            check_rows(self._names, rows)
            if (
                guard is not None
                and guard.check(now, dt_s)
                and self._velocity is not None
            ):
                self._velocity.reset()  # the position reading is elsewhere now
        sample = self._estimate(rows, dt_s)
        if guard is not None:
            guard.accept(now, sample.dq, dt_s)
        return sample

    def _estimate(self, rows: Array, dt_s: float) -> TorqueSample:
        memory = self.memory
        observer = self._observer
        last_s = dt_s
        found = rows
        settled = True
        if self._velocity is not None:
            found, settled = self._velocity.step(rows, dt_s)
        q = found[0]
        dq = found[1]
        if observer is None:
            return TorqueSample(q, dq, rows[-1], rows[-1], settled)
        if self._velocity is not None:
            memory.missed_s += dt_s
            if not settled:
                memory.age_s = 0.0
                return TorqueSample(q, dq, found[2], observer.residual, False)
            dt_s, memory.missed_s = memory.missed_s, 0.0
        residual = observer.step(found, dt_s)
        memory.age_s = 0.0 if dt_s > self._max_gap_s else memory.age_s + dt_s
        if memory.probe is not None:
            # Learn the velocity's noise from the first samples, then smooth the
            # momentum.
            samples = memory.probe.add(
                rows[0 if self._velocity is not None else 1], last_s
            )
            if samples is not None:
                noise = white_noise(samples)
                if self._velocity is not None:
                    # At rest a coarse encoder may show no noise; in motion its steps
                    # are not white.
                    largest = np.full_like(noise, COARSE * noise.max())
                    noise = largest * self._velocity.noise_per_position_noise(last_s)
                observer.smooth_momentum(noise, q)
                memory.probe = None
        settled = memory.age_s >= self._settling_s and memory.probe is None
        return _new(TorqueSample, (q, dq, found[2], residual, settled))

    @property
    def warning(self) -> str:
        """What seems frozen in samples that are taken all the same; empty if nothing
        does.
        """
        return "" if self._guard is None else self._guard.memory.warning

    @property
    def question(self) -> str:
        """Which signals may be missing, as they do not change; empty if none."""
        return "" if self._guard is None else self._guard.memory.question

    def restore(self, memory: StreamState) -> None:
        """Go on from a `memory`, which is kept, of a stream of the same kind and
        settings.
        """
        self.memory = memory
        if self._velocity is not None and memory.velocity is not None:
            self._velocity.memory = memory.velocity
        if self._guard is not None and memory.guard is not None:
            self._guard.restore(memory.guard)
        if self._observer is not None:
            assert memory.observer is not None, "a state of a stream of joint torques"
            self._observer.restore(memory.observer)
