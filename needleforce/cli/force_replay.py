"""The virtual sensor over a log, sample by sample, as it would have run on the robot."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from needleforce.cli.config_files import CommandError
from recordings.columns.force_codes import FORCE_STATUS
from recordings.log_stream import LogChunk
from residual.bias_model import Tare
from residual.config import SensorConfig
from residual.errors import TareError, VelocityError
from residual.estimate import SensorWarning, Status, WrenchEstimate
from residual.tool_kinematics import ToolKinematics
from residual.virtual_force_sensor import VirtualForceSensor
from urdf import Robot

# When the sensor is to be tared: the option ``--tare START:END``.


_EXPECTED = "expected START:END in seconds, such as 0:4, or +0:+4 from the log's first stamp"
_LATE_CLOCK_S = 1e5


@dataclass(frozen=True, slots=True, kw_only=True)
class TareWindow:
    """A stretch of free motion in the log.

    Attributes:
        start_s: Its start on the log's clock [s].
        end_s: Its end [s].
    """

    start_s: float
    end_s: float

    def __str__(self) -> str:
        """In words; to the millisecond where a clock counts from 1970."""
        return f"{_digits(self.start_s)} to {_digits(self.end_s)} s"


def _digits(time_s: float) -> str:
    return f"{time_s:.6g}" if abs(time_s) < _LATE_CLOCK_S else f"{time_s:.3f}"


@dataclass(frozen=True, slots=True)
class TareOption:
    """What the option says; the window is known with the log's first stamp.

    Attributes:
        text: ``START:END``; either may be counted from the log's first stamp with a leading
            ``+``, and START may be left out.
    """

    text: str

    def __post_init__(self) -> None:
        """Check what can be checked without a log.

        Raises:
            CommandError: It is not a window.
        """
        self._ends(0.0)

    def window(self, first_s: float) -> TareWindow:
        """Return the window in a log that starts at ``first_s`` [s].

        Raises:
            CommandError: It does not end after it starts.
        """
        start_s, end_s = self._ends(first_s)
        plain_start_s, plain_end_s = self._ends(0.0)
        if start_s >= end_s and plain_start_s < plain_end_s:
            raise CommandError(
                f"--tare {self.text} does not fit the log, whose first stamp is {first_s:.9g} s; "
                f"if the unit is wrong, say --time COLUMN:UNIT; {_EXPECTED}"
            )
        if not start_s < end_s:
            raise CommandError(f"--tare {self.text}: START must come before END; {_EXPECTED}")
        return TareWindow(start_s=start_s, end_s=end_s)

    def require_inside(self, window: TareWindow, first_s: float, last_s: float) -> None:
        """Check that the log reaches as far as the window.

        Args:
            window: Of `window`.
            first_s: The log's first stamp [s].
            last_s: Its last [s]; inf while it is not known.

        Raises:
            CommandError: It does not.
        """
        if window.start_s >= last_s or window.end_s > last_s or window.end_s <= first_s:
            end = f"runs from {_digits(first_s)} to {_digits(last_s)} s"
            if math.isinf(last_s):
                end = f"starts at {_digits(first_s)} s"
            raise CommandError(f"--tare {self.text} lies outside the log, which {end}; {_EXPECTED}")

    def _ends(self, first_s: float) -> tuple[float, float]:
        start_text, colon, end_text = self.text.partition(":")
        if not colon:
            raise CommandError(f"--tare {self.text}: {_EXPECTED}")
        start_s = self._time(start_text, first_s) if start_text.strip() else first_s
        return start_s, self._time(end_text, first_s)

    def _time(self, text: str, first_s: float) -> float:
        text = text.strip()
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise CommandError(f"--tare {self.text}: {text!r} is no time; {_EXPECTED}")
        return first_s + value if text.startswith("+") else value


# Tares a sensor while a log runs through it.


AUTOMATIC_S = 2.0
"""Without a choice of the user's, so much from the start of the log is taken for free motion [s]:
whoever records an insertion starts before contact, but not long before."""

_COLUMNS = "--dq says names, unit and factor of the columns, as in --dq dq_*:deg/s or dq_*:rad/s:-1"
_CHOICES = "choose where the needle is free with --tare START:END, or go without with --no-tare"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TareRequest:
    """What the user wants.

    Attributes:
        where: Where to tare; ``automatic`` for the first `AUTOMATIC_S` once the filters have
            settled, None for no tare.
        force: Whether to tare even where contact is seen.
    """

    where: TareOption | Literal["automatic"] | None = "automatic"
    force: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TareDone:
    """A tare that was taken.

    Attributes:
        window: Where.
        tare: The fit.
    """

    window: TareWindow
    tare: Tare

    @property
    def largest_offset_Nm(self) -> float:
        """Largest constant offset of a joint [Nm]."""
        return float(np.abs(self.tare.mean[self.tare.basis.groups["offset"]]).max())


class Taring:
    """Starts the recording and takes the tare when their times come.

    Args:
        sensor: The sensor that the log runs through.
        request: What the user wants.
        first_s: First stamp of the log [s].

    Raises:
        CommandError: The window does not suit the log.
    """

    def __init__(self, sensor: VirtualForceSensor, request: TareRequest, first_s: float) -> None:
        self._sensor, self._request, self._first_s = sensor, request, first_s
        self._window: TareWindow | None = None
        if isinstance(request.where, TareOption):
            self._window = request.where.window(first_s)
            request.where.require_inside(self._window, first_s, math.inf)
        self._must_start = self._window is not None
        self._seen = 0
        self.done: TareDone | None = None

    def before(self, t_s: float) -> None:
        """Act before the sample of time ``t_s`` [s] is taken.

        Raises:
            CommandError: The tare was due and is refused.
        """
        window = self._window
        if window is None or self.done is not None:
            return
        if self._must_start and t_s >= window.start_s:
            self._sensor.start_tare_recording()
            self._must_start = False
        if t_s > window.end_s:
            self._tare(window)

    def after(self, t_s: float, status: Status) -> None:
        """Learn from the status of the sample of time ``t_s`` [s] when the filters have settled."""
        if status is not Status.NOT_TARED or self._must_start:
            return
        self._seen += 1
        if self._request.where == "automatic" and self._window is None:
            self._window = TareWindow(start_s=t_s, end_s=t_s + AUTOMATIC_S)

    def finish(self, last_s: float, *, is_whole: bool) -> None:
        """Take a tare whose window ends with the log.

        Args:
            last_s: Latest stamp of the log [s].
            is_whole: Whether the log was read to its end; if not, it may end before the tare.

        Raises:
            CommandError: It is refused, or the log is too short for a tare.
        """
        where, window = self._request.where, self._window
        if where is None or self.done is not None:
            return
        if window is None or last_s < window.end_s:
            if not is_whole:
                return
            if isinstance(where, TareOption) and window is not None:
                where.require_inside(window, self._first_s, last_s)
            raise CommandError(
                f"the log ends before the filters have settled and {AUTOMATIC_S:g} s of free "
                f"motion were seen, so it cannot be tared; {_CHOICES}"
            )
        self._tare(window)

    def _tare(self, window: TareWindow) -> None:
        what = f"no tare from {window}"
        if not self._seen:
            raise CommandError(
                f"{what}: the filters had not settled by then; choose a window that ends later"
            )
        try:
            tare = self._sensor.tare(ignore_contact=self._request.force)
        except TareError as error:
            reason = str(error).replace("ignore_contact=True", "--force-tare")
            choices = _COLUMNS if isinstance(error, VelocityError) else f"Or {_CHOICES}"
            raise CommandError(f"{what}: {reason}. {choices}") from error
        self.done = TareDone(window=window, tare=tare)


# The joint signals of a log, checked against the robot.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointSignals:
    """Consecutive rows of what a robot has recorded; bad rows are kept, the sensor skips them.

    Attributes:
        t_s: Time stamps on the log's clock [s], shape (n,).
        dt_s: Time since the latest row that advanced [s], shape (n,), see
            `recordings.clock.row_clock`.
        q_rad: Joint positions [rad], shape (n, joints).
        dq_rad_s: Joint velocities [rad/s], shape (n, joints), or None.
        torque_Nm: Joint torques [Nm], shape (n, joints).
        is_external: Whether they are the robot's own estimate of the external torque rather than
            the measured torque.
    """

    t_s: NDArray[np.float64]
    dt_s: NDArray[np.float64]
    q_rad: NDArray[np.float64]
    dq_rad_s: NDArray[np.float64] | None
    torque_Nm: NDArray[np.float64]
    is_external: bool = False

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.t_s)


def torque_channel(*, is_external: bool) -> str:
    """Return the channel of a log that holds the torque."""
    return "tau_ext" if is_external else "tau"


def joint_signals(chunk: LogChunk, robot: Robot, *, is_external: bool) -> JointSignals:
    """Return the joint signals of some rows of a log.

    Args:
        chunk: The rows, with the channels `q`, `torque_channel` and perhaps `dq`.
        robot: The robot it was recorded on.
        is_external: Take the robot's own estimate of external torque, not measured torque.

    Raises:
        CommandError: The log has not one column per joint of the robot.
    """
    channels = chunk.channels
    # A log holds the same number of joints in every channel, so that one stands for all.
    columns = channels["q_rad"].shape[1]
    if columns != robot.nv:
        raise CommandError(
            f"the log has {columns} columns per joint signal, the robot has {robot.nv} joints: "
            f"{', '.join(robot.joint_names)}. Choose columns with --q, --tau and so on, or lock "
            "joints with --lock"
        )
    return JointSignals(
        t_s=chunk.t_s,
        dt_s=chunk.dt_s,
        q_rad=channels["q_rad"],
        dq_rad_s=channels.get("dq_rad_s"),
        torque_Nm=channels[f"{torque_channel(is_external=is_external)}_Nm"],
        is_external=is_external,
    )


# How far the tool has travelled along the needle, for force over depth.


class TipTravel:
    """Travel along the insertion axis as it stood in the first sound row.

    Args:
        robot: The arm.
        config: Names frame and insertion axis.
    """

    def __init__(self, robot: Robot, config: SensorConfig) -> None:
        self._tool = ToolKinematics(robot, config.frame, config.insertion_axis)
        self._start: NDArray[np.float64] | None = None
        self._axis = self._tool.axis_in_base

    def __call__(self, q_rad: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the travel in further rows.

        Args:
            q_rad: Joint positions [rad], shape (n, joints).

        Returns:
            Travel since the first sound row [m], shape (n,), NaN where positions are not finite.
        """
        positions = np.full((len(q_rad), 3), np.nan)
        for k in np.flatnonzero(np.isfinite(q_rad).all(axis=1)).tolist():
            self._tool.update(q_rad[k])
            positions[k] = self._tool.place_in_base_m
            if self._start is None:
                self._start = positions[k].copy()
                self._axis = self._tool.axis_in_base.copy()
        if self._start is None:
            return positions[:, 0]
        # Not a matrix product, whose rounding may depend on how many rows come at a time.
        x, y, z = (positions - self._start).T * self._axis[:, None]
        return 0.0 + x + y + z


