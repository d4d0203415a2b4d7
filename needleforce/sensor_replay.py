"""The virtual sensor over a log, sample by sample, as on the robot.

    replay = SensorReplay(robot, config)
    rows = [replay.run(chunk) for chunk in log.parts()]
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
from needleforce.recordings.log import LogRows
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
from residual.tool_kinematics import ToolKinematics
from residual.wrench_estimator import COMPONENTS
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

COLUMNS = (
    "axial_N",
    "axial_std_N",
    "axial_unsmoothed_N",
    "axial_unsmoothed_std_N",
    "model_mismatch",
)
"""Numbers of an estimate that are columns as they are."""

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

    def _take_tare(self, window: TareWindow) -> None:
        """Tare the sensor on what was recorded in a window."""
        window = self._used_part(window)
        if not self._has_settled:
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
        self._first_s = math.nan
        self._latest_s = math.nan
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
        """Time from the first row to the latest [s]."""
        return 0.0 if math.isnan(self._first_s) else self._latest_s - self._first_s

    def run(self, chunk: LogRows) -> ForceRows:
        """Return the estimates of further rows, at least one.

        Raises:
            ReplayError: The log has other joints than the robot, or cannot be tared.
            residual.TareError: The tare is refused.
        """
        self._has_velocity = "dq_rad_s" in chunk.channels
        q_rad = chunk.channels["q_rad"]
        if math.isnan(self._first_s):
            self._start(q_rad, float(chunk.t_s[0]))

        size = 6 if self.config.mode == "full" else 3
        count = len(chunk.t_s)
        numbers = np.full((count, 5), np.nan)
        wrench = np.full((count, size), np.nan)
        torque_Nm = np.zeros((count, 3))
        std = np.full((count, COMPONENTS[self.config.mode]), np.nan)
        state = np.zeros((count, 3), dtype=np.int64)
        steps = zip(chunk.t_s.tolist(), chunk.dt_s.tolist(), strict=True)
        for row, (time_s, dt_s) in enumerate(steps):
            self._tare_if_due(time_s)
            estimate = self._update(chunk, row, dt_s)
            self._keep(estimate)
            state[row, 0] = STATUS_CODES[estimate.status]
            state[row, 1] = int(estimate.warnings)
            if estimate.status is Status.REJECTED:
                torque_Nm[row] = np.nan
                continue

            if self._log_tare is not None:
                self._log_tare.after(time_s, estimate.status)

            elapsed_s = self.sensor.elapsed_s
            self.longest_gap_s = max(self.longest_gap_s, elapsed_s)
            state[row, 2] = elapsed_s > self.config.max_gap_s + ROUNDING_S
            numbers[row] = (
                estimate.axial,
                estimate.axial_std,
                estimate.axial_unsmoothed,
                self.sensor.std_of_bias_N(estimate),
                estimate.model_mismatch,
            )
            wrench[row, :3] = estimate.force
            torque_Nm[row] = estimate.torque if size > 3 else 0.0
            std[row] = np.sqrt(estimate.covariance.diagonal())

        self._latest_s = float(chunk.t_s[-1])
        self.gaps += int(state[:, 2].sum())
        columns = dict(zip(COLUMNS, numbers.T.copy(), strict=True))
        return {
            "t_s": chunk.t_s,
            "travel_m": self._travel.of_rows(q_rad),
            **columns,
            "force_N": wrench[:, :3],
            "torque_Nm": torque_Nm,
            "std": std,
            "force_warnings": state[:, 1],
            "force_status": state[:, 0],
            "after_gap": state[:, 2] > 0,
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
        if log_tare is None or math.isnan(self._first_s):
            return
        try:
            log_tare.finish(self._latest_s, is_whole=is_whole)
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
        self._first_s = first_s

    def _update(self, chunk: LogRows, row: int, dt_s: float) -> WrenchEstimate:
        """Return the sensor's estimate after a sample; it reads no first time step."""
        q_rad = chunk.channels["q_rad"][row]
        if self.is_external:
            torque_Nm = chunk.channels["tau_ext_Nm"][row]
            return self.sensor.update_external_torque(q_rad, None, torque_Nm, dt_s)

        velocities = chunk.channels.get("dq_rad_s")
        dq_rad_s = None if velocities is None else velocities[row]
        return self.sensor.update(q_rad, dq_rad_s, chunk.channels["tau_Nm"][row], dt_s)

    def _keep(self, estimate: WrenchEstimate) -> None:
        """Count a rejection, or keep messages about velocities and doubtful signals."""
        if estimate.status is Status.REJECTED:
            self.rejected[estimate.message.split(";")[0]] += 1
        elif estimate.message and estimate.status is not Status.INITIALIZING:
            if estimate.warnings & SensorWarning.VELOCITY:
                self.velocity_fault = estimate.message
            else:
                self.question = self.sensor.question or self.question
