"""The virtual sensor over a log, sample by sample, as on the robot.

    log = read_log("insertion.csv", required=["q", "tau"], optional=["dq"])
    forces = replay_sensor(log, robot, config, window=TareWindow(0.0, 13.0))
    forces.rows["axial_N"]

Unlike `session_replay` it needs no insertion, and takes its tare from any window of the
log.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from needleforce.recordings import Log
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

STATUS_CODES = {status: code for code, status in enumerate(Status)}
"""Numbers of the states in files."""


class ReplayError(NeedleforceError, ValueError):
    """A log that is another robot's, or that cannot be tared where it should."""


class TareWindow(NamedTuple):
    """A stretch of motion without contact.

    Attributes:
        start_s: Start on the log's clock [s].
        end_s: End on the log's clock [s].
    """

    start_s: float
    end_s: float

    def __str__(self) -> str:
        return f"{self.start_s:.12g} to {self.end_s:.12g} s"


def describe_rejections(rejected: Counter[str]) -> str:
    """Return how many samples were rejected, and for which reasons; empty if none."""
    reasons = "; ".join(f"{count} x {text}" for text, count in rejected.most_common(4))
    return f"{rejected.total()}: {reasons}" if reasons else ""


@dataclass(frozen=True, slots=True, eq=False)
class SensorReplay:
    """What the sensor has estimated of a log.

    Attributes:
        rows: One row per row of the log; numbers are NaN where it was rejected. Columns
            have their unit in the name: `t_s`, `travel_m` (of the tool along the
            needle), `axial_N` and its deviation, force and torque in the axes of the
            config with theirs, `axial_unsmoothed_N` and its deviation without the error
            of the torques' scale (for the identification), `model_mismatch`,
            `force_warnings`, `force_status` (one of `STATUS_CODES`); and `after_gap`,
            whether the filters restarted after a gap in time.
        sensor: The sensor as it is after the last row.
        config: Its settings.
        window: Where it was tared; None without a tare.
        tare: The tare; None without.
        rejected: How many samples were rejected, by reason.
        doubts: The latest message about velocities that are no rates, and the latest
            about signals that may be missing or in degrees, if there were any.
        longest_gap_s: The longest time between two valid samples [s].
    """

    rows: pd.DataFrame
    sensor: VirtualForceSensor
    config: SensorConfig
    window: TareWindow | None
    tare: Tare | None
    rejected: Counter[str]
    doubts: tuple[str, ...]
    longest_gap_s: float


class _LogTare:
    """Starts the tare recording and takes the tare when their times come.

    Args:
        sensor: The sensor that is tared.
        rejected: Reasons for which samples were rejected, counted by the caller.
        window: Where it is tared; None for the first free motion.
        first_s: Time of the log's first row [s].
        ignore_contact: Whether a tare is taken where contact is seen.

    Attributes:
        window: Where it is tared.
        tare: The tare; None before it was taken.
        is_wanted: Whether one is taken at all.
    """

    def __init__(
        self,
        sensor: VirtualForceSensor,
        rejected: Counter[str],
        window: TareWindow | None,
        first_s: float,
        ignore_contact: bool,
    ) -> None:
        self.window = TareWindow(first_s, np.inf)
        self.tare: Tare | None = None
        self.is_wanted = True
        self._sensor = sensor
        self._rejected = rejected
        self._ignore_contact = ignore_contact
        self._must_start = window is not None
        if window is not None:
            self.window = window._replace(start_s=max(window.start_s, first_s))

    def before(self, time_s: float) -> None:
        """Start the recording or take the tare, before the sample of this time [s]."""
        if not self.is_wanted or self.tare is not None:
            return
        if self._must_start and time_s >= self.window.start_s:
            self._sensor.start_tare_recording()
            self._must_start = False
        if time_s > self.window.end_s:
            self._take()

    def after(self, time_s: float, status: Status) -> None:
        """Begin the automatic window once the filters have settled."""
        if status is Status.NOT_TARED and self.window.end_s == np.inf:
            self.window = TareWindow(time_s, time_s + AUTOMATIC_TARE_S)

    def finish(self, last_s: float) -> None:
        """Take a tare whose window ends with the log, at this time [s]."""
        if not self.is_wanted or self.tare is not None:
            return
        if last_s < self.window.end_s:
            raise ReplayError(
                "the log ends before the filters have settled and "
                f"{AUTOMATIC_TARE_S:g} s of free motion were seen, so it cannot be "
                f"tared{self._rejections}"
            )
        self._take()

    def _take(self) -> None:
        try:
            self.tare = self._sensor.tare(ignore_contact=self._ignore_contact)
        except TareError as error:
            text = f"no tare from {self.window}: {error}{self._rejections}"
            raise error.reworded(text) from error

    @property
    def _rejections(self) -> str:
        text = describe_rejections(self._rejected)
        return f"; samples were rejected, {text}" if text else ""


