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


NO_WINDOW = TareWindow(np.nan, np.nan)
"""Where a log is not tared: no time is within it."""


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
    """

    rows: pd.DataFrame
    sensor: VirtualForceSensor
    config: SensorConfig
    window: TareWindow | None
    tare: Tare | None
    rejected: Counter[str]
    doubts: tuple[str, ...]


class _LogTare:
    """Starts the recording of a tare and takes it when their times come.

    Args:
        sensor: The sensor that is tared.
        window: Where it is tared; None for the first free motion.
        ignore_contact: Whether a tare is taken where contact is seen.

    Attributes:
        window: Where it is tared.
        tare: The tare; None before it was taken.
    """

    def __init__(
        self,
        sensor: VirtualForceSensor,
        window: TareWindow | None,
        ignore_contact: bool,
    ) -> None:
        self.window = window or TareWindow(-np.inf, np.inf)
        self.tare: Tare | None = None
        self._sensor = sensor
        self._ignore_contact = ignore_contact
        self._must_start = window is not None

    def before(self, time_s: float) -> None:
        """Start the recording or take the tare, before the sample of this time [s]."""
        if self._must_start and time_s >= self.window.start_s:
            self._sensor.start_tare_recording()
            self._must_start = False
        if self.tare is None and time_s > self.window.end_s:
            self._take()

    def after(self, time_s: float, status: Status) -> None:
        """Begin the automatic window once the filters have settled."""
        if status is Status.NOT_TARED and self.window.end_s == np.inf:
            self.window = TareWindow(time_s, time_s + AUTOMATIC_TARE_S)

    def finish(self, last_s: float) -> None:
        """Take a tare whose window ends with the log, at this time [s]."""
        if last_s < self.window.end_s:
            raise ReplayError(
                "the log ends before the filters have settled and "
                f"{AUTOMATIC_TARE_S:g} s of free motion were seen, so it cannot be "
                "tared"
            )
        if self.tare is None:
            self._take()

    def _take(self) -> None:
        """Take the tare; a refusal names the window."""
        try:
            self.tare = self._sensor.tare(ignore_contact=self._ignore_contact)
        except TareError as error:
            text = f"no tare from {self.window}: {error}"
            raise error.reworded(text) from error


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
    if window is not None:
        _require_inside(window, times_s)
        window = window._replace(start_s=max(window.start_s, times_s[0]))
    sensor = VirtualForceSensor(robot, config)
    log_tare = _LogTare(sensor, window if is_tared else NO_WINDOW, ignore_contact)
    update = _update_of(log, sensor)
    names = _names_of(config)
    numbers = np.full((len(times_s), len(names)), np.nan)
    codes = np.zeros((len(times_s), 2), dtype=np.int64)
    after_gap = np.zeros(len(times_s), dtype=bool)
    rejected = Counter[str]()
    doubts: dict[str, str] = {}
    for row, (time_s, step_s) in enumerate(
        zip(times_s, log.dt_s.tolist(), strict=True)
    ):
        log_tare.before(time_s)
        estimate = update(row, step_s)
        codes[row] = STATUS_CODES[estimate.status], int(estimate.warnings)
        if estimate.status is Status.REJECTED:
            rejected[estimate.message.split(";")[0]] += 1
            continue
        log_tare.after(time_s, estimate.status)
        doubts |= _doubt_of(estimate, sensor)
        after_gap[row] = sensor.elapsed_s > config.max_gap_s + ROUNDING_S
        numbers[row] = _numbers_of(estimate, sensor, config.mode)
        if row % progress_rows == 0:
            progress(row / len(times_s))
    if is_tared:
        log_tare.finish(times_s[-1])
    if log.left_out:
        rejected["bad time stamp"] += log.left_out
    tool = ToolKinematics(robot, config.frame, config.insertion_axis)
    rows = pd.DataFrame(numbers, columns=names)
    rows.insert(0, "t_s", log.t_s)
    rows.insert(1, "travel_m", travel_along_needle(tool, log["q_rad"]))
    rows["force_warnings"] = codes[:, 1]
    rows["force_status"] = codes[:, 0]
    rows["after_gap"] = after_gap
    return SensorReplay(
        rows=rows,
        sensor=sensor,
        config=config,
        window=log_tare.window if is_tared else None,
        tare=log_tare.tare,
        rejected=rejected,
        doubts=tuple(doubts.values()),
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
    dq_rad_s = log["dq_rad_s"] if "dq_rad_s" in log else [None] * len(q_rad)
    return lambda row, step_s: sensor.update(
        q_rad[row], dq_rad_s[row], tau_Nm[row], step_s
    )


VECTORS = {
    "axial": {"force": "N"},
    "point": {"force": "N", "force_std": "N"},
    "full": {"force": "N", "force_std": "N", "torque": "Nm", "torque_std": "Nm"},
}
"""Vectors that a mode estimates, with their units, in the order of their columns."""


def _names_of(config: SensorConfig) -> list[str]:
    """Return the names of what `_numbers_of` returns."""
    vectors = [
        f"{vector}_{axis}_in_{config.axes}_{unit}"
        for vector, unit in VECTORS[config.mode].items()
        for axis in "xyz"
    ]
    unsmoothed = ["axial_unsmoothed_N", "axial_unsmoothed_std_N", "model_mismatch"]
    return ["axial_N", "axial_std_N", *vectors, *unsmoothed]


def _numbers_of(
    estimate: WrenchEstimate, sensor: VirtualForceSensor, mode: str
) -> list[float]:
    """Return the numbers of an estimate, in the order of `_names_of`."""
    std = np.sqrt(estimate.covariance.diagonal())
    of_vector = {
        "force": estimate.force,
        "force_std": std[:3],
        "torque": estimate.torque,
        "torque_std": std[3:],
    }
    vectors = [of_vector[name] for name in VECTORS[mode]]
    return [
        estimate.axial,
        estimate.axial_std,
        *np.concatenate(vectors).tolist(),
        estimate.axial_unsmoothed,
        sensor.std_of_bias_N(estimate),
        estimate.model_mismatch,
    ]


def _require_inside(window: TareWindow, times_s: list[float]) -> None:
    """Refuse a window that ends before it starts, or lies outside the log."""
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
    places_m = np.empty((len(finite), 3))
    axis = np.zeros(3)
    for number, row in enumerate(finite):
        tool.update(q_rad[row])
        places_m[number] = tool.pose[:3, 3]
        if number == 0:
            axis = tool.axis_in_base.copy()
    travel_m[finite] = (places_m - places_m[:1]) @ axis
    return travel_m
