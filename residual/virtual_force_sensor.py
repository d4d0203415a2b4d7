"""The virtual force/torque sensor: the few calls that a controller makes."""

import math
from copy import deepcopy
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.advice import Message
from residual.advice import TareAdvice
from residual.bias.estimator import BiasEstimator, BiasState
from residual.bias.model import Tare
from residual.checks.input import SampleClock, long_step
from residual.checks.monitor import ConsistencyMonitor, MonitorState
from residual.config import DEFAULT, SensorConfig
from residual.errors import Array, SampleError, SnapshotError, TareError, VelocityError
from residual.estimate import (
    INITIALIZING,
    NOT_TARED,
    SensorWarning,
    Status,
    WrenchEstimate,
)
from residual.sample_stream import SampleStream, StreamState, TorqueSample
from residual.snapshot import robot_digest, settings_text, try_out
from residual.tool_kinematics import ToolKinematics
from residual.wrench_estimator import COMPONENTS, WrenchEstimator
from urdf import Robot

_OK = Status.OK  # names of an enumeration take as long to find as a call
_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick


class SensorState(NamedTuple):
    """All that a `VirtualForceSensor` remembers.

    Attributes:
        robot: `robot_digest` of its robot.
        config: Its settings in words; they must be the same to go on.
        stream: Of the stream of samples; None before the first.
        is_external: Whether it is one of the robot's own external torques.
        lag_s: Of the stream that the last sample came by [s].
        offset: Of the offset removal.
        weighed_at: Where the joints were weighed last [rad], shape (n,).
        monitor: Of the consistency checks.
        wrench: Memory of `wrench_step`, shape (3, 3) or (3, 6).
        follows: Whether that memory is of a sample.
        unchecked_s: Time since the last consistency check [s].
        last: Last estimate; None before the first.
        missed_s: Time of samples rejected since then [s].
        rejected: Number of bad samples so far.
    """

    robot: str
    config: str
    stream: StreamState | None
    is_external: bool
    lag_s: float
    offset: BiasState
    torque_covariance: (
        Array  # Of the residual's error, as last renewed [Nm^2], shape (n, n)
    )
    weighed_at: Array
    monitor: MonitorState
    wrench: Array
    follows: bool
    unchecked_s: float
    waiting: (
        int  # 2 while the consistency check waits for its tick, 1 while the weights do
    )
    last: WrenchEstimate | None
    missed_s: float
    rejected: int


