"""The virtual sensor over a log, sample by sample, as on the robot."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.cli.logs.tare_schedule import TareSchedule, TareWindow
from needleforce.cli.shared_options import SensorOptions
from needleforce.cli.terminal import OTHER_ROBOT, CommandError
from needleforce.recordings.log_stream import LogChunk
from residual import (
    SensorConfig,
    SensorWarning,
    Status,
    TareError,
    VirtualForceSensor,
)
from residual.checks.input import ROUNDING_S
from residual.estimate import WrenchEstimate
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

STATUS_CODES = {status: code for code, status in enumerate(Status)}
"""Numbers of the states in files."""

ROWS_AT_A_TIME = 1000
"""So many estimates are in memory at once."""

MAX_REASONS = 50
"""Different reasons of rejection that are counted; the others are counted together."""

ForceRows = dict[str, NDArray]
"""Estimates of the rows of a log, by column; numbers are NaN where a row was rejected.

- `t_s`: time stamp as in the log [s], shape (n,).
- `travel_m`: travel of the tool along the needle [m], shape (n,).
- `axial_N`, `axial_std_N`, `axial_unsmoothed_N`: force along the needle [N], (n,).
- `axial_unsmoothed_std_N`: `axial_std_N` without the error of the torques' scale, for
  the identification [N], (n,).
- `force_N`, `torque_Nm`: force and torque on the tool [N, Nm], shape (n, 3).
- `std`: standard deviations of the components that the mode estimates [N, Nm], shape
  (n, 1), (n, 3) or (n, 6).
