"""The virtual sensor over a log, sample by sample, as on the robot.

    replay = SensorReplay(robot, config)
    rows = [replay.run(chunk) for chunk in LogStream(tables, request)]
    replay.finish(is_whole=True)

Unlike `session_replay` it needs no insertion, takes its tare from any window of the
log, and keeps what a summary needs, however long the log is.
"""

import math
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from needleforce.recordings.log_stream import LogChunk
from residual import (
    SensorConfig,
    SensorWarning,
    Status,
    TareError,
    VirtualForceSensor,
)
from residual.bias.model import Tare
from residual.checks.input import ROUNDING_S
from residual.estimate import WrenchEstimate
from residual.estimate_rows import (
    AXIAL,
    AXIAL_STD,
    STD_OF_BIAS,
    UNSMOOTHED,
    EstimateRows,
    RowNote,
)
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

AUTOMATIC_TARE_S = 2.0
"""Without a window of the user's, so much from the start of the log is taken for free
motion [s]: whoever records an insertion starts before contact, but not long before."""

OTHER_ROBOT = "Load the robot of the log, or name its columns in the `mapping`."


class ReplayError(NeedleforceError, ValueError):
    """A log that is another robot's, or that cannot be tared where it should."""

    usual_advice = "Name another window of free motion, or go without a tare."


STATUS_CODES = {status: code for code, status in enumerate(Status)}
"""Numbers of the states in files."""

ROWS_AT_A_TIME = 1000
"""So many estimates are in memory at once."""

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


class TareWindow(NamedTuple):
    """A stretch of motion without contact, and its tare once it was taken.

    Attributes:
        start_s: Start on the log's clock [s].
        end_s: End on the log's clock [s].
        note: In brackets, how it differs from the one that was asked for; mostly empty.
        tare: The tare; None before it was taken.
        name: Of the window in messages.
    """

    start_s: float
    end_s: float
    note: str = ""
    tare: Tare | None = None
    name: str = "the tare"

    def __str__(self) -> str:
        return f"{self.start_s:.12g} to {self.end_s:.12g} s"


def describe_rejections(rejected: Counter[str]) -> str:
    """Return how many samples were rejected, and for which reasons; empty if none."""
    common = rejected.most_common(4)
    reasons = [f"{count} x {reason}" for reason, count in common]
    if others := len(rejected) - len(reasons):
        reasons.append(f"{others} other reasons")
    return f"{rejected.total()}: {'; '.join(reasons)}" if reasons else ""


