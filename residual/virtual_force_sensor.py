"""The virtual force/torque sensor: the few calls that a controller makes."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.bias_estimator import BiasEstimator
from residual.bias_model import Tare
from residual.config import DEFAULT, SensorConfig
from residual.consistency_checks import ConsistencyMonitor, SlowState
from residual.errors import SampleError, SnapshotError, SuspectSampleError
from residual.estimate import (
    INITIALIZING,
    NOT_TARED,
    OTHER_KIND,
    Status,
    WrenchEstimate,
    unknown_wrench,
    with_warnings,
)
from residual.external_torque import TorqueSample
from residual.input_validation import SampleClock
from residual.sample_stream import ExternalTorqueStream, JointStream
from residual.snapshot import SensorState, check_belongs, check_form, robot_digest, settings_text
from residual.tool_kinematics import ToolKinematics
from residual.wrench_estimator import COMPONENTS, WrenchEstimator
from urdf import Robot

# What a lag may hide: a force that changes is known less well than one that rests.


class LagUncertainty:
    """Widens a standard deviation by what changes faster than the lag may show.

    One more lag of the same length follows the force: what it still misses is about what the
    estimate has missed. Only what stands out of the noise counts as a change.
    """

    def __init__(self) -> None:
        self.restart()

    def widen(self, axial_N: float, std_N: float, lag_s: float, dt_s: float) -> float:
        """Standard deviation of an axial force with the doubt added [N].

        Args:
            axial_N: The force.
            std_N: Its standard deviation.
            lag_s: By how much it follows the true one; 0 for not at all.
            dt_s: Time since the force before.
        """
        if self._slow_N is None or lag_s <= 0.0:
            self._slow_N = axial_N
            return std_N
        behind = axial_N - self._slow_N
        self._slow_N += behind * -math.expm1(-dt_s / lag_s)
        variance = std_N * std_N
        hidden = behind * behind - 4.0 * variance
        return math.sqrt(variance + hidden) if hidden > 0.0 else std_N

    def restart(self) -> None:
        """Forget the force followed: the next one is a first one."""
        self._slow_N: float | None = None

    @property
    def state(self) -> float | None:
        """The force followed [N]; None before the first."""
        return self._slow_N

    def restore(self, state: float | None) -> None:
        """Go on from a `state` taken earlier."""
        self._slow_N = state


# Tries a state out on a sensor that nobody uses, before one that somebody uses takes it.


TRIED_S = 0.03
"""Time step of a trial: long enough that everything which changes slowly is renewed."""
TRIED = 3


def try_out(
    twin: "VirtualForceSensor", take: Callable[[SensorState], None], state: SensorState
) -> None:
    """Make a damaged state fail now and not in a later update.

    Args:
        twin: A new sensor of the same robot and settings.
        take: Makes the twin go on from a state.
        state: What is to be restored.

    Raises:
        SnapshotError: If the state is damaged.
    """
    try:
        if state.joints is not None and state.external_torque is not None:
            raise SnapshotError("it is of two streams")
        still = np.zeros_like(twin.velocity_rad_s)
        _run(twin, state, still, still, still)
        check_form(state, twin.snapshot())
        take(state)
        torque = still if state.offset.smooth_torque is None else state.offset.smooth_torque
        _run(twin, state, state.offset.q, state.velocity, torque)
    except Exception as error:  # whatever a damaged state makes of its parts
        raise SnapshotError(f"the snapshot is damaged: {error}") from error


def _run(
    twin: "VirtualForceSensor",
    state: SensorState,
    q: NDArray[np.float64],
    dq: NDArray[np.float64],
    torque: NDArray[np.float64],
) -> None:
    """A few samples of the kind that the state is of."""
    for _ in range(TRIED):
        if state.joints is not None:
            given = state.joints.torque.velocity is None
            found = twin.update(q, dq if given else None, torque, TRIED_S)
        elif state.external_torque is not None:
            given = state.external_torque.velocity is None
            found = twin.update_external_torque(q, torque, TRIED_S, dq if given else None)
        else:
            return
        if not np.isfinite((found.axial, found.axial_std, found.model_mismatch)).all():
            raise SnapshotError("its estimates are not finite")


_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick


class VirtualForceSensor:
    """Force on the needle from joint signals alone (paper, Section IV).

    Call `update` every tick; move in free air, call `tare`, insert. The wrench is what the
    environment exerts on the tool at its frame, in base axes by default: a weight hung there reads
    as a force down, tissue that pushes back reads as a positive axial force.

    A bad sample (wrong shape, not finite, time not advancing) is not absorbed: the last sound
    estimate comes back with status ``REJECTED`` and the reason.

    Args:
        robot: The arm with its payload.
        config: Settings; `PUBLISHED` for the method as published.
    """

    def __init__(self, robot: Robot, config: SensorConfig = DEFAULT) -> None:
        self._robot, self._config = robot, config
        self._digest = robot_digest(robot)
        JointStream(robot, config, has_velocity=True)  # refuses what does not fit the robot now
        self._offset = BiasEstimator(robot, config)
        where = {"frame": config.frame, "insertion_axis": config.insertion_axis}
        self._wrench = WrenchEstimator(
            robot,
            config.mode,
            axes=config.axes,
            weighting=config.weighting,
            expected_force_N=config.expected_force_N,
            **where,
        )
        self._contact = WrenchEstimator(robot, **where)
        self._slow, self._doubt = ConsistencyMonitor(robot, self._wrench), LagUncertainty()
        self.reset()

    @property
    def tared(self) -> bool:
        """Whether the offset has been removed."""
        return self._offset.tared

    @property
    def lag_s(self) -> float:
        """Time by which the estimate follows the force [s]; 0 before the first sample.

        It is 0 for external torques of the robot itself too: their lag is not known here.
        """
        return self._lag_s

    @property
    def elapsed_s(self) -> float:
        """Time between the last two samples that were absorbed [s]; 0 for the first."""
        return self._elapsed_s

    @property
    def skipped(self) -> int:
        """Bad samples since the last `reset`."""
        return self._skipped

    @property
    def kinematics(self) -> ToolKinematics:
        """Pose and Jacobian of the tool at the last sample that was absorbed."""
        return self._wrench.kinematics

    @property
    def velocity_rad_s(self) -> NDArray[np.float64]:
        """Joint velocity of that sample, given or estimated, shape (n,): not to be written."""
        return self._velocity

    def recheck(self, last: WrenchEstimate) -> WrenchEstimate:
        """The last estimate, its `SensorWarning.MODEL_MISMATCH` raised if this sample misfits."""
        return self._slow.recheck(last)

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, tau: ArrayLike, dt_s: float
    ) -> WrenchEstimate:
        """Take one sample of joint signals.

        Args:
            q: Joint positions [rad], shape (n,).
            dq: Joint velocities [rad/s], shape (n,); None, always, for a robot that sends none.
            tau: Measured link-side joint torques [Nm], shape (n,).
            dt_s: Time since the previous call [s]; not read on the first one.

        Returns:
            The wrench with its uncertainty and status. A bad sample is told there, not raised.
        """
        return self._absorb(JointStream, q, dq, tau, dt_s)

    def update_external_torque(
        self, q: ArrayLike, external_torque: ArrayLike, dt_s: float, dq: ArrayLike | None = None
    ) -> WrenchEstimate:
        """Take one sample of an external-torque estimate that the robot supplies itself.

        Args:
            q: Joint positions [rad], shape (n,).
            external_torque: Torque of the environment on the joints [Nm], shape (n,).
            dt_s: Time since the previous call [s].
            dq: Joint velocities [rad/s], shape (n,); None, always, to have them estimated from
                positions, which are then as late as they are. Forces do not depend on them.

        Returns:
            As `update`.
        """
        return self._absorb(ExternalTorqueStream, q, dq, external_torque, dt_s)

    def tare(self, *, force: bool = False) -> Tare:
        """Fit the offset to the free motion seen since the start or `start_tare_recording`.

        Call it while the arm rests or from outside the control loop: it takes a few tenths of a
        second. A contact that stands during all of the motion is noticed only if it is larger than
        what the prior lets the model be wrong by (tens of newtons on an LWR).

        Args:
            force: Take it even where contact is seen, or velocities that do not fit positions.

        Returns:
            The fitted tare.

        Raises:
            TareError: Without data, a second time without `start_tare_recording`, with contact in
                sight or velocities that do not fit positions; nothing has then changed.
        """
        self._slow.check_velocity(force=force)
        tare = self._offset.tare(self._contact, force=force)
        self._wrench.set_torque_covariance(self._offset.covariance_Nm2())
        self._wrench.weigh()
        self._doubt.restart()
        return tare

    def start_tare_recording(self) -> None:
        """Record free motion anew for the next `tare`; estimates are `NOT_TARED` until then.

        The next sample may be of the other kind of torque: everything then starts anew.
        """
        self._offset.start_tare_recording()
        self._slow.forget_velocity()

    def reset(self) -> None:
        """Forget everything, the tare included."""
        self._stream: JointStream | ExternalTorqueStream | None = None
        self._lag_s = self._elapsed_s = self._looked_s = 0.0
        self._offset.reset()
        self._slow.restore(SlowState())
        self._doubt.restart()
        self._velocity = np.zeros(self._robot.nv)
        self._last: WrenchEstimate | None = None
        self._clock = SampleClock(self._config.max_gap_s)
        self._skipped = 0

    def snapshot(self) -> SensorState:
        """All that the sensor remembers; immutable. `insertion.write_snapshot` stores it."""
        stream = self._stream
        return SensorState(
            robot=self._digest,
            config=settings_text(self._config, self._robot.nv),
            joints=stream.state if isinstance(stream, JointStream) else None,
            external_torque=stream.state if isinstance(stream, ExternalTorqueStream) else None,
            lag_s=self._lag_s,
            offset=self._offset.state,
            torque_covariance=self._wrench.torque_covariance,
            weights=self._wrench.weights,
            slow=self._slow.state,
            doubt=self._doubt.state,
            looked_s=self._looked_s,
            velocity=self._velocity,
            last=self._last,
            missed_s=self._clock.missed_s,
            skipped=self._skipped,
        )

    def restore(self, state: SensorState) -> None:
        """Go on, bit for bit, from where `snapshot` was taken.

        Raises:
            SnapshotError: Not a snapshot of such a sensor, a damaged one, or one of another robot
                or other settings; nothing has then changed.
        """
        check_belongs(state, self._digest, settings_text(self._config, self._robot.nv))
        twin = type(self)(self._robot, self._config)
        try_out(twin, twin._take, state)
        self._take(state)

    def _take(self, state: SensorState) -> None:
        self.reset()
        if state.joints is not None:
            given = state.joints.torque.velocity is None
            self._stream = JointStream(self._robot, self._config, has_velocity=given)
            self._stream.restore(state.joints)
        if state.external_torque is not None:
            given = state.external_torque.velocity is None
            self._stream = ExternalTorqueStream(self._robot, self._config, has_velocity=given)
            self._stream.restore(state.external_torque)
        self._offset.restore(state.offset)
        self._wrench.set_torque_covariance(state.torque_covariance)
        self._wrench.restore(state.weights)
        self._slow.restore(state.slow)
        self._doubt.restore(state.doubt)
        self._lag_s, self._looked_s, self._velocity = state.lag_s, state.looked_s, state.velocity
        self._last, self._skipped = state.last, state.skipped
        self._clock.missed_s = state.missed_s
        if state.last is not None:
            self.kinematics.update(self._offset.q)

    def _absorb(
        self,
        kind: type[JointStream] | type[ExternalTorqueStream],
        q: ArrayLike,
        dq: ArrayLike | None,
        torque: ArrayLike,
        dt_s: float,
    ) -> WrenchEstimate:
        """One sample of either kind, or why it was not absorbed."""
        stream = self._stream
        try:
            if stream is None or type(stream) is not kind:
                if stream is not None and not self._offset.is_fresh:
                    raise SampleError(OTHER_KIND)
                stream = kind(self._robot, self._config, has_velocity=dq is not None)
            elapsed_s = 0.0 if self._last is None else self._clock.elapsed(dt_s)
            sample = stream.update(q, dq, torque, elapsed_s)
        except SampleError as error:
            return self._skip(dt_s, error)
        if stream is not self._stream:
            self._stream = stream
            self._offset.reset()
            self._slow.restore(SlowState())
            self._doubt.restart()
        return self._finish(sample, stream, elapsed_s)

    def _finish(
        self, sample: TorqueSample, stream: JointStream | ExternalTorqueStream, elapsed_s: float
    ) -> WrenchEstimate:
        """Remove the offset, project, and say what the caller should know."""
        q, self._velocity, tau, residual, settled, data = sample
        self._clock.missed_s = 0.0
        self._elapsed_s, self._lag_s = elapsed_s, stream.lag_s
        offset, wrench, slow = self._offset, self._wrench, self._slow
        renewed, tared = offset.follow(q, tau, elapsed_s), offset.tared
        if settled and not tared:
            offset.record(residual, elapsed_s)
        wrench.kinematics.update(q, data)
        if renewed:
            wrench.set_torque_covariance(offset.covariance_Nm2())
            wrench.weigh()
        numbers = wrench.solve(residual, offset.offset_Nm)
        self._looked_s += elapsed_s
        if renewed:
            dq = self._velocity if stream.has_velocity else None
            slow.look(q, dq, numbers[-1], self._looked_s, tared=tared)
            self._looked_s = 0.0
        std = self._doubt.widen(numbers[0], numbers[1], stream.lag_s, elapsed_s)
        status, message, warnings = Status.OK, slow.message, slow.warnings
        if stream.warning or offset.warning:
            warnings, message = with_warnings(warnings, message, stream.warning, offset.warning)
        if not settled:
            status, message = Status.INITIALIZING, INITIALIZING
        elif not tared:
            status, message = Status.NOT_TARED, slow.velocity_fault or offset.warning or NOT_TARED
        told = (status, message, slow.model_mismatch, warnings)
        self._last = last = _new(WrenchEstimate, (numbers[0], std, *numbers[2:], *told))
        return last

    def _skip(self, dt_s: float, error: SampleError) -> WrenchEstimate:
        """The last sound estimate again; the time of a bad sample still passes."""
        self._skipped += 1
        last = self._last
        if last is None:
            last = unknown_wrench(self._robot.nv, COMPONENTS[self._config.mode])
        else:
            self._clock.miss(dt_s)
        warnings = last.warnings
        if isinstance(error, SuspectSampleError):
            warnings |= error.caution
        return last._replace(status=Status.REJECTED, message=str(error), warnings=warnings)