def replay_sensor(
    log: Log,
    robot: Robot,
    config: SensorConfig,
    *,
    is_tared: bool = True,
    window: TareWindow | None = None,
    ignore_contact: bool = False,
    progress: Callable[[float], None] = lambda fraction: None,
) -> SensorReplay:
    """Run the virtual sensor over a log.

    A log with `tau_ext_Nm` has the external torque that the robot estimates itself.

    Args:
        log: With `q_rad`, perhaps `dq_rad_s`, and `tau_Nm` or `tau_ext_Nm`.
        robot: The robot.
        config: Settings of the sensor.
        is_tared: Whether a tare is taken.
        window: Where; None for the first `AUTOMATIC_TARE_S` after the filters have
            settled.
        ignore_contact: Whether the tare is taken where contact is seen.
        progress: Takes the fraction of the rows that is done.

    Raises:
        ReplayError: The log has other joints than the robot, or the window lies outside
            it.
        residual.TareError: The tare is refused.
    """
    progress_rows = 2000  # rows between two calls of `progress`
    require_joints(log["q_rad"], robot)
    times_s = log.t_s.tolist()
    _require_inside(window, times_s)

    sensor = VirtualForceSensor(robot, config)
    update = _update_of(log, sensor)
    rejected = Counter[str]()
    log_tare = _LogTare(sensor, rejected, window, times_s[0], ignore_contact)
    log_tare.is_wanted = is_tared
    doubts: dict[str, str] = {}
    longest_gap_s = 0.0

    count = len(times_s)
    steps_s = log.dt_s.tolist()
    numbers = np.full((count, 5), np.nan)
    wrench = np.full((count, 6), np.nan)
    std = np.full((count, COMPONENTS[config.mode]), np.nan)
    codes = np.zeros((count, 3), dtype=np.int64)
    for row, time_s in enumerate(times_s):
        log_tare.before(time_s)
        estimate = update(row, steps_s[row])
        codes[row, 0] = STATUS_CODES[estimate.status]
        codes[row, 1] = int(estimate.warnings)
        if estimate.status is Status.REJECTED:
            rejected[estimate.message.split(";")[0]] += 1
            continue
        log_tare.after(time_s, estimate.status)
        doubts |= _doubt_of(estimate, sensor)
        elapsed_s = sensor.elapsed_s
        longest_gap_s = max(longest_gap_s, elapsed_s)
        codes[row, 2] = elapsed_s > config.max_gap_s + ROUNDING_S
        numbers[row] = (
            estimate.axial,
            estimate.axial_std,
            estimate.axial_unsmoothed,
            sensor.std_of_bias_N(estimate),
            estimate.model_mismatch,
        )
        wrench[row, :3] = estimate.force
        wrench[row, 3:] = estimate.torque
        std[row] = np.sqrt(estimate.covariance.diagonal())
        if row % progress_rows == 0:
            progress(row / count)

    log_tare.finish(times_s[-1])
    if log.left_out:
        rejected["bad time stamp"] += log.left_out
    rows = _table_of(log.t_s, numbers, wrench, std, codes, config)
    tool = ToolKinematics(robot, config.frame, config.insertion_axis)
    rows.insert(1, "travel_m", travel_along_needle(tool, log["q_rad"]))
    return SensorReplay(
        rows=rows,
        sensor=sensor,
        config=config,
        window=log_tare.window if is_tared else None,
        tare=log_tare.tare,
        rejected=rejected,
        doubts=tuple(doubts.values()),
        longest_gap_s=longest_gap_s,
    )


