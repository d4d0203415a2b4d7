"""The virtual force/torque sensor: the few calls that a controller makes."""

import math
import sys
from copy import deepcopy
from dataclasses import dataclass, replace
from numbers import Integral

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.jit import compile_waiting
from foundation.state import SAME_KIND, SAME_SETTINGS
from residual.bias.estimator import BiasEstimator, BiasState
from residual.bias.model import Tare
from residual.bias.torque_scale import TorqueDiagnosis
from residual.checks.input import MAX_STEP_S, as_float, elapsed_time
from residual.checks.monitor import ConsistencyMonitor, MonitorState
from residual.config import DEFAULT, SensorConfig
from residual.errors import (
    ConfigurationError,
    SampleError,
    SnapshotError,
    TareError,
)
from residual.estimate import (
    Assessment,
    SensorWarning,
    Status,
    WrenchEstimate,
)
from residual.fingerprint import robot_digest, settings_text
from residual.sample_stream import SampleStream, StreamState, TorqueSample
from residual.tool_kinematics import ToolKinematics
from residual.wrench_estimator import (
    COMPONENTS,
    WrenchEstimator,
    WrenchFilterState,
)
from urdf import Robot

# Slow work is done in ticks of its own, so that none does all of it: after the bias was
# renewed the next tick checks consistency, the one after that computes the gain anew.

DUE_CHECK = 2
"""Ticks before the gain is computed in which consistency is checked."""

DUE_GAIN = 1
"""Tick in which the gain is computed; after it nothing is due."""