# Estimates of consecutive rows of a log.


STATUS_CODES = {Status(word): code for code, word in enumerate(FORCE_STATUS)}
"""How a status is written to a file of numbers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceRows:
    """One row per row of the log; NaN where a row was skipped.

    Attributes:
        t_s: Time stamps as in the log [s], shape (n,).
        travel_m: Travel of the tool along the needle [m], shape (n,).
        axial_N: Axial force [N], shape (n,).
        axial_std_N: Its standard deviation [N], shape (n,).
        force_N: Force on the tool [N], shape (n, 3).
        torque_Nm: Torque on the tool [Nm], shape (n, 3).
        std: Standard deviations of the estimated components, shape (n, k): k = 1 axial force,
            3 force [N], 6 force and torque [N, Nm].
        misfit: Of the joint torques to the assumed contact, see `WrenchEstimate`, shape (n,).
        cautions: Sum of the values of `SensorWarning`, shape (n,).
        status: `STATUS_CODES`, shape (n,).
        after_gap: Whether the filters started anew because of a gap in time before the row,
            shape (n,).
    """

    t_s: NDArray[np.float64]
    travel_m: NDArray[np.float64]
    axial_N: NDArray[np.float64]
    axial_std_N: NDArray[np.float64]
    force_N: NDArray[np.float64]
    torque_Nm: NDArray[np.float64]
    std: NDArray[np.float64]
    model_mismatch: NDArray[np.float64]
    warnings: NDArray[np.int64]
    status: NDArray[np.int64]
    after_gap: NDArray[np.bool_]

    def has_status(self, status: Status) -> NDArray[np.bool_]:
        """Return which rows have a status, shape (n,)."""
        return self.status == STATUS_CODES[status]

    def columns(self) -> dict[str, NDArray]:
        """Return the fields by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @classmethod
    def of_columns(cls, columns: Mapping[str, NDArray]) -> "ForceRows":
        """Return the rows whose `columns` these are."""
        return cls(**{item.name: columns[item.name] for item in fields(cls)})


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
            if estimate.status is Status.REJECTED:
                self._count(estimate.message if advances else "time does not advance")
                gaps.append(False)
            else:
                taring.after(now_s, estimate.status)
                if (
                    estimate.warnings & SensorWarning.VELOCITY
                    and estimate.status is not Status.INITIALIZING
                ):
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
            return self._sensor.update_external_torque(q, None, torque, dt_s)
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
        model_mismatch=np.array([estimate.model_mismatch for estimate in estimates]),
        warnings=np.array([int(estimate.warnings) for estimate in estimates]),
        status=np.array([STATUS_CODES[estimate.status] for estimate in estimates]),
        after_gap=np.array(gaps),
    )
    skipped = rows.has_status(Status.REJECTED)
    if skipped.any():
        numbers = (rows.axial_N, rows.axial_std_N, rows.force_N, rows.torque_Nm, rows.std)
        for values in (*numbers, rows.model_mismatch):
            values[skipped] = np.nan
    return rows


