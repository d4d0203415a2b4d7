"""The virtual sensor over a log, sample by sample, as it would have run on the robot."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from residual.command.force_rows import STATUS_CODES, ForceRows
from residual.command.joint_signals import JointSignals
from residual.command.taring import TareDone, TareRequest, Taring
from residual.command.tip_travel import TipTravel
from residual.sensor_config import SensorConfig
from residual.virtual_force_sensor import VirtualForceSensor
from residual.wrench_estimate import Caution, Status, WrenchEstimate
from urdf import Robot

OTHER_REASONS = "other reasons"
"""What skipped rows are counted under when there are too many reasons to list."""

_MOST_REASONS = 50


class Replay:
    """Runs the sensor over a log, of which any number of rows may come at a time.

    Args:
        robot: The arm with its payload.
        config: Settings of the sensor.
        request: Where to tare.

    Raises:
        residual.ConfigurationError: A setting is not valid.
        urdf.UrdfError: The configured frame is not on the robot.
    """

    def __init__(self, robot: Robot, config: SensorConfig, request: TareRequest) -> None:
        self._sensor = VirtualForceSensor(robot, config)
        self._request, self._max_gap_s = request, config.max_gap_s
        self._travel = TipTravel(robot, config)
        self._taring: Taring | None = None
        # Of the clock of the first rows, which runs on when the log's clock is set back.
        self._latest_s, self._taken_s, self._shift_s = -math.inf, 0.0, 0.0
        self.skipped: Counter[str] = Counter()
        """Reasons for skipped rows."""
        self.velocity_fault = ""
        """What was told last of rows with wrong velocities; empty if there were none."""
        self.gaps = 0
        """Gaps in time after which the filters started anew."""
        self.longest_gap_s = 0.0

    @property
    def lag_s(self) -> float:
        """Time by which the estimate follows the force [s]."""
        return self._sensor.lag_s

    @property
    def tare(self) -> TareDone | None:
        """The tare, if one was taken."""
        return None if self._taring is None else self._taring.done

    def run(self, signals: JointSignals) -> ForceRows:
        """Return the estimates of further rows.

        Args:
            signals: At least one row.

        Raises:
            CommandError: The tare does not suit the log, or is refused.
        """
        t_s = signals.t_s.tolist()
        taring = self._taring
        if taring is None:
            taring = self._taring = Taring(self._sensor, self._request, t_s[0])
            self._taken_s = t_s[0]
        estimates, gaps = [], []
        for k, (stamp_s, dt_s) in enumerate(zip(t_s, signals.dt_s.tolist(), strict=True)):
            now_s, advances = self._running_s(stamp_s, dt_s), dt_s > 0.0
            if advances:
                taring.before(now_s)
            # The sensor reads no time step of the first sample.
            estimate = self._feed(signals, k, dt_s if advances else 0.0)
            estimates.append(estimate)
            if estimate.status is Status.SKIPPED:
                self._count(estimate.message if advances else "time does not advance")
                gaps.append(False)
            else:
                taring.after(now_s, estimate.status)
                if estimate.cautions & Caution.VELOCITY and estimate.status is not Status.SETTLING:
                    self.velocity_fault = estimate.message
                gaps.append(self._has_gap(now_s))
        return _rows(signals, self._travel(signals.q_rad), estimates, gaps)

    def finish(self, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log.

        Args:
            is_whole: Whether the log was read to its end.

        Raises:
            CommandError: It is refused, or the log is too short for it.
        """
        if self._taring is not None:
            self._taring.finish(self._latest_s, is_whole=is_whole)

    def _running_s(self, stamp_s: float, dt_s: float) -> float:
        """Return the time of a row [s] on a clock that never goes back."""
        now_s = stamp_s + self._shift_s
        if dt_s > 0.0:
            if now_s <= self._latest_s:
                self._shift_s += self._latest_s + dt_s - now_s
                now_s = self._latest_s + dt_s
            self._latest_s = now_s
        return now_s

    def _feed(self, signals: JointSignals, k: int, dt_s: float) -> WrenchEstimate:
        """Give one row to the sensor, by the call that fits it."""
        q, torque = signals.q_rad[k], signals.torque_Nm[k]
        if signals.is_external:
            return self._sensor.update_external_torque(q, torque, dt_s)
        dq = None if signals.dq_rad_s is None else signals.dq_rad_s[k]
        return self._sensor.update(q, dq, torque, dt_s)

    def _count(self, message: str) -> None:
        reason = message.split(";")[0]
        is_known = reason in self.skipped or len(self.skipped) < _MOST_REASONS
        self.skipped[reason if is_known else OTHER_REASONS] += 1

    def _has_gap(self, now_s: float) -> bool:
        gap_s, self._taken_s = now_s - self._taken_s, now_s
        if gap_s <= self._max_gap_s:
            return False
        self.gaps += 1
        self.longest_gap_s = max(self.longest_gap_s, gap_s)
        return True


def _rows(
    signals: JointSignals,
    travel_m: NDArray[np.float64],
    estimates: Sequence[WrenchEstimate],
    gaps: Sequence[bool],
) -> ForceRows:
    covariances = np.array([estimate.covariance for estimate in estimates])
    rows = ForceRows(
        t_s=signals.t_s,
        travel_m=travel_m,
        axial_N=np.array([estimate.axial for estimate in estimates]),
        axial_std_N=np.array([estimate.axial_std for estimate in estimates]),
        force_N=np.array([estimate.force for estimate in estimates]),
        torque_Nm=np.array([estimate.torque for estimate in estimates]),
        std=np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)),
        misfit=np.array([estimate.misfit for estimate in estimates]),
        cautions=np.array([int(estimate.cautions) for estimate in estimates]),
        status=np.array([STATUS_CODES[estimate.status] for estimate in estimates]),
        after_gap=np.array(gaps),
    )
    skipped = rows.has_status(Status.SKIPPED)
    if skipped.any():
        numbers = (rows.axial_N, rows.axial_std_N, rows.force_N, rows.torque_Nm, rows.std)
        for values in (*numbers, rows.misfit):
            values[skipped] = np.nan
    return rows
