"""The virtual sensor over a log, sample by sample, as on the robot."""

import math
from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from needleforce.cli.logs.tare_schedule import TareSchedule, TareWindow
from needleforce.cli.shared_options import SensorOptions
from needleforce.cli.terminal import CommandError
from needleforce.recordings.log_stream import LogChunk
from residual import SensorConfig, SensorWarning, Status, VirtualForceSensor
from residual.checks.input import ROUNDING_S
from residual.estimate import WrenchEstimate
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

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


class SensorReplay:
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
        self._taring: TareSchedule | None = None
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
            self._taring = TareSchedule(
                self.sensor, self.rejected, self._options, t_s[0]
            )
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
