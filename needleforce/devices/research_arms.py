"""Franka FER and UR e-Series, whose client libraries are on the package index.

Both are read only here: readings in, no commands. The clients are imported when an arm
is opened.
"""

from collections.abc import Iterator
from time import sleep
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.errors import DeviceSettingError, LinkError, import_client
from needleforce.devices.link import ArmReading, ReadOnlyArm

POLL_RATIO = 0.2
"""Fraction of a period between two looks for a newer reading."""

FRANKA_JOINTS = 7
FRANKA_PERIOD_S = 1e-3

UR_JOINTS = 6
UR_RATE_HZ = 500.0
UR_SIGNALS = ("timestamp", "actual_q", "actual_qd", "actual_current")
"""What is asked for through RTDE."""


class _VendorArm(ReadOnlyArm):
    """What both arms have in common: checks and counts of readings."""

    def __init__(self, joints: int, period_s: float, robot: Any) -> None:
        super().__init__()
        self.robot = robot
        self.joints = joints
        self._period_s = period_s
        self._latest_s = -np.inf

    def _checked(
        self,
        time_s: float,
        q_rad: Array,
        dq_rad_s: Array,
        tau_Nm: Array,
        external_Nm: Array | None,
    ) -> Iterator[ArmReading]:
        """Yield the signals of a time as a reading, if they are valid and new."""
        gap_s = time_s - self._latest_s
        signals = [q_rad, dq_rad_s, tau_Nm]
        if external_Nm is not None:
            signals.append(external_Nm)
        if not all(self._is_valid(signal) for signal in signals):
            self.report.malformed += 1
            return
        if gap_s <= 0.0:
            self.report.stale += 1
            return

        dt_s = gap_s if np.isfinite(gap_s) else self._period_s
        missed = max(round(dt_s / self._period_s) - 1, 0)
        self._latest_s = time_s
        self.report.count_used(missed + 1, dt_s)
        yield ArmReading(
            dt_s=dt_s,
            q_rad=q_rad,
            dq_rad_s=dq_rad_s,
            tau_Nm=tau_Nm,
            external_Nm=external_Nm,
            missed=missed,
            accepts_commands=False,
        )

    def _is_valid(self, signal: Array) -> bool:
        """Return whether a signal has one finite number for each joint."""
        return bool(np.isfinite(signal).all()) and len(signal) == self.joints


class FrankaArm(_VendorArm):
    """A Franka FER (Panda) through libfranka, at 1 kHz.

    `external_Nm` is its own filtered estimate.

    Args:
        host: Address of the arm.
        robot: The model of the arm, kept for those who need both.

    Raises:
        MissingClientError: panda-python is not installed.
        LinkError: The arm does not answer, or speaks another version.
    """

    def __init__(self, host: str = LOOPBACK, *, robot: Any = None) -> None:
        super().__init__(FRANKA_JOINTS, FRANKA_PERIOD_S, robot)
        library = import_client("panda_py.libfranka", "panda-python")
        try:
            self._arm = library.Robot(host, library.RealtimeConfig.kIgnore)
        except RuntimeError as error:
            raise LinkError(
                f"no Franka arm at {host}: {error}; is its FCI activated?"
            ) from error

    def __iter__(self) -> Iterator[ArmReading]:
        """Yield readings as they come, until the arm stays away."""
        while self._is_open:
            try:
                state = self._arm.read_once()
            except RuntimeError:
                self.report.outages += 1
                return

            yield from self._checked(
                time_s=1e-3 * state.time.to_msec(),
                q_rad=np.asarray(state.q),
                dq_rad_s=np.asarray(state.dq),
                tau_Nm=np.asarray(state.tau_J),
                external_Nm=np.asarray(state.tau_ext_hat_filtered),
            )


class _UrSignals(NamedTuple):
    """What a UR arm reports at a time.

    Attributes:
        time_s: On the arm's clock.
        q_rad: Joint positions, shape (6,).
        dq_rad_s: Joint velocities, shape (6,).
        current_A: Motor currents, shape (6,).
    """

    time_s: float
    q_rad: Array
    dq_rad_s: Array
    current_A: Array


class UrArm(_VendorArm):
    """A UR e-Series arm through RTDE; torques are motor currents times a constant.

    Without the constants there are currents only: see docs/how-to/your-robot.md for
    what a UR can give.

    Args:
        host: Address of the arm.
        torque_constant_Nm_A: Joint torque per motor current, shape (6,); None if it is
            not known.
        rate_hz: How often the arm sends.
        robot: The model of the arm, kept for those who need both.

    Raises:
        MissingClientError: ur_rtde is not installed.
        LinkError: The arm does not answer.
        DeviceSettingError: Constants that are not six positive numbers, or no positive
            rate.
    """

    def __init__(
        self,
        host: str = LOOPBACK,
        *,
        torque_constant_Nm_A: ArrayLike | None = None,
        rate_hz: float = UR_RATE_HZ,
        robot: Any = None,
    ) -> None:
        if not 0.0 < rate_hz < np.inf:
            raise DeviceSettingError(f"{rate_hz=}: expected a positive number")

        super().__init__(UR_JOINTS, 1.0 / rate_hz, robot)
        self._constant_Nm_A: Array | None = None
        if torque_constant_Nm_A is not None:
            constant_Nm_A = np.array(torque_constant_Nm_A, dtype=float)
            is_shaped = constant_Nm_A.shape == (UR_JOINTS,)
            if not (is_shaped and (constant_Nm_A > 0.0).all()):
                raise DeviceSettingError(
                    f"{torque_constant_Nm_A=}: expected six positive numbers"
                )

            self._constant_Nm_A = constant_Nm_A

        library = import_client("rtde_receive", "ur_rtde")
        try:
            self._arm = library.RTDEReceiveInterface(host, rate_hz, list(UR_SIGNALS))
        except RuntimeError as error:
            raise LinkError(f"no UR arm at {host}: {error}") from error

    def __iter__(self) -> Iterator[ArmReading]:
        """Yield readings as they come.

        The client keeps only the newest, so some are missed.
        """
        while self._is_open and self._arm.isConnected():
            time_s = self._arm.getTimestamp()
            if time_s > self._latest_s:
                signals = self._read_signals(time_s)
                if signals is not None:
                    yield from self._readings(signals)
            else:  # the client holds the newest only: look oftener than it comes
                sleep(POLL_RATIO * self._period_s)

        if self._is_open:
            self.report.outages += 1

    def _read_signals(self, time_s: float) -> _UrSignals | None:
        """Return the signals of a time; None if a newer package came meanwhile."""
        signals = _UrSignals(
            time_s=time_s,
            q_rad=np.array(self._arm.getActualQ()),
            dq_rad_s=np.array(self._arm.getActualQd()),
            current_A=np.array(self._arm.getActualCurrent()),
        )
        return signals if self._arm.getTimestamp() == time_s else None

    def _readings(self, signals: _UrSignals) -> Iterator[ArmReading]:
        """Yield signals as a reading, if they are valid and new."""
        time_s, q_rad, dq_rad_s, current_A = signals
        constant_Nm_A = self._constant_Nm_A
        tau_Nm = None if constant_Nm_A is None else constant_Nm_A * current_A
        # The currents are checked in place of torques, which may not be known.
        for reading in self._checked(time_s, q_rad, dq_rad_s, current_A, None):
            yield reading._replace(tau_Nm=tau_Nm, current_A=current_A)

    def close(self) -> None:
        """End the readings and the connection."""
        super().close()
        self._arm.disconnect()