# The median of a stream of values, in memory that does not grow.


_MOST_VALUES = 8192


class ThinnedMedian:
    """Exact for few values; of many, the median of every second, fourth, eighth, ..."""

    def __init__(self) -> None:
        self._kept = np.empty(0)
        self._stride, self._seen = 1, 0

    def add(self, values: NDArray[np.float64]) -> None:
        """Take further values, shape (n,)."""
        first = -self._seen % self._stride
        self._kept = np.concatenate((self._kept, values[first :: self._stride]))
        self._seen += len(values)
        while len(self._kept) > _MOST_VALUES:
            self._kept = self._kept[::2]
            self._stride *= 2

    @property
    def value(self) -> float:
        """The median; nan of nothing."""
        return float(np.median(self._kept)) if len(self._kept) else math.nan


# What the summary tells about the estimates of a log of any length.


class ForceStatistics:
    """Counts rows and remembers ranges; memory stays bounded."""

    def __init__(self) -> None:
        self.rows = 0
        self.first_s, self.last_s = math.inf, -math.inf
        self._steps = ThinnedMedian()
        self.warnings: Counter[SensorWarning] = Counter()
        """Rows with each caution."""
        self._of_status = {status: StatusStatistics() for status in Status}

    def add(self, rows: ForceRows) -> None:
        """Take further rows."""
        latest_s = np.maximum.accumulate(np.concatenate(([self.last_s], rows.t_s)))
        steps = np.diff(latest_s)
        self._steps.add(steps[(steps > 0.0) & np.isfinite(steps)])
        self.rows += len(rows.t_s)
        self.first_s = min(self.first_s, float(rows.t_s.min()))
        self.last_s = float(latest_s[-1])
        for caution in SensorWarning:
            self.warnings[caution] += int(np.count_nonzero(rows.warnings & caution))
        for status in Status:
            chosen = rows.has_status(status)
            if chosen.any():
                self._of_status[status].add(rows.axial_N[chosen], rows.axial_std_N[chosen])

    def __getitem__(self, status: Status) -> "StatusStatistics":
        """Return what is known about the rows of one status."""
        return self._of_status[status]

    @property
    def step_s(self) -> float:
        """Median time step [s] of rows that advance."""
        return self._steps.value


