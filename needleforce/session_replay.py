"""A recording replayed as on the robot: by a session, or by the virtual sensor alone.

    log = read_log("insertion.csv", required=["q", "tau"], joints=robot.joint_names)
    for q_rad, estimate in replay_session(InsertionSession(robot), log):
        print(estimate.time_s, estimate.identification.tip_force_N)

    forces = replay_sensor(log, robot, SensorConfig(), window=TareWindow(0.0, 13.0))
    forces.rows["axial_N"]

A session is tared as it goes; the sensor needs no insertion, and is tared in any window
of the log.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from needleforce.recordings import Log
from needleforce.session import InsertionSession, SessionEstimate
from needleforce.tare_run import AutoTare
from residual import (
    SensorConfig,
    SensorWarning,
    Status,
    TareError,
    VirtualForceSensor,
    WrenchEstimate,
)
from residual.bias.model import Tare
from residual.checks.input import ROUNDING_S
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

AUTOMATIC_TARE_S = 2.0
"""Without a window of the user's, so much from the start of the log is taken for free
motion [s]: whoever records an insertion starts before contact, but not long before."""

STATUS_CODES = {status: code for code, status in enumerate(Status)}
"""Numbers of the states in files."""

VECTORS = {
    "axial": {"force": "N"},
    "point": {"force": "N", "force_std": "N"},
    "full": {"force": "N", "force_std": "N", "torque": "Nm", "torque_std": "Nm"},
}
"""Vectors that a mode estimates, with their units, in the order of their columns."""


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
        return f"{round(self.start_s, 3):.12g} to {round(self.end_s, 3):.12g} s"


@dataclass(frozen=True, slots=True, eq=False)
class SensorReplay:
    """What the sensor has estimated of a log.

    Attributes:
        log: The log.
        robot: Its robot.
        config: Settings of the sensor.
        rows: One row per row of the log; numbers are NaN where it was rejected. Columns
            have their unit in the name: `t_s`, `travel_m` (of the tool along the
            needle), `axial_N` and its deviation, force and torque in the axes of the
            config with theirs, `axial_unsmoothed_N` and its deviation without the error
            of the torques' scale (for the identification), `model_mismatch`,
            `force_warnings`, `force_status` (one of `STATUS_CODES`); and `after_gap`,
            whether the filters restarted after a gap in time.
        sensor: The sensor as it is after the last row.
        window: Where it was tared; None without a tare.
        tare: The tare; None without.
        rejected: How many samples were rejected, by reason.
        doubts: The latest message about velocities that are no rates, and the latest
            about signals that may be missing or in degrees, if there were any.
    """

    log: Log
    robot: Robot
    config: SensorConfig
    rows: pd.DataFrame
    sensor: VirtualForceSensor
    window: TareWindow | None
    tare: Tare | None
    rejected: Counter[str]
    doubts: tuple[str, ...]

    def count_status(self, status: Status) -> int:
        """Return how many rows have a status."""
        return int((self.rows["force_status"] == STATUS_CODES[status]).sum())


def replay_session(
    session: InsertionSession, log: Log, tare: AutoTare | None = None
) -> Iterator[tuple[Array, SessionEstimate]]:
    """Run a session over a recording of joint signals, sample by sample.

    Yields joint positions, shape (n,), and what the session estimates.

    Args:
        session: A session that has seen nothing.
        log: The recording, as for `replay_sensor`.
        tare: When it is tared; None for after 4 s of motion without contact.
    """
    if tare is None:
        tare = AutoTare(4.0, at_once=True)
    for q_rad, estimate in zip(log["q_rad"], _updates(log, session), strict=True):
        tare.after(session, estimate)
        yield q_rad, estimate


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
    require_joints(log["q_rad"], robot)
    start_row = len(log)
    end_row = len(log)
    if window is not None:
        window = _inside(window, log.t_s)
        start_row = int(np.searchsorted(log.t_s, window.start_s))
        end_row = int(np.searchsorted(log.t_s, window.end_s, side="right"))
    sensor = VirtualForceSensor(robot, config)
    tare: Tare | None = None
    names = _names_of(config)
    numbers = np.full((len(log), len(names)), np.nan)
    codes = np.zeros((len(log), 3), dtype=np.int64)
    rejected = Counter[str]()
    doubts: dict[str, str] = {}
    for row, estimate in enumerate(_updates(log, sensor, progress)):
        codes[row, :2] = int(estimate.warnings), STATUS_CODES[estimate.status]
        if estimate.status is Status.REJECTED:
            rejected[estimate.message.split(";")[0]] += 1
        else:
            doubts |= _doubt_of(estimate, sensor)
            codes[row, 2] = sensor.elapsed_s > config.max_gap_s + ROUNDING_S
            numbers[row] = _numbers_of(estimate, sensor, config)
        if estimate.status is Status.NOT_TARED and is_tared and window is None:
            start_s = float(log.t_s[row])
            window = TareWindow(start_s, start_s + AUTOMATIC_TARE_S)
            end_row = int(np.searchsorted(log.t_s, window.end_s, side="right"))
        # Before the update with the next row.
        if row + 1 == start_row:
            sensor.start_tare_recording()
        if row + 1 == end_row and window is not None and log.t_s[-1] >= window.end_s:
            tare = _take_tare(sensor, window, ignore_contact=ignore_contact)
    if is_tared and tare is None:
        raise ReplayError(
            f"the log ends before the filters have settled and {AUTOMATIC_TARE_S:g} s "
            "of free motion were seen, so it cannot be tared"
        )
    rejected["bad time stamp"] = log.left_out
    tool = ToolKinematics(robot, config.frame, config.insertion_axis)
    columns = {
        "t_s": log.t_s,
        "travel_m": travel_along_needle(tool, log["q_rad"]),
        **dict(zip(names, numbers.T, strict=True)),
        "force_warnings": codes[:, 0],
        "force_status": codes[:, 1],
        "after_gap": codes[:, 2] > 0,
    }
    return SensorReplay(
        log=log,
        robot=robot,
        config=config,
        rows=pd.DataFrame(columns),
        sensor=sensor,
        window=window,
        tare=tare,
        rejected=+rejected,  # without a reason that was never seen
        doubts=tuple(doubts.values()),
    )


def _updates(
    log: Log,
    chain: VirtualForceSensor | InsertionSession,
    progress: Callable[[float], None] = lambda fraction: None,
) -> Iterator[Any]:
    """Yield what a sensor or a session estimates with each row of a log."""
    progress_rows = 2000  # rows between two calls of `progress`
    is_external = "tau_ext_Nm" in log
    update = chain.update_external_torque if is_external else chain.update
    torques_Nm = log["tau_ext_Nm" if is_external else "tau_Nm"]
    has_velocity = "dq_rad_s" in log and not is_external
    velocities = log["dq_rad_s"] if has_velocity else repeat(None)
    signals = zip(log["q_rad"], velocities, torques_Nm, log.dt_s.tolist(), strict=False)
    for row, sample in enumerate(signals):
        if row % progress_rows == 0:
            progress(row / len(log))
        yield update(*sample)


def _inside(window: TareWindow, t_s: Array) -> TareWindow:
    """Return a window that begins no earlier than its log; refuse one outside it.

    Raises:
        ReplayError: It ends before it starts, or lies outside the log.
    """
    first_s = float(t_s[0])
    last_s = float(t_s[-1])
    if not (window.start_s < window.end_s and first_s < window.end_s <= last_s):
        raise ReplayError(
            f"a tare from {window}: expected a start before its end within the log, "
            f"which runs from {first_s:.12g} to {last_s:.12g} s"
        )
    return window._replace(start_s=max(window.start_s, first_s))


def _take_tare(
    sensor: VirtualForceSensor, window: TareWindow, *, ignore_contact: bool
) -> Tare:
    """Take the tare; a refusal names the window."""
    try:
        return sensor.tare(ignore_contact=ignore_contact)
    except TareError as error:
        raise error.reworded(f"no tare from {window}: {error}") from error


def _doubt_of(estimate: WrenchEstimate, sensor: VirtualForceSensor) -> dict[str, str]:
    """Return what is said of velocities or signals with a sample; mostly empty."""
    if not estimate.message or estimate.status is Status.INITIALIZING:
        return {}
    if estimate.warnings & SensorWarning.VELOCITY:
        return {"velocity": estimate.message}
    return {"signals": sensor.question} if sensor.question else {}


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
    estimate: WrenchEstimate, sensor: VirtualForceSensor, config: SensorConfig
) -> list[float]:
    """Return the numbers of an estimate, in the order of `_names_of`."""
    std = np.sqrt(estimate.covariance.diagonal())
    of_vector = {
        "force": estimate.force,
        "force_std": std[:3],
        "torque": estimate.torque,
        "torque_std": std[3:],
    }
    return [
        estimate.axial,
        estimate.axial_std,
        *np.concatenate([of_vector[name] for name in VECTORS[config.mode]]).tolist(),
        estimate.axial_unsmoothed,
        sensor.std_of_bias_N(estimate),
        estimate.model_mismatch,
    ]


def require_joints(q_rad: Array, robot: Robot) -> None:
    """Refuse a log whose channels have another number of joints than the robot.

    Args:
        q_rad: Joint positions of the log, shape (m, n).
        robot: The robot.

    Raises:
        ReplayError: The numbers differ.
    """
    columns = q_rad.shape[1]
    if columns != robot.nv:
        raise ReplayError(
            f"the log has {columns} columns per joint signal, the robot has "
            f"{robot.nv} joints: {', '.join(robot.joint_names)}",
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
    places_m = np.full((len(q_rad), 3), np.nan)
    for row in np.flatnonzero(np.isfinite(q_rad).all(axis=1))[::-1]:
        tool.update(q_rad[row])
        places_m[row] = tool.pose[:3, 3]
    # The tool stands now where it was in the first of these rows.
    return (places_m - tool.pose[:3, 3]) @ tool.axis_in_base