class VirtualForceSensor:
    """Force on the needle from joint signals alone (paper, Section IV).

    Call `update` every tick; move in free air, call `tare`, insert. The wrench is what
    the environment exerts on the tool at its frame, in base axes by default: a weight
    hung there reads as a force down, tissue that pushes back reads as a positive axial
    force.

    A bad sample (wrong shape, not finite, time not advancing) is not used: the last
    valid estimate comes back with status ``REJECTED`` and the reason. `copy.deepcopy`
    and `pickle` give a sensor that goes on bit for bit.

    Args:
        robot: The arm with its payload.
        config: Settings; `PUBLISHED` for the method as published.

    Attributes:
        lag_s: Time by which the estimate follows the force [s]; 0 before the first
            sample, and for external torques of the robot itself: their lag is not known
            here.
        elapsed_s: Time between the last two samples that were used [s]; 0 for the
            first.
        rejected: Bad samples since the last `reset`.
    """

    __copy__ = deepcopy  # A shallow copy would share what every sample changes

    def __init__(self, robot: Robot, config: SensorConfig = DEFAULT) -> None:
        self._digest = robot_digest(robot)
        self._robot = robot
        self._config = config
        SampleStream(
            robot, config, has_velocity=True
        )  # refuses what does not fit the robot now
        self._offset = BiasEstimator(robot, config)
        self._wrench = WrenchEstimator(robot, config)
        alone = replace(config, mode="axial", axes="base", weighting="covariance")
        self._contact = WrenchEstimator(robot, replace(alone, expected_force_N=100.0))
        self._monitor = ConsistencyMonitor(robot, self._wrench)
        self._smoothing_s = 1.0 / (config.force_bandwidth_per_s or math.inf)
        self.reset()

    @property
    def tared(self) -> bool:
        """Whether the offset has been removed."""
        return self._offset.memory.tared

    @property
    def velocity_rad_s(self) -> Array:
        """Joint velocity of the last sample used, given or estimated [rad/s], shape
        (n,).
        """
        return self._offset.memory.dq

    @property
    def kinematics(self) -> ToolKinematics:
        """Pose and Jacobian of the tool at the last sample that was used."""
        return self._wrench.kinematics

    @property
    def residual_std_Nm(self) -> Array:
        """Standard deviation of `WrenchEstimate.residual` per joint [Nm], shape (n,).

        Noise, what the tare left unknown here, drift since, and the torque of motion,
        which is known as well as the links' masses: an arm that accelerates makes it
        larger.
        """
        return np.sqrt(np.diag(self._wrench.torque_covariance))

    def recheck(self, last: WrenchEstimate) -> WrenchEstimate:
        """As `ConsistencyMonitor.recheck`."""
        return self._monitor.recheck(last, self._before or last)

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, tau: ArrayLike, dt_s: float
    ) -> WrenchEstimate:
        """Take one sample of joint signals.

        Args:
            q: Joint positions [rad], shape (n,).
            dq: Joint velocities [rad/s], shape (n,); None, always, for a robot that
                sends none.
            tau: Measured link-side joint torques [Nm], shape (n,).
            dt_s: Time since the previous call [s]; not read on the first one.

        Returns:
            The wrench with its uncertainty and status. A bad sample is reported there,
            not raised.
        """
        return self._take_sample(False, q, dq, tau, dt_s)

    def update_external_torque(
        self,
        q: ArrayLike,
        dq: ArrayLike | None,
        external_torque: ArrayLike,
        dt_s: float,
    ) -> WrenchEstimate:
        """Take one sample of an external-torque estimate that the robot supplies
        itself.

        Args:
            q: As in `update`, like ``dt_s`` and what is returned.
            dq: Joint velocities [rad/s], shape (n,); None, always, to have them
                estimated from positions, which are then as late as they are. Forces do
                not depend on them.
            external_torque: Torque of the environment on the joints [Nm], shape (n,).
            dt_s: Time since the previous call [s].
        """
        return self._take_sample(True, q, dq, external_torque, dt_s)

    def tare(self, *, ignore_contact: bool = False) -> Tare:
        """Fit the offset to the free motion since the start or `start_tare_recording`;
        return it.

        Call it while the arm rests or from outside the control loop: it takes a few
        tenths of a second. A contact that stands during all of the motion is noticed
        only if it is larger than what the prior lets the model be wrong by (tens of
        newtons on an LWR).

        Args:
            ignore_contact: Take it even where contact is seen, or torques or velocities
                that cannot be.

        Raises:
            TareError: Without data, a second time without `start_tare_recording`, with
                contact in sight, with torques that suggest a wrong sign, order, payload
                or treatment of gravity, or velocities that do not fit positions;
                nothing has then changed.
        """
        if self._monitor.velocity_fault and not ignore_contact:
            raise VelocityError(
                Message(
                    f"{self._monitor.velocity_fault} No tare would hold: correct the "
                    "signals and move in free air anew",
                    TareAdvice.IGNORE_CONTACT,
                )
            )
        external = self._stream is not None and self._stream.is_external
        try:
            tare = self._offset.tare(
                self._contact, ignore_contact=ignore_contact, is_external=external
            )
        except TareError as error:
            # What may be the cause of it.
            hints: list[str] = [Message.of(error)]
            if self.question:
                hints = [Message(f"{self.question} If not, ", Message.of(error))]
            if self.rejected and not len(self._offset.memory.recorder.sums):
                hints += [
                    f"{self.rejected} samples were rejected, the last one: {self._refusal}"
                ]
            hints += filter(None, [long_step(self.elapsed_s, self._config.max_gap_s)])
            raise TareError(Message.joined("; ", hints)) from None
        self._weigh()
        self._follows = False
        return tare

    @property
    def question(self) -> str:
        """Whether a signal is missing, or in degrees: what the samples ask; mostly
        empty.
        """
        stale = "" if self._stream is None else self._stream.question
        return "; ".join(filter(None, (self._monitor.question, stale)))

    def _weigh(self) -> None:
        """Weigh the joints by the residual's covariance where the arm is."""
        self._trust(self._monitor.widened(self._offset.covariance_Nm2()))
        self._wrench.weigh(self._offset.memory.q)

    def _trust(self, covariance_Nm2: Array) -> None:
        """Weigh with a covariance of the residual from now on."""
        tare = self._offset.memory.tare
        # A mean over L takes L / 3t of noise that lasts for t, and a lag T leaves t /
        # (t + T).
        gone = 3.0 * self._smoothing_s / self._offset.block_s * tare.scatter_Nm2
        gone *= tare.noise_Nm2.diagonal() / (tare.noise_Nm2.diagonal() + gone)
        self._wrench.set_torque_covariance(
            covariance_Nm2, tare.noise_Nm2, np.diag(gone)
        )

    def start_tare_recording(self) -> None:
        """Record free motion anew for the next `tare`; estimates are `NOT_TARED` until
        then.

        The next sample may be of the other kind of torque: everything then starts anew.
        """
        self._offset.start_tare_recording()
        self._monitor.forget_velocity()

    def reset(self) -> None:
        """Forget everything, the tare included."""
        self._stream: SampleStream | None = None
        self.lag_s = self.elapsed_s = 0.0
        self._restart()
        self._before = self._last = None
        self._clock = SampleClock(self._config.max_gap_s)
        self.rejected = 0
        self._refusal = ""

    def _restart(self) -> None:
        """Forget what a stream of samples has left behind."""
        self._offset.reset()
        self._monitor.restore(MonitorState())
        self._followed = np.zeros((3, self._wrench.size))
        self._follows = False
        self._unchecked_s = 0.0
        self._waiting = 2

    @property
    def filter_lag_s(self) -> float:
        """Time by which the force follows the posture it is reported with [s]: the
        observer's.
        """
        return 0.0 if self._stream is None else self._stream.filter_lag_s

    def snapshot(self) -> SensorState:
        """All that the sensor remembers; immutable. `needleforce.write_snapshot`
        stores it.
        """
        stream = self._stream
        return deepcopy(
            SensorState(
                robot=self._digest,
                config=settings_text(self._config, self._robot.nv),
                stream=None if stream is None else stream.memory,
                is_external=stream is not None and stream.is_external,
                lag_s=self.lag_s,
                offset=self._offset.memory,
                torque_covariance=self._wrench.torque_covariance,
                weighed_at=self._wrench.gain.rows[0],
                monitor=self._monitor.state,
                wrench=np.array(self._followed),
                follows=self._follows,
                unchecked_s=self._unchecked_s,
                waiting=self._waiting,
                last=self._last,
                missed_s=self._clock.missed_s,
                rejected=self.rejected,
            )
        )

    def restore(self, state: SensorState) -> None:
        """Go on, bit for bit, from where `snapshot` was taken.

        Raises:
            SnapshotError: Not a snapshot of such a sensor, a damaged one, or one of
                another robot or other settings; nothing has then changed.
        """
        if not isinstance(state, SensorState):
            raise SnapshotError(f"expected a SensorState, got {type(state).__name__}")
        if state.robot != self._digest:
            raise SnapshotError(
                "the snapshot is of another robot (joints, links, payload, frames or limits "
                "differ); restore it with the robot it was taken with"
            )
        config = settings_text(self._config, self._robot.nv)
        if state.config != config:
            raise SnapshotError(
                f"the snapshot is of other settings: {state.config}, this sensor has {config}"
            )
        try_out(type(self)(self._robot, self._config), state)
        self._take(deepcopy(state))

    def _take(self, state: SensorState) -> None:
        self.reset()
        if state.stream is not None:
            kind = {
                "is_external": state.is_external,
                "has_velocity": state.stream.velocity is None,
            }
            self._stream = SampleStream(self._robot, self._config, **kind)
            self._stream.restore(state.stream)
        self._offset.memory = state.offset
        self._trust(state.torque_covariance)
        self._wrench.weigh(state.weighed_at)
        self._monitor.restore(state.monitor)
        self._followed = state.wrench.copy()
        self._follows = state.follows
        self.lag_s = state.lag_s
        self._unchecked_s = state.unchecked_s
        self._waiting = state.waiting
        self._clock.missed_s = state.missed_s
        self._last = state.last
        self.rejected = state.rejected
        if state.last is not None:
            for value in state.last:
                if isinstance(value, np.ndarray):  # it may be handed out again
                    value.setflags(write=False)
            self.kinematics.update(self._offset.memory.q)

    def _take_sample(
        self,
        is_external: bool,
        q: ArrayLike,
        dq: ArrayLike | None,
        torque: ArrayLike,
        dt_s: float,
    ) -> WrenchEstimate:
        """One sample of either kind, or why it was rejected."""
        stream = self._stream
        try:
            if stream is None or stream.is_external != is_external:
                if stream is not None and not self._offset.is_fresh:
                    raise SampleError(
                        "update() and update_external_torque() were mixed; a tare is of one kind "
                        "of torque: keep to one of the two, or start_tare_recording() first"
                    )
                kind = {"is_external": is_external, "has_velocity": dq is not None}
                stream = SampleStream(self._robot, self._config, **kind)
            elapsed_s = 0.0 if self._last is None else self._clock.elapsed(dt_s)
            sample = stream.update(q, dq, torque, elapsed_s)
        except SampleError as error:
            return self._reject(dt_s, error)
        if stream is not self._stream:
            self._stream = stream
            self._restart()
        return self._finish(sample, stream, elapsed_s)

    def _finish(
        self, sample: TorqueSample, stream: SampleStream, elapsed_s: float
    ) -> WrenchEstimate:
        """Remove the offset, project, and say what the caller should know."""
        q, dq, tau, residual, settled = sample
        self._clock.missed_s = 0.0
        self.elapsed_s = elapsed_s
        self.lag_s = stream.lag_s
        offset = self._offset
        wrench = self._wrench
        monitor = self._monitor
        renewed = offset.follow(q, dq, tau, elapsed_s)
        bias = offset.memory
        if settled and not bias.tared:
            offset.record(residual, elapsed_s)
        self._unchecked_s += elapsed_s
        waiting = self._waiting
        checks = False
        if renewed or waiting:
            # The tick after a renewal checks, the next one weighs; what waits still, as
            # with a slow clock and in the first tick, is done with the next renewal.
            checks = waiting == 2
            weighs = waiting == 1 or (renewed and waiting == 2)
            self._waiting = 2 if renewed else waiting - 1
            if weighs and (offset.is_covariance_due or monitor.wants_widening):
                self._weigh()
        wrench.kinematics.update(q)
        # Smoothing and the lag that follows the force begin where the force is.
        lags = 0.0, 0.0
        if self._follows:
            lags = self._smoothing_s / elapsed_s, stream.lag_s / elapsed_s
        found = wrench.solve(q, residual, bias.bias, self._followed, lags)
        self._follows = True
        if checks:
            sent = dq if stream.has_velocity else None
            monitor.check(q, sent, found[-1], self._unchecked_s, tared=bias.tared)
            self._unchecked_s = 0.0
        status = _OK
        message = monitor.message
        warnings = monitor.warnings
        if (
            not (settled and bias.tared)
            or bias.leapt_s
            or stream.warning
            or stream.question
        ):
            status, message, warnings = self._assess(stream, settled=settled)
        last = _new(
            WrenchEstimate, (*found, status, message, monitor.mismatch, warnings)
        )
        self._before, self._last = self._last, last
        return last

    def _assess(
        self, stream: SampleStream, *, settled: bool
    ) -> tuple[Status, str, SensorWarning]:
        """Status, message and warnings of a sample that is not simply a good one."""
        offset = self._offset
        monitor = self._monitor
        warnings = monitor.warnings
        if stream.warning:
            warnings |= SensorWarning.FROZEN
        if offset.warning:
            warnings |= SensorWarning.TARE_EXPIRED
        if not settled:
            gap = long_step(self.elapsed_s, self._config.max_gap_s)
            return Status.INITIALIZING, gap or INITIALIZING, warnings
        if not offset.memory.tared:
            reason = monitor.velocity_fault or offset.warning or NOT_TARED
            texts = reason, stream.warning, self.question or monitor.limit
            return Status.NOT_TARED, "; ".join(filter(None, texts)), warnings
        frozen = stream.warning or stream.question
        message = "; ".join(filter(None, (frozen, offset.warning, monitor.message)))
        return Status.OK, message, warnings

    def _reject(self, dt_s: float, error: SampleError) -> WrenchEstimate:
        """The last valid estimate again; the time of a bad sample still passes."""
        self._refusal = str(error)
        self.rejected = self.rejected + 1
        last = self._last
        if last is None:
            last = WrenchEstimate.unknown(self._robot.nv, COMPONENTS[self._config.mode])
        else:
            self._clock.miss(dt_s)
        warnings = last.warnings | error.warning
        return last._replace(
            status=Status.REJECTED, message=str(error), warnings=warnings
        )