class StatusStatistics:
    """Number, range and typical standard deviation of rows."""

    def __init__(self) -> None:
        self.count = 0
        self.least_N, self.largest_N = math.inf, -math.inf
        self._std = ThinnedMedian()

    def add(self, axial_N: NDArray[np.float64], axial_std_N: NDArray[np.float64]) -> None:
        """Take the rows' axial forces and their standard deviations [N]."""
        self.count += len(axial_N)
        self.least_N = min(self.least_N, float(axial_N.min()))
        self.largest_N = max(self.largest_N, float(axial_N.max()))
        self._std.add(axial_std_N)

    @property
    def std_N(self) -> float:
        """Median standard deviation [N]."""
        return self._std.value


# What the command found out, for the summary, pictures and reports.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceResult:
    """The outcome of a whole log, of bounded size however long the log.

    Attributes:
        log: What the log is called.
        robot: The arm with its payload.
        config: Settings of the sensor.
        is_external: Whether the robot's own external torque was used.
        has_velocity: Whether the log had joint velocities.
        replay: The sensor after the log: tare, lag, skipped rows, gaps.
        statistics: Numbers about all rows.
        overview: So many rows as a picture needs; all rows of a short log, of a long one those in
            which a force is least or largest for a while.
    """

    log: str
    robot: Robot
    config: SensorConfig
    is_external: bool
    has_velocity: bool
    replay: Replay
    statistics: ForceStatistics
    overview: ForceRows

    @property
    def sensor_line(self) -> str:
        """What was estimated from what, in one line."""
        config = self.config
        frame = config.frame if config.frame is not None else self.robot.tool_frame
        where = f"{config.mode} force at {frame}" if config.mode != "full" else f"wrench at {frame}"
        if self.is_external:
            return f"{where}, from the robot's own external torque"
        velocity = "velocity from the log" if self.has_velocity else "velocity estimated"
        return f"{where}, K = {config.gain_per_s:g} 1/s, {velocity}"