class _LogTare:
    """Starts the tare recording and takes the tare when their times come.

    Args:
        sensor: The sensor that is tared.
        rejected: Reasons for which samples were rejected, counted by the caller.
        first_s: Time of the log's first row [s].
        window: Where it is tared; None for the first free motion.
        ignore_contact: Whether a tare is taken where contact is seen.

    Attributes:
        done: The window whose tare was taken; None before.

    Raises:
        ReplayError: The window lies outside the log.
    """

    def __init__(
        self,
        sensor: VirtualForceSensor,
        rejected: Counter[str],
        first_s: float,
        window: TareWindow | None,
        *,
        ignore_contact: bool,
    ) -> None:
        self.done: TareWindow | None = None
        self._sensor = sensor
        self._first_s = first_s
        self._ignore_contact = ignore_contact
        self._rejected = rejected
        self._rejected_at_start = Counter[str]()
        self._window: TareWindow | None = None
        if window is not None:
            self._require_inside(window, math.inf)
            self._window = window._replace(start_s=max(window.start_s, first_s))
        self._is_asked = window is not None
        self._must_start = self._is_asked
        self._has_settled = False
        self._first_used_s = math.nan
        self._latest_used_s = math.nan

    def before(self, t_s: float) -> None:
        """Start the recording or take the tare, before the sample of this time [s]."""
        window = self._window
        if window is None or self.done is not None:
            return
        if self._must_start and t_s >= window.start_s:
            self._sensor.start_tare_recording()
            self._rejected_at_start = self._rejected.copy()
            self._must_start = False
        if t_s > window.end_s:
            self._take_tare(window)

    def after(self, t_s: float, status: Status) -> None:
        """Note whether the filters have settled, after the sample of this time [s].

        Without a window of the user's, the automatic one begins then.
        """
        if self._must_start or self.done is not None:
            return
        self._latest_used_s = t_s
        if math.isnan(self._first_used_s):
            self._first_used_s = t_s
        if status is not Status.NOT_TARED:
            return
        self._has_settled = True
        if self._window is None:
            self._window = TareWindow(t_s, t_s + AUTOMATIC_TARE_S)

    def finish(self, last_s: float, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log.

        Args:
            last_s: Time of the log's last row [s].
            is_whole: The log was read to its end; one that was broken off may end
                before the window.
        """
        window = self._window
        if self.done is not None:
            return
        if window is not None and last_s >= window.end_s:
            self._take_tare(window)
        elif is_whole:
            if window is not None and self._is_asked:
                self._require_inside(window, last_s)
            self._refuse_saturated()
            raise ReplayError(
                "the log ends before the filters have settled and "
                f"{AUTOMATIC_TARE_S:g} s of free motion were seen, so it cannot be "
                f"tared{self._rejections_since_start}"
            )

    @property
    def _rejections_since_start(self) -> str:
        rejected = self._rejected - self._rejected_at_start
        if not rejected:
            return ""
        advice = ""
        if any(reason.startswith("dq ") for reason in rejected):
            advice = "; without velocities (dq) they are estimated from q"
        return f"; samples were rejected, {describe_rejections(rejected)}{advice}"

    def _require_inside(self, window: TareWindow, last_s: float) -> None:
        """Refuse a window that ends before it starts, or lies outside the log."""
        first = f"{self._first_s:.12g} s"
        if not window.start_s < window.end_s:
            raise ReplayError(
                f"{window.name}: the start must come before the end in a log whose "
                f"first stamp is {first}; or the unit of time is wrong"
            )
        if self._first_s < window.end_s <= last_s and window.start_s < last_s:
            return
        log = f"runs from {first} to {last_s:.12g} s"
        if math.isinf(last_s):
            log = f"starts at {first}"
        raise ReplayError(f"{window.name}: lies outside the log, which {log}")

    def _refuse_saturated(self) -> None:
        """Refuse torques that were beyond their range from the start, if that shows."""
        error = self._sensor.explain_saturation()
        if error is not None:
            count = self._rejected.total()
            text = f"no tare: {count} samples were rejected for torques beyond their"
            raise error.reworded(f"{text} range: {error}")

    def _take_tare(self, window: TareWindow) -> None:
        """Tare the sensor on what was recorded in a window."""
        window = self._used_part(window)
        if not self._has_settled:
            self._refuse_saturated()
            raise ReplayError(
                f"no tare from {window}{window.note}: the filters had not settled by "
                f"then{self._rejections_since_start}"
            )
        try:
            tare = self._sensor.tare(ignore_contact=self._ignore_contact)
        except TareError as error:
            text = f"no tare from {window}{window.note}: {error}"
            raise error.reworded(text) from error
        self.done = window._replace(tare=tare)

    def _used_part(self, window: TareWindow) -> TareWindow:
        """Return the part of a window from which samples were used."""
        max_unused_s = 0.1  # the filters bridge no longer gap
        first_s = self._first_used_s
        latest_s = self._latest_used_s
        part = window
        if first_s > window.start_s + max_unused_s:
            part = part._replace(start_s=first_s)
        if latest_s < window.end_s - max_unused_s:
            part = part._replace(end_s=latest_s)
        if part == window:
            return window
        return part._replace(note=f" (of {window}; the rest has no samples to use)")


def require_joints(q_rad: Array, robot: Robot) -> None:
    """Refuse a log whose channels have another number of joints than the robot.

    Args:
        q_rad: Joint positions of the log, shape (m, n).
        robot: The robot.

    Raises:
        ReplayError: The numbers differ.
    """
    columns = q_rad.shape[1]
    names = robot.joint_names
    if columns != len(names):
        raise ReplayError(
            f"the log has {columns} columns per joint signal, the robot has "
            f"{len(names)} joints: {', '.join(names)}",
            OTHER_ROBOT,
        )


class _SteadyClock:
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

    def update_rows(self, stamps_s: Array, dt_s: Array) -> None:
        """Do for many rows what `update` does for one."""
        times_s = stamps_s + self._shift_s
        is_steady = (dt_s > 0.0).all() and (np.diff(times_s) > 0.0).all()
        if is_steady and times_s[0] > self.latest_s:
            self.latest_s = times_s.item(-1)
            return
        for stamp_s, step_s in zip(stamps_s.tolist(), dt_s.tolist(), strict=True):
            self.update(stamp_s, step_s)


class _ToolTravel:
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
        places_m = np.full((len(q_rad), 3), np.nan)
        axes = np.zeros((len(q_rad), 3, 3))
        place_m, own_axes, _, tip_m, _ = self._tool.needle
        finite = np.flatnonzero(np.isfinite(q_rad).all(axis=1)).tolist()
        for row in finite:
            self._tool.update(q_rad[row])
            places_m[row] = place_m
            axes[row] = own_axes
        positions_m = places_m + axes[:, 0] * tip_m[0]
        positions_m += axes[:, 1] * tip_m[1]
        positions_m += axes[:, 2] * tip_m[2]
        if self._start_m is None and finite:
            self._tool.update(q_rad[finite[0]])
            self._start_m = positions_m[finite[0]].copy()
            self._axis = self._tool.axis_in_base
        if self._start_m is None:
            return positions_m[:, 0]
        # Not a matrix product, whose rounding may depend on how many rows come at a
        # time.
        x, y, z = (positions_m - self._start_m).T * self._axis[:, None]
        return 0.0 + x + y + z


class SensorReplay:
    """The virtual sensor, run over a log of which any number of rows may come at once.

    Args:
        robot: The robot.
        config: Settings of the sensor.
        is_external: The log has the external torque that the robot estimates itself.
        is_tared: Whether a tare is taken.
        find_window: Takes the time of the log's first row [s]; returns where it is
            tared. None: the first `AUTOMATIC_TARE_S` after the filters have settled.
        ignore_contact: Whether the tare is taken where contact is seen.

    Attributes:
        sensor: The sensor.
        robot: Its robot.
        config: Its settings.
        is_external: As given.
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
        self,
        robot: Robot,
        config: SensorConfig,
        *,
        is_external: bool = False,
        is_tared: bool = True,
        find_window: Callable[[float], TareWindow] | None = None,
        ignore_contact: bool = False,
    ) -> None:
        self.sensor = VirtualForceSensor(robot, config)
        self.robot = robot
        self.config = config
        self.is_external = is_external
        self.frame = config.frame if config.frame is not None else robot.tool_frame
        self.tare: TareWindow | None = None
        self.rejected: Counter[str] = Counter()
        self.velocity_fault = ""
        self.question = ""
        self.gaps = 0
        self.longest_gap_s = 0.0
        self.survives_refusal = False
        self.refusal: TareError | None = None
        self._is_tared = is_tared
        self._find_window = find_window
        self._ignore_contact = ignore_contact
        self._has_velocity = False
        self._travel = _ToolTravel(
            ToolKinematics(robot, config.frame, config.insertion_axis)
        )
        self._clock: _SteadyClock | None = None
        self._log_tare: _LogTare | None = None

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
        clock = self._clock
        return 0.0 if clock is None else clock.latest_s - clock.first_s

    def run(self, chunk: LogChunk) -> ForceRows:
        """Return the estimates of further rows, at least one.

        Raises:
            ReplayError: The log has other joints than the robot, or cannot be tared.
            residual.TareError: The tare is refused.
        """
        self._has_velocity = "dq_rad_s" in chunk.channels
        if self._clock is None:
            self._start(chunk.channels["q_rad"], float(chunk.t_s[0]))
        parts: list[ForceRows] = []
        start = 0
        while start < len(chunk.t_s):
            rows = _rows_of(chunk, slice(start, start + ROWS_AT_A_TIME))
            estimates = self._estimate_rows(rows)
            taken = _rows_of(rows, slice(len(estimates.numbers)))
            parts.append(self._columns(taken, estimates))
            start += len(taken.t_s)
        return {
            name: np.concatenate([part[name] for part in parts]) for name in parts[0]
        }

    def _estimate_rows(self, chunk: LogChunk) -> EstimateRows:
        """Return the estimates of a chunk's rows, of those before a tare in it."""
        if self._log_tare is not None and self._log_tare.done is None:
            return self._estimate_until_tare(chunk, self._log_tare)
        q_rad, dq_rad_s, torque_Nm = self._signals(chunk)
        self._running_clock.update_rows(chunk.t_s, chunk.dt_s)
        # It reads no first time step.
        dt_s = np.where(chunk.dt_s > 0.0, chunk.dt_s, 0.0)
        rows = self.sensor.update_rows(
            q_rad, dq_rad_s, torque_Nm, dt_s, is_external=self.is_external
        )
        for note in rows.notes:
            self._keep(note, dt_s.item(note.first_row))
        return rows

    def _estimate_until_tare(self, chunk: LogChunk, log_tare: _LogTare) -> EstimateRows:
        """Return the estimates of a chunk's rows up to the first after a tare."""
        q_rad, dq_rad_s, torque_Nm = self._signals(chunk)
        rows = self.sensor.rows_of_size(len(q_rad))
        steps = zip(chunk.t_s.tolist(), chunk.dt_s.tolist(), strict=True)
        for row, (stamp_s, dt_s) in enumerate(steps):
            time_s = self._running_clock.update(stamp_s, dt_s)
            if dt_s > 0.0:
                self._tare_if_due(time_s)
            velocity = None if dq_rad_s is None else dq_rad_s[row]
            estimate = self._update(q_rad[row], velocity, torque_Nm[row], dt_s)
            self.sensor.put(rows, row, estimate)
            self._keep(rows.notes[-1], dt_s)
            if self._log_tare is None or log_tare.done is not None:
                return rows.first(row + 1)
            if estimate.status is not Status.REJECTED:
                log_tare.after(time_s, estimate.status)
        return rows

    def _signals(self, chunk: LogChunk) -> tuple[Array, Array | None, Array]:
        """Return the channels that the sensor is given: q, dq or None, and torque."""
        q_rad = chunk.channels["q_rad"]
        if self.is_external:
            return q_rad, None, chunk.channels["tau_ext_Nm"]
        return q_rad, chunk.channels.get("dq_rad_s"), chunk.channels["tau_Nm"]

    @property
    def _running_clock(self) -> _SteadyClock:
        assert self._clock is not None, "it runs from the first row on"
        return self._clock

    def _columns(self, chunk: LogChunk, rows: EstimateRows) -> ForceRows:
        """Return rows as columns, NaN where a sample was rejected."""
        after_gap = rows.elapsed_s > self.config.max_gap_s + ROUNDING_S
        self.gaps += np.count_nonzero(after_gap)
        self.longest_gap_s = max(self.longest_gap_s, float(rows.elapsed_s.max()))
        numbers = rows.numbers
        wrench = rows.wrench
        torque_Nm = wrench[:, 3:] if wrench.shape[1] > 3 else np.zeros_like(wrench)
        columns = {
            "travel_m": self._travel.of_rows(chunk.channels["q_rad"]),
            "axial_N": numbers[:, AXIAL].copy(),
            "axial_std_N": numbers[:, AXIAL_STD].copy(),
            "axial_unsmoothed_N": numbers[:, UNSMOOTHED].copy(),
            "axial_unsmoothed_std_N": numbers[:, STD_OF_BIAS].copy(),
            "force_N": wrench[:, :3].copy(),
            "torque_Nm": torque_Nm.copy(),
            "std": np.sqrt(rows.variances),
            "model_mismatch": rows.model_mismatch,
        }
        status = rows.statuses(STATUS_CODES)
        is_rejected = status == STATUS_CODES[Status.REJECTED]
        for name, values in columns.items():
            if name != "travel_m":
                values[is_rejected] = np.nan
        return {
            "t_s": chunk.t_s,
            **columns,
            "force_warnings": rows.warnings,
            "force_status": status,
            "after_gap": after_gap,
        }

    def finish(self, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log.

        Args:
            is_whole: The log was read to its end.

        Raises:
            ReplayError: A whole log has no room for the window.
            residual.TareError: The tare is refused.
        """
        log_tare = self._log_tare
        if log_tare is None or self._clock is None:
            return
        try:
            log_tare.finish(self._clock.latest_s, is_whole=is_whole)
        except TareError as error:
            self._survive(error)
        self.tare = log_tare.done

    def _tare_if_due(self, time_s: float) -> None:
        """Start the recording or take the tare, before the sample of this time [s]."""
        if self._log_tare is None:
            return
        try:
            self._log_tare.before(time_s)
        except TareError as error:
            self._survive(error)
            self._log_tare = None

    def _survive(self, refusal: TareError) -> None:
        """Keep why a tare was refused, or raise it."""
        if not self.survives_refusal:
            raise refusal
        self.refusal = refusal

    def _start(self, q_rad: Array, first_s: float) -> None:
        """Check the joints of the first rows, start the clock, and plan the tare."""
        require_joints(q_rad, self.robot)
        if self._is_tared:
            window = None if self._find_window is None else self._find_window(first_s)
            self._log_tare = _LogTare(
                self.sensor,
                self.rejected,
                first_s,
                window,
                ignore_contact=self._ignore_contact,
            )
        self._clock = _SteadyClock(first_s)

    def _update(
        self, q_rad: Array, dq_rad_s: Array | None, torque_Nm: Array, dt_s: float
    ) -> WrenchEstimate:
        """Return the sensor's estimate after a sample; it reads no first time step."""
        step_s = dt_s if dt_s > 0.0 else 0.0
        if self.is_external:
            return self.sensor.update_external_torque(q_rad, None, torque_Nm, step_s)
        return self.sensor.update(q_rad, dq_rad_s, torque_Nm, step_s)

    def _keep(self, note: RowNote, dt_s: float) -> None:
        """Count a rejection, or keep messages about velocities and doubtful signals.

        Args:
            note: What a row says of itself.
            dt_s: Time since the latest row that advanced.
        """
        status, message, _, warnings = note.assessment
        if status is Status.REJECTED:
            reason = message.split(";")[0] if dt_s > 0.0 else "time does not advance"
            is_new = reason not in self.rejected
            if is_new and len(self.rejected) >= 50:  # of bounded size
                reason = "other reasons"
            self.rejected[reason] += 1
        elif message and status is not Status.INITIALIZING:
            if warnings & SensorWarning.VELOCITY:
                self.velocity_fault = message
            else:
                self.question = note.question or self.question


def _rows_of(chunk: LogChunk, rows: slice) -> LogChunk:
    """Return some rows of a chunk."""
    channels = {name: column[rows] for name, column in chunk.channels.items()}
    return LogChunk(t_s=chunk.t_s[rows], dt_s=chunk.dt_s[rows], channels=channels)