- `model_mismatch`, `force_warnings`: see `residual.WrenchEstimate`, shape (n,).
- `force_status`: one of `STATUS_CODES`, shape (n,).
- `after_gap`: whether the filters restarted after a gap in time, shape (n,).
"""


def has_status(rows: ForceRows, status: Status) -> NDArray[np.bool_]:
    """Return which rows have a status, shape (n,)."""
    return rows["force_status"] == STATUS_CODES[status]


def require_joints(q_rad: Array, robot: Robot) -> None:
    """Refuse a log whose channels have another number of joints than the robot.

    Args:
        q_rad: Joint positions of the log, shape (m, n).
        robot: The robot that the options describe.

    Raises:
        CommandError: The numbers differ.
    """
    columns = q_rad.shape[1]
    names = robot.joint_names
    if columns != len(names):
        raise CommandError(
            f"the log has {columns} columns per joint signal, the robot has "
            f"{len(names)} joints: {', '.join(names)}",
            OTHER_ROBOT,
        )


class SteadyClock:
    """A clock that runs on when the log's clock is set back.

    Attributes:
        first_s: Time of the first row [s].
        latest_s: Time of the latest row that advanced [s].
    """

    def __init__(self, first_s: float) -> None:
        self.first_s = first_s
        self.latest_s = -math.inf
        self._shift_s = 0.0

    def update(self, stamp_s: float, dt_s: float) -> float:
        """Return the time of a row on this clock [s].

        Args:
            stamp_s: Time stamp of the row [s].
            dt_s: Time since the latest row that advanced, zero or less for a row that
                does not advance [s].
        """
        time_s = stamp_s + self._shift_s
        if not dt_s > 0.0:
            return time_s
        if time_s <= self.latest_s:
            self._shift_s += self.latest_s + dt_s - time_s
            time_s = self.latest_s + dt_s
        self.latest_s = time_s
        return time_s


class ToolTravel:
    """Travel of the tool along the insertion axis as it stood in the first finite row.

    Args:
        tool: Kinematics of the tool, which are updated.
    """

    def __init__(self, tool: ToolKinematics) -> None:
        self._tool = tool
        self._start_m: Array | None = None
        self._axis = tool.axis_in_base

    def of_rows(self, q_rad: Array) -> Array:
        """Return the travel at joint positions of shape (m, n) [m], shape (m,)."""
        positions_m = np.full((len(q_rad), 3), np.nan)
        for row in np.flatnonzero(np.isfinite(q_rad).all(axis=1)).tolist():
            self._tool.update(q_rad[row])
            positions_m[row] = self._tool.pose[:3, 3]
            if self._start_m is None:
                self._start_m = positions_m[row].copy()
                self._axis = self._tool.pose[:3, :3].dot(self._tool.axis_in_tool)
        if self._start_m is None:
            return positions_m[:, 0]
        # Not a matrix product, whose rounding may depend on how many rows come at a
        # time.
        x, y, z = (positions_m - self._start_m).T * self._axis[:, None]
        return 0.0 + x + y + z


class SensorReplay:
    """The virtual sensor, run over a log of which any number of rows may come at once.

    Attributes:
        sensor: The sensor.
        robot: Its robot.
        config: Its settings.
        is_external: The log has the external torque that the robot estimates itself.
        frame: Link at which forces are estimated.
        tare: The tare that was taken; None before `finish`, or without one.
        rejected: How many samples were rejected, by reason.
        velocity_fault: Latest message about velocities that are no rates, or empty.
        question: Latest message about signals that may be missing or in degrees.
        gaps: Gaps in time after which the filters restarted.
        longest_gap_s: The longest time between two valid samples [s].
        survives_refusal: Whether a refused tare is kept in ``refusal``, and the log
            read on; it is raised otherwise.
        refusal: Why the tare was refused; None if it was not.
    """

    def __init__(
        self, robot: Robot, config: SensorConfig, options: SensorOptions
    ) -> None:
        self.sensor = VirtualForceSensor(robot, config)
        self.robot = robot
        self.config = config
        self.is_external = options.external_torque
        self.frame = config.frame if config.frame is not None else robot.tool_frame
        self.tare: TareWindow | None = None
        self.rejected: Counter[str] = Counter()
        self.velocity_fault = ""
        self.question = ""
        self.gaps = 0
        self.longest_gap_s = 0.0
        self.survives_refusal = False
        self.refusal: TareError | None = None
        self._options = options
        self._has_velocity = False
        self._travel = ToolTravel(
            ToolKinematics(robot, config.frame, config.insertion_axis)
        )
        self._schedule: TareSchedule | None = None
        self._clock = SteadyClock(0.0)

    @property
    def description(self) -> str:
        """What is estimated from what, in words."""
        config = self.config
        estimated = "wrench" if config.mode == "full" else f"{config.mode} force"
        estimated = f"{estimated} at {self.frame}"
        if self.is_external:
            return f"{estimated}, from the robot's own external torque"
        origin = "from the log" if self._has_velocity else "estimated"
        gain = f"K = {config.slowest_gain_per_s:g} 1/s"
        return f"{estimated}, {gain}, velocity {origin}"

    @property
    def duration_s(self) -> float:
        """Time from the first row to the latest [s], on a clock never set back."""
        return self._clock.latest_s - self._clock.first_s

    def run(self, chunk: LogChunk) -> ForceRows:
        """Return the estimates of further rows, at least one.

        Raises:
            CommandError: The log has other joints than the robot, or the tare fails.
        """
        # An estimate is an object of some kilobytes: few are kept at a time.
        parts = [
            self._run_rows(_rows_of(chunk, slice(start, start + ROWS_AT_A_TIME)))
            for start in range(0, len(chunk.t_s), ROWS_AT_A_TIME)
        ]
        return {
            name: np.concatenate([part[name] for part in parts]) for name in parts[0]
        }

    def _run_rows(self, chunk: LogChunk) -> ForceRows:
        """Return the estimates of further rows, all at once."""
        q_rad = chunk.channels["q_rad"]
        dq_rad_s = chunk.channels.get("dq_rad_s")
        torque_Nm = chunk.channels["tau_ext_Nm" if self.is_external else "tau_Nm"]
        self._has_velocity = dq_rad_s is not None
        if self._schedule is None:
            self._schedule = self._start(q_rad, float(chunk.t_s[0]))
        estimates: list[WrenchEstimate] = []
        elapsed_s: list[float] = []
        std_of_bias_N: list[float] = []
        steps = zip(chunk.t_s.tolist(), chunk.dt_s.tolist(), strict=True)
        for row, (stamp_s, dt_s) in enumerate(steps):
            time_s = self._clock.update(stamp_s, dt_s)
            advances = dt_s > 0.0
            if advances:
                self._tare_if_due(time_s)
            velocity = None if dq_rad_s is None else dq_rad_s[row]
            estimate = self._update(q_rad[row], velocity, torque_Nm[row], dt_s)
            estimates.append(estimate)
            std_of_bias_N.append(self.sensor.std_of_bias_N(estimate))
            if estimate.status is Status.REJECTED:
                elapsed_s.append(0.0)
                self._count_rejection(estimate, advances=advances)
            else:
                elapsed_s.append(self.sensor.elapsed_s)
                self._schedule.after(time_s, estimate.status)
                self._keep_messages(estimate)
        after_gap = np.array(elapsed_s) > self.config.max_gap_s + ROUNDING_S
        self.gaps += np.count_nonzero(after_gap)
        self.longest_gap_s = max(self.longest_gap_s, *elapsed_s)
        return {
            "t_s": chunk.t_s,
            "travel_m": self._travel.of_rows(q_rad),
            **_columns(estimates, std_of_bias_N),
            "after_gap": after_gap,
        }

    def _go_on_without_tare(self, refusal: TareError, first_s: float) -> None:
        """Keep the reason of a refused tare, and plan no other."""
        self.refusal = refusal
        options = replace(self._options, no_tare=True, tare=None)
        self._schedule = TareSchedule(self.sensor, self.rejected, options, first_s)

    def finish(self, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log.

        Args:
            is_whole: The log was read to its end.

        Raises:
            CommandError: The tare fails, or a whole log has no room for its window.
        """
        if self._schedule is not None:
            try:
                self._schedule.finish(self._clock.latest_s, is_whole=is_whole)
            except TareError as error:
                if not self.survives_refusal:
                    raise
                self.refusal = error
            self.tare = self._schedule.done

    def _tare_if_due(self, time_s: float) -> None:
        """Start the recording or take the tare, before the sample of this time [s]."""
        if self._schedule is None:
            return
        try:
            self._schedule.before(time_s)
        except TareError as error:
            if not self.survives_refusal:
                raise
            self._go_on_without_tare(error, self._clock.first_s)

    def _start(self, q_rad: Array, first_s: float) -> TareSchedule:
        """Check the joints of the first rows, start the clock, and plan the tare."""
        require_joints(q_rad, self.robot)
        self._clock = SteadyClock(first_s)
        return TareSchedule(self.sensor, self.rejected, self._options, first_s)

    def _update(
        self, q_rad: Array, dq_rad_s: Array | None, torque_Nm: Array, dt_s: float
    ) -> WrenchEstimate:
        """Return the sensor's estimate after a sample; it reads no first time step."""
        step_s = dt_s if dt_s > 0.0 else 0.0
        if self.is_external:
            return self.sensor.update_external_torque(q_rad, None, torque_Nm, step_s)
        return self.sensor.update(q_rad, dq_rad_s, torque_Nm, step_s)

    def _count_rejection(self, estimate: WrenchEstimate, *, advances: bool) -> None:
        """Count a rejected sample under its reason, the part before a semicolon."""
        reason = "time does not advance"
        if advances:
            reason = estimate.message.split(";")[0]
        if reason not in self.rejected and len(self.rejected) >= MAX_REASONS:
            reason = "other reasons"
        self.rejected[reason] += 1

    def _keep_messages(self, estimate: WrenchEstimate) -> None:
        """Keep the latest messages about velocities and doubtful signals."""
        if not estimate.message or estimate.status is Status.INITIALIZING:
            return
        if estimate.warnings & SensorWarning.VELOCITY:
            self.velocity_fault = estimate.message
        else:
            self.question = self.sensor.question or self.question


