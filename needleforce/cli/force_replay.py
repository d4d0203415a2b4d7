"""The virtual sensor over a log, sample by sample, as on the robot."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.cli.options import SensorOptions
from needleforce.cli.terminal import CommandError
from needleforce.recordings.log import LogChunk
from residual import SensorConfig, SensorWarning, Status, TareError, VirtualForceSensor
from residual.bias.model import Tare
from residual.checks.input import ROUNDING_S
from residual.errors import VelocityError
from residual.estimate import WrenchEstimate
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

# When the sensor is tared.

AUTOMATIC_S = 2.0
"""Without a choice of the user's, so much from the start of the log is taken for free
motion [s]: whoever records an insertion starts before contact, but not long before."""

_WINDOW = (
    "expected START:END in seconds, such as 0:4, or +0:+4 from the log's first stamp"
)
_CHOICES = "choose where the needle is free with --tare START:END, or go without with --no-tare"
_UNITS = (
    "Say unit and factor of the columns: --q q_*:deg, --dq dq_*:deg/s or dq_*:rad/s:-1"
)
_AS_OPTIONS = {
    "ignore_contact=True": "--force-tare",
    "set torque_is_gravity_compensated=True": "give --gravity-compensated",
    "set torque_is_gravity_compensated=False": "leave --gravity-compensated out",
    "negate it and call update() instead": "leave --external-torque out and negate it",
    "call update() instead": "leave --external-torque out and read it with --tau",
    "negate it": "negate it, as in --tau tau_*:Nm:-1",
    "update() the sensor without contact first, in steps no longer than max_gap_s, then tare()": (
        "choose a longer window, without gaps in time"
    ),
}
"""What a refused tare advises in code, as options."""


class TareWindow(NamedTuple):
    """A stretch of motion without contact, in seconds of the log's clock, and its
    tare if taken.
    """

    start_s: float
    end_s: float
    tare: Tare | None = None

    def __str__(self) -> str:
        return f"{self.start_s:.12g} to {self.end_s:.12g} s"


def tare_window(text: str, first_s: float) -> TareWindow:
    """Return the window of ``--tare`` in a log that starts at ``first_s`` [s]."""
    start, colon, end = text.partition(":")
    if not colon:
        raise CommandError(f"--tare {text}: {_WINDOW}")
    start_s = _log_time(text, start, first_s) if start.strip() else first_s
    return TareWindow(start_s, _log_time(text, end, first_s))


def _log_time(option: str, text: str, first_s: float) -> float:
    """Return a time on the log's clock [s]; after a + it counts from the log's
    start.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CommandError(f"--tare {option}: {text!r} is no time; {_WINDOW}")
    return first_s + value if text.strip().startswith("+") else value


def rejections(rejected: Counter[str]) -> str:
    """Return how many samples were rejected, and how often for which reasons; empty
    if none.
    """
    reasons = [f"{count} x {reason}" for reason, count in rejected.most_common(4)]
    if others := len(rejected) - len(reasons):
        reasons.append(f"{others} other reasons")
    return f"{rejected.total()}: {'; '.join(reasons)}" if reasons else ""