def _doubt_of(estimate: WrenchEstimate, sensor: VirtualForceSensor) -> dict[str, str]:
    """Return what is said of velocities or signals with a sample; mostly empty."""
    if not estimate.message or estimate.status is Status.INITIALIZING:
        return {}
    if estimate.warnings & SensorWarning.VELOCITY:
        return {"velocity": estimate.message}
    return {"signals": sensor.question} if sensor.question else {}


def _update_of(
    log: Log, sensor: VirtualForceSensor
) -> Callable[[int, float], WrenchEstimate]:
    """Return what updates a sensor with a row of a log and its time step [s]."""
    q_rad = log["q_rad"]
    if "tau_ext_Nm" in log:
        external_Nm = log["tau_ext_Nm"]
        return lambda row, step_s: sensor.update_external_torque(
            q_rad[row], None, external_Nm[row], step_s
        )
    tau_Nm = log["tau_Nm"]
    if "dq_rad_s" not in log:
        return lambda row, step_s: sensor.update(q_rad[row], None, tau_Nm[row], step_s)
    dq_rad_s = log["dq_rad_s"]
    return lambda row, step_s: sensor.update(
        q_rad[row], dq_rad_s[row], tau_Nm[row], step_s
    )


def _table_of(
    t_s: Array,
    numbers: Array,
    wrench: Array,
    std: Array,
    codes: np.ndarray,
    config: SensorConfig,
) -> pd.DataFrame:
    """Return the columns of `SensorReplay.rows` but the travel, in their order."""
    columns: dict[str, np.ndarray] = {
        "t_s": t_s,
        "axial_N": numbers[:, 0],
        "axial_std_N": numbers[:, 1],
    }
    vectors = {"force": "N"} | ({"torque": "Nm"} if config.mode == "full" else {})
    for number, (vector, unit) in enumerate(vectors.items()):
        parts = {f"{vector}_": wrench[:, 3 * number :]}
        if config.mode != "axial":
            parts[f"{vector}_std_"] = std[:, 3 * number :]
        for prefix, values in parts.items():
            for axis, component in zip("xyz", values.T, strict=False):
                columns[f"{prefix}{axis}_in_{config.axes}_{unit}"] = component
    columns["axial_unsmoothed_N"] = numbers[:, 2]
    columns["axial_unsmoothed_std_N"] = numbers[:, 3]
    columns["model_mismatch"] = numbers[:, 4]
    columns["force_warnings"] = codes[:, 1]
    columns["force_status"] = codes[:, 0]
    columns["after_gap"] = codes[:, 2] > 0
    return pd.DataFrame(columns)


def _require_inside(window: TareWindow | None, times_s: list[float]) -> None:
    """Refuse a window that ends before it starts, or lies outside the log."""
    if window is None:
        return
    first_s = times_s[0]
    last_s = times_s[-1]
    if not (window.start_s < window.end_s and first_s < window.end_s <= last_s):
        raise ReplayError(
            f"a tare from {window}: expected a start before its end within the log, "
            f"which runs from {first_s:.12g} to {last_s:.12g} s"
        )


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
            "Load the robot of the log, or name its columns in the `mapping`.",
        )


def travel_along_needle(tool: ToolKinematics, q_rad: Array) -> Array:
    """Return the travel of the tool along the needle [m], shape (m,).

    It counts from the first finite row, along the needle as it stood there; NaN where
    positions are not finite.

    Args:
        tool: Kinematics of the tool, which are updated.
        q_rad: Joint positions, shape (m, n).
    """
    travel_m = np.full(len(q_rad), np.nan)
    finite = np.flatnonzero(np.isfinite(q_rad).all(axis=1))
    start_m = np.zeros(3)
    axis = np.zeros(3)
    for row in finite.tolist():
        tool.update(q_rad[row])
        place_m = tool.pose[:3, 3]
        if row == finite[0]:
            start_m = place_m
            axis = tool.axis_in_base
        travel_m[row] = axis.dot(place_m - start_m)
    return travel_m