@dataclass(slots=True, kw_only=True, eq=False)
class SensorState:
    """State of a `VirtualForceSensor`, with the robot and settings that it is of.

    The parts of a sensor keep their own states; a snapshot has them, too.

    Attributes:
        robot: `robot_digest` of its robot.
        config: Its settings in words; they must be the same to go on.
        wrench_filter: Of the smoothing of the wrench.
        is_smoothing: Whether that is of a sample.
        unchecked_s: Time since the last consistency check.
        due: Slow work that waits for its tick, see `DUE_CHECK`.
        last: Last estimate; None before the first.
        missed_s: Time of samples rejected since then.
        rejected: Number of bad samples so far.
        is_external: Whether samples have the robot's own external torques.
        stream: State of the stream of samples; None before the first.
        offset: State of the offset removal.
        monitor: State of the consistency checks.
        torque_covariance: Covariance of the residual's error, as last renewed [Nm^2],
            shape (n, n).
        gain_configuration: Where the gain was computed last [rad], shape (n,).
    """

    robot: str
    config: str
    wrench_filter: WrenchFilterState
    is_smoothing: bool = False
    unchecked_s: float = 0.0
    due: int = DUE_CHECK
    last: WrenchEstimate | None = None
    missed_s: float = 0.0
    rejected: int = 0
    is_external: bool = False
    stream: StreamState | None = None
    offset: BiasState
    monitor: MonitorState
    torque_covariance: Array
    gain_configuration: Array


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
        elapsed_s: Time between the last two samples that were used; 0 for the first.
        tare_refusal: Why the latest `start_tare` did not end in a tare; None if it did,
            or has not ended yet.
    """

    # A shallow copy would share what every sample changes.
    __copy__ = deepcopy

    def __init__(self, robot: Robot, config: SensorConfig = DEFAULT) -> None:
        compile_waiting()
        self._robot = robot
        self._digest = robot_digest(robot)
        self._config = config
        # Settings that do not fit the robot are refused now.
        SampleStream(robot, config, has_velocity=True)
        self._settings = settings_text(config, robot.nv)
        self._offset = BiasEstimator(robot, config)
        self._wrench = WrenchEstimator(robot, config)
        # What looks for a contact in a tare.
        contact_config = replace(
            config,
            mode="axial",
            axes="base",
            weighting="covariance",
            expected_force_N=100.0,
        )
        self._contact = WrenchEstimator(robot, contact_config)
        self._monitor = ConsistencyMonitor(robot, self._wrench)
        self._smoothing_s = 1.0 / (config.force_bandwidth_per_s or math.inf)
        self.reset()

    @property
    def tared(self) -> bool:
        """Whether the offset has been removed."""
        return self._offset.memory.tared

    @property
    def rejected(self) -> int:
        """Number of bad samples since the last `reset`."""
        return self._state.rejected

    @property
    def taring(self) -> bool:
        """Whether a tare is being fitted, see `start_tare`."""
        return self._offset.memory.request is not None

    @property
    def velocity_rad_s(self) -> Array:
        """Joint velocity of the last sample used [rad/s], shape (n,).

        It is given or estimated.
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

    @property
    def diagnosis(self) -> TorqueDiagnosis | None:
        """What the motion of the latest tare shows of the torques' scale and signs.

        None before a tare, of external torques, after a tare that ignored contact, and
        in a restored sensor.
        """
        return self._offset.diagnosis

    @property
    def is_measuring_jump(self) -> bool:
        """Whether a torque sensor has jumped just now.

        By how much is then known 2 to 2.5 s later.
        """
        return self._monitor.is_measuring_jump

    @property
    def jumps(self) -> int:
        """Number of jumps of torque sensors that were measured since the tare."""
        return self._monitor.torques.jumps

    @property
    def jump_since_s(self) -> float:
        """Time since the latest jump can have begun, or since the tare [s]."""
        return self._monitor.torques.since_s

    @property
    def jump_std_N(self) -> float:
        """Standard deviation of the axial force by these jumps."""
        return self._monitor.jump_std_N

    def std_of_bias_N(self, estimate: WrenchEstimate) -> float:
        """Return the standard deviation of an axial force without that of its scale.

        An error of the scale changes all forces alike: it makes none of them less
        certain relative to the others.
        """
        scale_error_N = self._offset.memory.tare.scale_std * estimate.axial
        return math.sqrt(max(estimate.axial_std**2 - scale_error_N**2, 0.0))

    def recheck(self, estimate: WrenchEstimate) -> WrenchEstimate:
        """Return the last estimate with a warning if its torques fit no needle force.

        See `ConsistencyMonitor.recheck`.
        """
        return self._monitor.recheck(estimate, self._estimate_before or estimate)

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
        return self._update(q, dq, tau, dt_s, is_external=False)

    def update_external_torque(
        self,
        q: ArrayLike,
        dq: ArrayLike | None,
        external_torque: ArrayLike,
        dt_s: float,
    ) -> WrenchEstimate:
        """Take one sample of the robot's own estimate of the external torque.

        Args:
            q: As in `update`, like ``dt_s`` and what is returned.
            dq: Joint velocities [rad/s], shape (n,); None, always, to have them
                estimated from positions, which are then as late as they are. Forces do
                not depend on them.
            external_torque: Torque of the environment on the joints [Nm], shape (n,).
            dt_s: Time since the previous call [s].
        """
        return self._update(q, dq, external_torque, dt_s, is_external=True)

    def tare(self, *, ignore_contact: bool = False) -> Tare:
        """Fit the offset to the recorded free motion and return it.

        That is the motion since the start, or since `start_tare_recording`.

        It returns when the tare is fitted, after a few tenths of a second; a control
        loop calls `start_tare`. A contact that stands during all of the motion is
        noticed only if it is larger than what the prior lets the model be wrong by
        (tens of newtons on an LWR).

        Args:
            ignore_contact: Take it even where contact is seen, or torques or velocities
                that cannot be.

        Raises:
            TareError: Without data, a second time without `start_tare_recording`, with
                contact in sight, with torques that suggest a wrong sign, order, payload
                or treatment of gravity, or velocities that do not fit positions;
                nothing has then changed.
        """
        self._begin_tare(ignore_contact=ignore_contact, steps_per_tick=sys.maxsize)
        self._offset.continue_tare(self._contact)
        self._renew_gain()
        self._state.is_smoothing = False
        return self._offset.memory.tare

    def start_tare(
        self, *, ignore_contact: bool = False, steps_per_tick: int = 1
    ) -> None:
        """Begin the tare that `tare` takes, and fit it beside the updates that follow.

        Each valid sample does a few short steps of it, each of some tenths of a
        millisecond; a tare takes about a thousand samples, more if it is refused. The
        fit is to the motion recorded until now, and equal bit for bit to that of `tare`
        here. `taring` is true meanwhile, and estimates stay as they were before:
        `NOT_TARED`, with the offset in them; their message says that a tare is being
        fitted. If it is refused, `tare_refusal` and the message say why, recording goes
        on, and nothing else has changed. While taring a second call does nothing;
        `tare`, `start_tare_recording` and `reset` end what the first one began.

        Args:
            ignore_contact: See `tare`.
            steps_per_tick: Steps in an update; in a slow loop there is time for more.

        Raises:
            TareError: What is known at once: without data, a second time without
                `start_tare_recording`, or with velocities that do not fit positions.
            ConfigurationError: If the number of steps is not a whole number > 0.
        """
        if not isinstance(steps_per_tick, Integral) or steps_per_tick < 1:
            raise ConfigurationError(
                f"steps_per_tick is {steps_per_tick!r}, expected a whole number > 0"
            )
        if self.taring:
            return
        self.tare_refusal = None
        self._begin_tare(
            ignore_contact=ignore_contact, steps_per_tick=int(steps_per_tick)
        )

    def _begin_tare(self, *, ignore_contact: bool, steps_per_tick: int) -> None:
        """Prepare a tare, or refuse it for signals that are known to be wrong."""
        if self._monitor.velocity_fault and not ignore_contact:
            raise TareError(
                f"{self._monitor.velocity_fault}: no tare would hold",
                "Correct the units, signs, order or delay of `dq`, or pass `dq=None` "
                "in every sample, and move in free air anew; "
                "`tare(ignore_contact=True)` tares as it is.",
            )
        self._offset.start_tare(
            ignore_contact=ignore_contact,
            is_external=self._stream is not None and self._stream.is_external,
            steps_per_tick=steps_per_tick,
        )

    def _continue_tare(self) -> None:
        """Do the steps of this tick; use the tare, or keep why it is refused."""
        try:
            is_taken = self._offset.continue_tare(self._contact)
        except TareError as error:
            self.tare_refusal = error
            return
        if is_taken:
            # The next sample computes the gain before it is used.
            self._state.due = DUE_GAIN
            self._state.is_smoothing = False

    @property
    def question(self) -> str:
        """Which torques may be missing, as they do not change; mostly empty."""
        return "" if self._stream is None else self._stream.stale_signals()[1]

    def _renew_gain(self) -> None:
        """Compute the gain with the residual's covariance where the arm is."""
        self._set_covariance(self._monitor.widen(self._offset.covariance_Nm2()))
        self._wrench.compute_gain(self._offset.memory.q)

    def _set_covariance(self, covariance_Nm2: Array) -> None:
        """Set the covariance of the residual's error [Nm^2], shape (n, n)."""
        tare = self._offset.memory.tare
        self._wrench.scale_std = tare.scale_std
        # A mean over L removes all but 3 t / L of the variance of noise that lasts for
        # t; of that the smoothing with a lag T leaves t / (t + T).
        noise_ratio = 3.0 * self._smoothing_s / self._offset.block_s
        smoothed_Nm2 = noise_ratio * tare.scatter_Nm2
        noise_Nm2 = tare.noise_Nm2.diagonal()
        smoothed_Nm2 *= noise_Nm2 / (noise_Nm2 + smoothed_Nm2)
        self._wrench.set_torque_covariance(
            covariance_Nm2,
            tare.noise_Nm2,
            np.diag(smoothed_Nm2),
            self._monitor.jump_Nm2,
        )

    def start_tare_recording(self) -> None:
        """Record free motion anew for the next `tare`.

        Estimates are `NOT_TARED` until then. The next sample may be of the other kind
        of torque: everything then starts anew.
        """
        self._offset.start_tare_recording()
        self.tare_refusal = None
        self._monitor.forget_tare()

    def reset(self) -> None:
        """Forget everything, the tare included."""
        self._stream: SampleStream | None = None
        self.elapsed_s = 0.0
        self._estimate_before: WrenchEstimate | None = None
        self._state = SensorState(
            robot=self._digest,
            config=self._settings,
            wrench_filter=WrenchFilterState.at_zero(self._wrench.size),
            offset=self._offset.memory,
            monitor=self._monitor.state,
            torque_covariance=self._wrench.torque_covariance,
            gain_configuration=self._wrench.gain.configuration_rad,
        )
        self._restart()

    def _restart(self) -> None:
        """Forget the samples of a stream, before another begins."""
        self.tare_refusal: TareError | None = None
        self._offset.reset()
        self._monitor.reset()
        state = self._state
        state.wrench_filter = WrenchFilterState.at_zero(self._wrench.size)
        state.is_smoothing = False
        state.unchecked_s = 0.0
        state.due = DUE_CHECK

    @property
    def lag_s(self) -> float:
        """Time by which the estimate follows the force [s].

        0 before the first sample, and for external torques of the robot itself: their
        lag is not known here.
        """
        return 0.0 if self._stream is None else self._stream.lag_s

    @property
    def filter_lag_s(self) -> float:
        """Time by which the force follows the posture that it is reported with [s].

        It is the lag of the observer.
        """
        return 0.0 if self._stream is None else self._stream.filter_lag_s

    def snapshot(self) -> SensorState:
        """Return the state of the sensor, a copy.

        `needleforce.write_snapshot` stores it.
        """
        stream = self._stream
        return deepcopy(
            replace(
                self._state,
                is_external=stream is not None and stream.is_external,
                stream=None if stream is None else stream.memory,
                offset=self._offset.memory,
                monitor=self._monitor.state,
                torque_covariance=self._wrench.torque_covariance,
                gain_configuration=self._wrench.gain.configuration_rad,
            )
        )

    def restore(self, state: SensorState) -> None:
        """Go on, bit for bit, from where `snapshot` was taken.

        Raises:
            SnapshotError: Not a snapshot of such a sensor, or one of another robot or
                other settings; nothing has then changed.
        """
        if not isinstance(state, SensorState):
            raise SnapshotError(
                f"expected a SensorState, got {type(state).__name__}", SAME_KIND
            )
        if state.robot != self._digest:
            raise SnapshotError(
                "the snapshot is of another robot (joints, links, payload, frames or "
                "limits differ)",
                SAME_SETTINGS,
            )
        if state.config != self._settings:
            raise SnapshotError(
                f"the snapshot is of other settings: {state.config}, this sensor has "
                f"{self._settings}",
                SAME_SETTINGS,
            )
        state = deepcopy(state)
        self.reset()
        if state.stream is not None:
            self._stream = SampleStream(
                self._robot,
                self._config,
                is_external=state.is_external,
                has_velocity=state.stream.velocity is None,
            )
            self._stream.restore(state.stream)
        self._offset.memory = state.offset
        self._monitor.restore(state.monitor)
        self._set_covariance(state.torque_covariance)
        self._wrench.compute_gain(state.gain_configuration)
        self._state = state
        if state.last is not None:
            for value in state.last:
                if isinstance(value, np.ndarray):  # it may be handed out again
                    value.setflags(write=False)
            self.kinematics.update(self._offset.memory.q)

    def _update(
        self,
        q: ArrayLike,
        dq: ArrayLike | None,
        torque: ArrayLike,
        dt_s: float,
        *,
        is_external: bool,
    ) -> WrenchEstimate:
        """Estimate the wrench of a sample, or repeat the last one with the reason."""
        try:
            stream = self._stream
            if stream is None or stream.is_external != is_external:
                stream = self._new_stream(is_external, has_velocity=dq is not None)
            state = self._state
            elapsed_s = 0.0
            if state.last is not None:
                elapsed_s = elapsed_time(dt_s, state.missed_s)
            sample = stream.update(q, dq, torque, elapsed_s)
        except SampleError as error:
            return self._reject(dt_s, error)
        if stream is not self._stream:
            self._stream = stream
            self._restart()
        return self._process(sample, stream, elapsed_s)

    def _new_stream(self, is_external: bool, *, has_velocity: bool) -> SampleStream:
        """Return a stream of another kind of torque; refuse one where a tare stands."""
        if self._stream is not None and not self._offset.is_fresh:
            raise SampleError(
                "measured and external torques were mixed; a tare is of one kind of "
                "torque",
                "Keep to `update` or to `update_external_torque`, and to "
                "velocities or none; or call `start_tare_recording` or "
                "`reset` first.",
            )
        return SampleStream(
            self._robot,
            self._config,
            is_external=is_external,
            has_velocity=has_velocity,
        )

    def _process(
        self, sample: TorqueSample, stream: SampleStream, elapsed_s: float
    ) -> WrenchEstimate:
        """Estimate the wrench of a valid sample, the bias removed."""
        state = self._state
        state.missed_s = 0.0
        self.elapsed_s = elapsed_s
        state.unchecked_s += elapsed_s
        q, dq, tau, total_residual, is_settled = sample
        offset = self._offset
        wrench = self._wrench
        is_renewed = offset.update(q, dq, tau, elapsed_s)
        bias = offset.memory
        if is_settled and not bias.tared:
            offset.record(total_residual, elapsed_s)
        due = state.due
        state.due = DUE_CHECK if is_renewed else max(due - 1, 0)
        # On a slow clock, and in the first tick, the bias may be renewed while the
        # check is due; then all is done in one tick.
        is_gain_tick = due == DUE_GAIN or (is_renewed and due == DUE_CHECK)
        if is_gain_tick and (
            offset.is_covariance_due or self._monitor.state.is_covariance_due
        ):
            self._renew_gain()
        wrench.kinematics.update(q)
        wrench.renew_gain(q)
        residual = total_residual - bias.bias
        if due == DUE_CHECK:
            self._monitor.check(
                q,
                dq if stream.has_velocity else None,
                residual,
                state.unchecked_s,
                offset.tare_error_Nm2,
            )
            state.unchecked_s = 0.0
        residual -= self._monitor.level_Nm
        smoothing_lag = 0.0
        observer_lag = 0.0
        if state.is_smoothing:
            smoothing_lag = self._smoothing_s / elapsed_s
            observer_lag = stream.lag_s / elapsed_s
        state.is_smoothing = True
        assessment = self._monitor.assessment
        is_good = is_settled and bias.tared and not bias.leapt_s
        if not is_good or stream.is_stale or stream.has_turned:
            assessment = self._assess(stream, is_settled=is_settled)
        estimate = wrench.solve(
            residual, state.wrench_filter, smoothing_lag, observer_lag, assessment
        )
        self._estimate_before = state.last
        state.last = estimate
        if bias.request is not None:
            self._continue_tare()
        return estimate

    def _assess(self, stream: SampleStream, *, is_settled: bool) -> Assessment:
        """Return what an estimate says of itself that is not simply a good one."""
        monitor = self._monitor
        offset = self._offset
        warnings = monitor.warnings
        frozen, question = stream.stale_signals()
        if frozen:
            warnings |= SensorWarning.FROZEN
        if stream.has_turned:
            warnings |= SensorWarning.TURN
        if offset.warning:
            warnings |= SensorWarning.TARE_EXPIRED
        if not is_settled:
            status = Status.INITIALIZING
            reason = (
                "the filters have just started, as after a time step longer than "
                "max_gap_s (in seconds, not milliseconds)"
            )
            texts = (reason,)
        elif not offset.memory.tared:
            status = Status.NOT_TARED
            reason = monitor.velocity_fault or offset.warning or self._tare_state
            texts = (reason, frozen, monitor.limit, question)
        else:
            status = Status.OK
            texts = (frozen or question, offset.warning, monitor.message)
        message = "; ".join(filter(None, texts))
        return Assessment(status, message, monitor.mismatch, warnings)

    @property
    def _tare_state(self) -> str:
        """Why there is no tare yet."""
        if self.taring:
            return (
                "a tare is being fitted; until it is, the numbers carry the model's "
                "errors"
            )
        if self.tare_refusal is not None:
            return f"the tare was refused: {self.tare_refusal}"
        return "tare() has not been called"

    def _reject(self, dt_s: float, error: SampleError) -> WrenchEstimate:
        """Return the last valid estimate again; the time of a bad sample passes."""
        state = self._state
        state.rejected += 1
        estimate = state.last
        step_s = as_float(dt_s)
        if estimate is None:
            components = COMPONENTS[self._config.mode]
            estimate = WrenchEstimate.unknown(self._robot.nv, components)
        # A clock that was set back by more, or forward by more than a day, goes on from
        # there.
        elif -self._config.max_gap_s < step_s <= MAX_STEP_S:
            state.missed_s += step_s
        return estimate._replace(
            status=Status.REJECTED,
            message=str(error),
            warnings=estimate.warnings | error.warning,
        )
