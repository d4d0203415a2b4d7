"""The virtual sensor over a log, sample by sample, as it would have run on the robot."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from residual.command.joint_signals import JointSignals
from residual.command.taring import TareDone, TareRequest, Taring
from residual.sensor_config import SensorConfig
from residual.virtual_force_sensor import VirtualForceSensor
from residual.wrench_estimate import Status, WrenchEstimate
from urdf import Robot

STATUS_CODES = {Status.OK: 0, Status.NOT_TARED: 1, Status.SETTLING: 2, Status.SKIPPED: 3}
"""How a status is written to a file of numbers."""

_CHUNK = 500


@dataclass(slots=True, kw_only=True, eq=False)
class Replay:
    """The estimates of a whole log, one row per row of the log; NaN where a row was skipped.

    Attributes:
        t_s: Time stamps as in the log [s], shape (n,).
        axial_N: Axial force [N], shape (n,).
        axial_std_N: Its standard deviation [N], shape (n,).
        force_N: Force on the tool [N], shape (n, 3).
        torque_Nm: Torque on the tool [Nm], shape (n, 3).
        std: Standard deviations of the estimated components, shape (n, k): k = 1 axial force,
            3 force [N], 6 force and torque [N, Nm].
        status: `STATUS_CODES`, shape (n,).
        skipped: Reasons for skipped rows, counted.
        gaps_s: Lengths of gaps in time after which the filters start anew [s].
        lag_s: Time by which the estimate follows the force [s].
        tare: The tare, if one was taken.
    """

    t_s: NDArray[np.float64]
    axial_N: NDArray[np.float64]
    axial_std_N: NDArray[np.float64]
    force_N: NDArray[np.float64]
    torque_Nm: NDArray[np.float64]
    std: NDArray[np.float64]
    status: NDArray[np.int64]
    skipped: Counter[str] = field(default_factory=Counter)
    gaps_s: list[float] = field(default_factory=list)
    lag_s: float = 0.0
    tare: TareDone | None = None

    def has_status(self, status: Status) -> NDArray[np.bool_]:
        """Return which rows have a status, shape (n,)."""
        return self.status == STATUS_CODES[status]


def replay(
    robot: Robot,
    config: SensorConfig,
    signals: JointSignals,
    request: TareRequest,
    advance: Callable[[int], None] = lambda rows: None,
) -> Replay:
    """Run the sensor over a log.

    Args:
        robot: The arm with its payload.
        config: Settings of the sensor.
        signals: The log.
        request: Where to tare.
        advance: Told now and then how many more rows are done.

    Returns:
        The estimates.

    Raises:
        CommandError: The tare is refused.
        residual.ConfigurationError: A setting is not valid.
        urdf.UrdfError: The configured frame is not on the robot.
    """
    sensor = VirtualForceSensor(robot, config)
    taring = Taring(sensor, request)
    feed = _Feed(sensor, signals)
    result = _empty(signals.t_s, {"axial": 1, "point": 3, "full": 6}[config.mode])
    latest_s = taken_s = float(signals.t_s[0])
    for k, t_s in enumerate(signals.t_s.tolist()):
        advances = k == 0 or t_s > latest_s
        if advances:
            taring.before(t_s)
        estimate = feed(k, t_s - latest_s)
        _store(result, k, estimate, advances)
        if estimate.status is not Status.SKIPPED:
            taring.after(t_s, estimate.status)
            if t_s - taken_s > config.max_gap_s:
                result.gaps_s.append(t_s - taken_s)
            taken_s = t_s
        latest_s = max(latest_s, t_s)
        if k % _CHUNK == _CHUNK - 1:
            advance(_CHUNK)
    taring.finish(latest_s)
    advance(len(signals) % _CHUNK)
    result.lag_s, result.tare = sensor.lag_s, taring.done
    return result


class _Feed:
    """Gives row k of a log to the sensor, by the call that fits it."""

    def __init__(self, sensor: VirtualForceSensor, signals: JointSignals) -> None:
        self._sensor, self._signals = sensor, signals

    def __call__(self, k: int, dt_s: float) -> WrenchEstimate:
        signals = self._signals
        q, torque = signals.q_rad[k], signals.torque_Nm[k]
        if signals.is_external:
            return self._sensor.update_external_torque(q, torque, dt_s)
        dq = None if signals.dq_rad_s is None else signals.dq_rad_s[k]
        return self._sensor.update(q, dq, torque, dt_s)


def _empty(t_s: NDArray[np.float64], components: int) -> Replay:
    rows = len(t_s)
    return Replay(
        t_s=t_s,
        axial_N=np.full(rows, np.nan),
        axial_std_N=np.full(rows, np.nan),
        force_N=np.full((rows, 3), np.nan),
        torque_Nm=np.full((rows, 3), np.nan),
        std=np.full((rows, components), np.nan),
        status=np.zeros(rows, dtype=np.int64),
    )


def _store(result: Replay, k: int, estimate: WrenchEstimate, advances: bool) -> None:
    result.status[k] = STATUS_CODES[estimate.status]
    if estimate.status is Status.SKIPPED:
        reason = estimate.message.split(";")[0] if advances else "time does not advance"
        result.skipped[reason] += 1
        return
    result.axial_N[k] = estimate.axial
    result.axial_std_N[k] = estimate.axial_std
    result.force_N[k] = estimate.force
    result.torque_Nm[k] = estimate.torque
    result.std[k] = np.sqrt(np.diag(estimate.covariance))