class Taring:
    """Starts the tare recording and takes the tare when their times come."""

    def __init__(
        self, replay: "Replay", options: SensorOptions, first_s: float
    ) -> None:
        self._sensor = replay.sensor
        self._options = options
        self._first_s = first_s
        self._rejected_before = Counter[str]()
        self._rejected = replay.rejected
        self._window: TareWindow | None = None
        if options.tare is not None:
            window = tare_window(options.tare, first_s)
            self._require_inside(window, math.inf)
            self._window = window._replace(start_s=max(window.start_s, first_s))
        self._must_start = self._window is not None
        self._has_settled = False
        self.done: TareWindow | None = None

    def before(self, t_s: float) -> None:
        """Act before the sample of time ``t_s`` [s] is given to the sensor."""
        window = self._window
        if window is None or self.done is not None:
            return
        if self._must_start and t_s >= window.start_s:
            self._sensor.start_tare_recording()
            self._rejected_before = self._rejected.copy()
            self._must_start = False
        if t_s > window.end_s:
            self._tare(window)

    def after(self, t_s: float, status: Status) -> None:
        """Learn from the status of the sample of time ``t_s`` [s] when the filters
        have settled.
        """
        if status is not Status.NOT_TARED or self._must_start:
            return
        self._has_settled = True
        if self._window is None and not self._options.no_tare:
            self._window = TareWindow(t_s, t_s + AUTOMATIC_S)

    def finish(self, last_s: float, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log; one that was broken off may
        end before.
        """
        window = self._window
        if self._options.no_tare or self.done is not None:
            return
        if window is not None and last_s >= window.end_s:
            self._tare(window)
        elif is_whole:
            if self._options.tare is not None and window is not None:
                self._require_inside(window, last_s)
            raise CommandError(
                f"the log ends before the filters have settled and {AUTOMATIC_S:g} s of free "
                f"motion were seen, so it cannot be tared{self._rejections}; {_CHOICES}"
            )

    @property
    def _rejections(self) -> str:
        text = rejections(self._rejected - self._rejected_before)
        return f"; samples were rejected, {text}" if text else ""

    def _require_inside(self, window: TareWindow, last_s: float) -> None:
        is_inside = self._first_s < window.end_s <= last_s and window.start_s < last_s
        if is_inside and window.start_s < window.end_s:
            return
        first = f"{self._first_s:.12g} s"
        last = f"{last_s:.12g} s"
        log = (
            f"starts at {first}"
            if math.isinf(last_s)
            else f"runs from {first} to {last}"
        )
        what = f"lies outside the log, which {log}"
        if not window.start_s < window.end_s:
            what = f"START must come before END in a log whose first stamp is {first}; "
            what += "if the unit is wrong, say --time COLUMN:UNIT"
        raise CommandError(f"--tare {self._options.tare}: {what}; {_WINDOW}")

    def _tare(self, window: TareWindow) -> None:
        what = f"no tare from {window}"
        if not self._has_settled:
            why = self._rejections or "; choose a window that ends later"
            raise CommandError(f"{what}: the filters had not settled by then{why}")
        try:
            tare = self._sensor.tare(ignore_contact=self._options.force_tare)
        except TareError as error:
            reason = str(error)
            for words, option in _AS_OPTIONS.items():
                reason = reason.replace(words, option)
            choices = _UNITS if isinstance(error, VelocityError) else f"Or {_CHOICES}"
            raise CommandError(f"{what}: {reason}. {choices}") from error
        self.done = window._replace(tare=tare)


# The sensor over the rows of a log, of which any number may come at a time.

STATUS_CODES = {
    status: code for code, status in enumerate(Status)
}  # As files of numbers have it
_MOST_REASONS = 50


Rows = dict[str, NDArray]
"""One estimate per row of the log; numbers are NaN where a row was rejected.

`t_s` [s] as in the log, `travel_m` of the tool along the needle [m], `axial_N`,
`axial_std_N` and `axial_unsmoothed_N` [N], `force_N` and `torque_Nm` on the tool [N,
Nm] of shape (n, 3), `std` of the components that the mode estimates of shape (n, 1),
(n, 3) or (n, 6), `model_mismatch`, `force_warnings` (see `residual.WrenchEstimate`),
`force_status` (`STATUS_CODES`) and `after_gap`, whether the filters restarted after a
gap in time; of shape (n,) but where stated.
"""


def has_status(rows: Rows, status: Status) -> NDArray[np.bool_]:
    """Return which rows have a status, shape (n,)."""
    return rows["force_status"] == STATUS_CODES[status]


def require_joints(q_rad: NDArray[np.float64], robot: Robot, choice: str = "") -> None:
    """Refuse a log of other joints; it has the same number in every channel."""
    columns = q_rad.shape[1]
    names = robot.joint_names
    if columns != len(names):
        raise CommandError(
            f"the log has {columns} columns per joint signal, the robot has {len(names)} "
            f"joints: {', '.join(names)}. Name another robot with --robot or --urdf FILE, where "
            f"--lock holds joints that are not in the log{choice}"
        )


class Replay:
    """Runs the sensor over a log."""

    def __init__(
        self, robot: Robot, config: SensorConfig, options: SensorOptions
    ) -> None:
        self.sensor = VirtualForceSensor(robot, config)
        self.robot = robot
        self.config = config
        self.is_external = options.external_torque
        self.frame = config.frame if config.frame is not None else robot.tool_frame
        self._options = options
        self._has_velocity = False
        self._tool = ToolKinematics(robot, config.frame, config.insertion_axis)
        self._start_m: NDArray[np.float64] | None = None
        self._axis = self._tool.axis_in_base
        self._taring: Taring | None = None
        self.tare: TareWindow | None = None  # once finished: the tare, if one was taken
        # Of the clock of the first rows, which runs on when the log's clock is set
        # back.
        self._first_s = 0.0
        self._latest_s = -math.inf
        self._shift_s = 0.0
        self.rejected: Counter[str] = Counter()  # reasons
        self.velocity_fault = ""  # the last message about velocities that are no rates
        self.question = (
            ""  # the last one about signals that may be missing or in degrees
        )
        # in time, after which the filters restarted
        self.gaps = 0
        self.longest_gap_s = 0.0

    @property
    def description(self) -> str:
        """What is estimated from what."""
        config = self.config
        what = "wrench" if config.mode == "full" else f"{config.mode} force"
        what = f"{what} at {self.frame}"
        if self.is_external:
            return f"{what}, from the robot's own external torque"
        velocity = (
            "velocity from the log" if self._has_velocity else "velocity estimated"
        )
        return f"{what}, K = {config.slowest_gain_per_s:g} 1/s, {velocity}"

    def run(self, chunk: LogChunk) -> Rows:
        """Return the estimates of further rows, at least one."""
        q_rad = chunk.channels["q_rad"]
        dq_rad_s = chunk.channels.get("dq_rad_s")
        torque_Nm = chunk.channels["tau_ext_Nm" if self.is_external else "tau_Nm"]
        t_s = chunk.t_s.tolist()
        self._has_velocity = dq_rad_s is not None
        if self._taring is None:
            require_joints(
                q_rad, self.robot, ", or choose columns with --q, --tau and so on"
            )
            self._first_s = t_s[0]
            self._taring = Taring(self, self._options, t_s[0])
        sensor = self.sensor
        taring = self._taring
        estimates = []
        elapsed_s = []
        update = sensor.update_external_torque if self.is_external else sensor.update
        for k, (stamp_s, dt_s) in enumerate(zip(t_s, chunk.dt_s.tolist(), strict=True)):
            now_s = self._running_s(stamp_s, dt_s)
            advances = dt_s > 0.0
            if advances:
                taring.before(now_s)
            # The sensor reads no time step of the first sample.
            step_s = dt_s if advances else 0.0
            dq = None if dq_rad_s is None or self.is_external else dq_rad_s[k]
            found = update(q_rad[k], dq, torque_Nm[k], step_s)
            estimates.append(found)
            is_rejected = found.status is Status.REJECTED
            elapsed_s.append(0.0 if is_rejected else sensor.elapsed_s)
            if is_rejected:
                reason = (
                    found.message.split(";")[0] if advances else "time does not advance"
                )
                is_known = reason in self.rejected or len(self.rejected) < _MOST_REASONS
                self.rejected[reason if is_known else "other reasons"] += 1
            else:
                taring.after(now_s, found.status)
                is_settled = found.status is not Status.INITIALIZING
                if is_settled and found.warnings & SensorWarning.VELOCITY:
                    self.velocity_fault = found.message
                elif is_settled and found.message:
                    self.question = sensor.question or self.question
        after_gap = np.array(elapsed_s) > self.config.max_gap_s + ROUNDING_S
        self.gaps += np.count_nonzero(after_gap)
        self.longest_gap_s = max(self.longest_gap_s, *elapsed_s)
        rows = {
            "t_s": chunk.t_s,
            "travel_m": self._travel_m(q_rad),
            **_columns(estimates),
        }
        return {**rows, "after_gap": after_gap}

    @property
    def duration_s(self) -> float:
        """From the first row to the latest [s], on a clock that was never set back."""
        return self._latest_s - self._first_s

    def finish(self, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log, which was read to its end or
        not.
        """
        if self._taring is not None:
            self._taring.finish(self._latest_s, is_whole=is_whole)
            self.tare = self._taring.done

    def _travel_m(self, q_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the travel along the insertion axis as it stood in the first finite
        row [m].
        """
        positions = np.full((len(q_rad), 3), np.nan)
        for k in np.flatnonzero(np.isfinite(q_rad).all(axis=1)).tolist():
            self._tool.update(q_rad[k])
            positions[k] = self._tool.pose[:3, 3]
            if self._start_m is None:
                self._start_m = positions[k].copy()
                self._axis = self._tool.pose[:3, :3].dot(self._tool.axis_in_tool)
        if self._start_m is None:
            return positions[:, 0]
        # Not a matrix product, whose rounding may depend on how many rows come at a
        # time.
        x, y, z = (positions - self._start_m).T * self._axis[:, None]
        return 0.0 + x + y + z

    def _running_s(self, stamp_s: float, dt_s: float) -> float:
        """Return the time of a row [s] on a clock that never goes back."""
        now_s = stamp_s + self._shift_s
        if dt_s > 0.0:
            if now_s <= self._latest_s:
                self._shift_s += self._latest_s + dt_s - now_s
                now_s = self._latest_s + dt_s
            self._latest_s = now_s
        return now_s


def _columns(estimates: Sequence[WrenchEstimate]) -> Rows:
    fields = {
        f"{field}_N": field
        for field in ("axial", "axial_std", "axial_unsmoothed", "force")
    }
    fields |= {"torque_Nm": "torque", "model_mismatch": "model_mismatch"}
    numbers = {
        name: np.array([getattr(found, field) for found in estimates])
        for name, field in fields.items()
    }
    covariances = np.array([found.covariance for found in estimates])
    numbers["std"] = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    status = np.array([STATUS_CODES[found.status] for found in estimates])
    for values in numbers.values():
        values[status == STATUS_CODES[Status.REJECTED]] = np.nan
    warnings = np.array([int(found.warnings) for found in estimates])
    return {**numbers, "force_warnings": warnings, "force_status": status}