def _rows_of(chunk: LogChunk, rows: slice) -> LogChunk:
    """Return some rows of a chunk."""
    channels = {name: column[rows] for name, column in chunk.channels.items()}
    return LogChunk(t_s=chunk.t_s[rows], dt_s=chunk.dt_s[rows], channels=channels)


_FIELD_OF_COLUMN = {
    "axial_N": "axial",
    "axial_std_N": "axial_std",
    "axial_unsmoothed_N": "axial_unsmoothed",
    "force_N": "force",
    "torque_Nm": "torque",
    "model_mismatch": "model_mismatch",
}
"""Fields of `residual.WrenchEstimate` that are columns as they are."""


def _columns(
    estimates: Sequence[WrenchEstimate], std_of_bias_N: Sequence[float]
) -> ForceRows:
    """Return estimates as columns, NaN where a sample was rejected.

    Args:
        estimates: Of each row.
        std_of_bias_N: Standard deviation for the identification, of each row.
    """
    columns = {
        name: np.array([getattr(estimate, field) for estimate in estimates])
        for name, field in _FIELD_OF_COLUMN.items()
    }
    covariances = np.array([estimate.covariance for estimate in estimates])
    columns["axial_unsmoothed_std_N"] = np.array(std_of_bias_N)
    columns["std"] = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    status = np.array([STATUS_CODES[estimate.status] for estimate in estimates])
    for values in columns.values():
        values[status == STATUS_CODES[Status.REJECTED]] = np.nan
    warnings = np.array([int(estimate.warnings) for estimate in estimates])
    return {**columns, "force_warnings": warnings, "force_status": status}
