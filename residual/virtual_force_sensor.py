"""The virtual force/torque sensor: the few calls that a controller makes."""

import math
import numbers

import numpy as np
from numpy.typing import ArrayLike

from residual.errors import SampleError
from residual.external_torque import ExternalTorqueEstimator, TorqueSample
from residual.offset_removal import OffsetRemoval
from residual.sample_check import check_interval, check_joint_vector
from residual.sensor_config import DEFAULT, SensorConfig
from residual.tare import Tare
from residual.wrench import COMPONENTS, Mode, WrenchEstimator
from residual.wrench_estimate import Status, WrenchEstimate
from urdf import Robot


class VirtualForceSensor:
    """Force on the needle from joint signals alone (paper, Section IV).

    Call `update` every tick; move in free air, call `tare`, insert. The wrench is what the
    environment exerts on the tool at its frame, in base axes by default: a weight hung there reads
    as a force down, tissue that pushes back reads as a positive axial force.

    A bad sample (wrong shape, not finite, time not advancing) is not absorbed: the last sound
    estimate comes back with status ``SKIPPED`` and the reason.

    Args:
        robot: The arm with its payload.
        config: Settings; `PAPER` for the method as published.
    """

    _SETTLING = "the filters have just started, or a time step was longer than max_gap_s"

    def __init__(self, robot: Robot, config: SensorConfig = DEFAULT) -> None:
        self._robot, self._config = robot, config
        self._offset = OffsetRemoval(robot, config)
        where = {"frame": config.frame, "insertion_axis": config.insertion_axis}
        self._wrench = WrenchEstimator(
            robot,
            config.mode,
            axes=config.axes,
            weighting=config.weighting,
            expected_force_N=config.expected_force_N,
            **where,
        )
        self._guard = WrenchEstimator(robot, **where)
        self.reset()

    @property
    def tared(self) -> bool:
        """Whether the offset has been removed."""
        return self._offset.tared

    @property
    def lag_s(self) -> float:
        """Time by which the estimate follows the force [s]; 0 before the first sample."""
        return 0.0 if self._torque is None else self._torque.lag_s

    @property
    def skipped(self) -> int:
        """Bad samples since the last `reset`."""
        return self._skipped

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
            The wrench with its uncertainty and status. This method does not raise for a bad
            sample, it says so in the status.
        """
        torque = self._torque
        if torque is None:
            torque = ExternalTorqueEstimator(self._robot, self._config, has_velocity=dq is not None)
        try:
            elapsed_s = self._elapsed(dt_s)
            sample = torque.update(q, dq, tau, elapsed_s)
        except SampleError as error:
            return self._skip(dt_s, str(error))
        self._torque = torque
        return self._finish(sample, elapsed_s)

    def update_external_torque(
        self, q: ArrayLike, external_torque: ArrayLike, dt_s: float
    ) -> WrenchEstimate:
        """Take one sample of an external-torque estimate that the robot supplies itself.

        Args:
            q: Joint positions [rad], shape (n,).
            external_torque: Torque of the environment on the joints [Nm], shape (n,).
            dt_s: Time since the previous call [s].

        Returns:
            As `update`.
        """
        joints = self._robot.nv
        try:
            elapsed_s = self._elapsed(dt_s)
            torque = check_joint_vector("external_torque", external_torque, joints)
            sample = TorqueSample(check_joint_vector("q", q, joints), torque, torque, True)
        except SampleError as error:
            return self._skip(dt_s, str(error))
        return self._finish(sample, elapsed_s)

    def tare(self, *, force: bool = False) -> Tare:
        """Fit the offset to the free motion seen since the start or `start_recording`.

        Call it while the arm rests or from outside the control loop: it takes a few tenths of a
        second. A contact that stands during all of the motion is noticed only if it is larger than
        what the prior lets the model be wrong by (tens of newtons on an LWR).

        Args:
            force: Take it even where contact is seen.

        Returns:
            The fitted tare.

        Raises:
            TareError: Without data, a second time without `start_recording`, or with contact in
                sight; nothing has then changed.
        """
        tare = self._offset.tare(self._guard, force=force)
        self._wrench.set_torque_covariance(self._offset.covariance_Nm2())
        self._slow_axial_N = math.nan
        return tare

    def start_recording(self) -> None:
        """Record free motion anew for the next `tare`; estimates are `NOT_TARED` until then."""
        self._offset.start_recording()

    def reset(self) -> None:
        """Forget everything, the tare included."""
        self._torque: ExternalTorqueEstimator | None = None
        self._offset.reset()
        self._last: WrenchEstimate | None = None
        self._missed_s = 0.0
        self._slow_axial_N = math.nan
        self._skipped = 0

    def _elapsed(self, dt_s: float) -> float:
        """Time since the last sample that was absorbed [s]; 0 for the first one."""
        if self._last is None:
            return 0.0
        check_interval(dt_s)
        return dt_s + self._missed_s

    def _finish(self, sample: TorqueSample, elapsed_s: float) -> WrenchEstimate:
        """Remove the offset, project, and say what the caller should know."""
        self._missed_s = 0.0
        offset = self._offset
        renewed = offset.follow(sample.q, sample.tau, elapsed_s)
        if sample.settled and not offset.tared:
            offset.record(sample.residual, elapsed_s)
        if renewed or self._last is None:
            self._wrench.set_torque_covariance(offset.covariance_Nm2())
        residual = offset.correct(sample.residual)
        residual.setflags(write=False)
        estimate = self._wrench.estimate(sample.q, residual)
        self._last = self._judge(estimate, sample.settled, elapsed_s)
        return self._last

    def _judge(self, estimate: WrenchEstimate, settled: bool, dt_s: float) -> WrenchEstimate:
        """Add what the lag may hide to the standard deviation, and the status."""
        lag_s = self.lag_s
        if math.isnan(self._slow_axial_N):
            self._slow_axial_N = estimate.axial
        behind = estimate.axial - self._slow_axial_N
        if lag_s > 0.0:
            # One more lag of the same length: what it still misses is about what ours missed.
            self._slow_axial_N += behind * -math.expm1(-dt_s / lag_s)
        # Only what stands out of the noise counts as a change that the lag may hide.
        variance = estimate.axial_std**2
        hidden = behind * behind - 4.0 * variance
        std = math.sqrt(variance + hidden) if hidden > 0.0 else estimate.axial_std
        if not settled:
            return estimate._replace(axial_std=std, status=Status.SETTLING, message=self._SETTLING)
        if not self._offset.tared:
            return estimate._replace(
                axial_std=std, status=Status.NOT_TARED, message="tare() has not been called"
            )
        return estimate._replace(axial_std=std) if hidden > 0.0 else estimate

    def _skip(self, dt_s: float, reason: str) -> WrenchEstimate:
        """The last sound estimate again; the time of a bad sample still passes."""
        self._skipped += 1
        if isinstance(dt_s, numbers.Real) and math.isfinite(dt_s) and dt_s > 0.0:
            self._missed_s += float(dt_s)
        last = self._last if self._last is not None else _blank(self._robot.nv, self._config.mode)
        return last._replace(status=Status.SKIPPED, message=reason)


def _blank(joints: int, mode: Mode) -> WrenchEstimate:
    """An estimate that knows nothing, for a first sample that is bad."""
    size = COMPONENTS[mode]
    nothing, residual, share = np.zeros(3), np.zeros(joints), np.zeros(size)
    unknown = np.diag(np.full(size, math.inf))
    for array in (nothing, residual, share, unknown):
        array.setflags(write=False)
    return WrenchEstimate(0.0, math.inf, nothing, nothing, unknown, math.inf, share, residual)
