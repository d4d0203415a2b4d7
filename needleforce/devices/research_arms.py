"""Arms whose vendors' client libraries are on the package index: Franka FER and UR e-Series.

Both are read only here: samples in, no commands. The clients are imported when an arm is opened.
"""

from collections.abc import Iterator
from importlib import import_module
from time import sleep
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from needleforce.devices.proxy import (
    LOOPBACK,
    ArmSample,
    Array,
    DeviceSettingError,
    Link,
    LinkError,
    LinkReport,
    MissingClientError,
)

FRANKA_PERIOD_s = 1e-3
POLLS = 0.2  # Of a period, between two looks for a newer sample
UR_JOINTS, FRANKA_JOINTS = 6, 7
UR_SIGNALS = ("timestamp", "actual_q", "actual_qd", "actual_current")


def client(module: str, package: str) -> ModuleType:
    """A vendor's library; `MissingClientError` where it is not installed."""
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingClientError(f"{package} is not installed; pip install {package}") from error


class _ReadOnlyArm(Link):
    """What both have in common: checks and counts of samples."""

    def __init__(self, joints: int, period_s: float, robot: Any) -> None:
        self.report, self.robot, self.joints = LinkReport(), robot, joints
        self._period_s, self._last_s, self._is_open = period_s, -np.inf, True

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """No command is taken: False."""
        return False

    def close(self) -> None:
        """End the samples."""
        self._is_open = False

    def _sample(self, time_s: float, *signals: Array | None) -> ArmSample | None:
        """Position, velocity, torque, external torque as a sample; None if not valid or old."""
        report, gap_s = self.report, time_s - self._last_s
        given = [each for each in signals if each is not None]
        if not all(np.isfinite(x).all() and len(x) == self.joints for x in given):
            report.malformed += 1
            return None
        if gap_s <= 0.0:
            report.stale += 1
            return None
        dt_s = gap_s if np.isfinite(gap_s) else self._period_s
        missed = max(round(dt_s / self._period_s) - 1, 0)
        self._last_s = time_s
        report.use(missed + 1, dt_s)
        q, dq, tau, external = signals
        assert q is not None
        return ArmSample(dt_s, q, dq, tau, external, missed, accepts_commands=False)


class FrankaArm(_ReadOnlyArm):
    """A Franka FER (Panda) through libfranka: 1 kHz, torques behind the gears.

    ``tau_Nm`` is the measured torque of the links with gravity; ``external_Nm`` libfranka's own
    filtered estimate.
    """

    def __init__(self, host: str = LOOPBACK, *, robot: Any = None) -> None:
        """Connect.

        Raises:
            MissingClientError: panda-python is not installed.
            LinkError: The arm does not answer, or speaks another version.
        """
        super().__init__(FRANKA_JOINTS, FRANKA_PERIOD_s, robot)
        library: Any = client("panda_py.libfranka", "panda-python")
        try:
            self._arm = library.Robot(host, library.RealtimeConfig.kIgnore)
        except RuntimeError as error:
            raise LinkError(f"no Franka arm at {host}: {error}; is its FCI activated?") from error

    def __iter__(self) -> Iterator[ArmSample]:
        """Samples as they come; ends when the arm stays away."""
        while self._is_open:
            try:
                state = self._arm.read_once()
            except RuntimeError:
                self.report.outages += 1
                return
            signals = (state.q, state.dq, state.tau_J, state.tau_ext_hat_filtered)
            sample = self._sample(1e-3 * state.time.to_msec(), *map(np.asarray, signals))
            if sample is not None:
                yield sample


class UrArm(_ReadOnlyArm):
    """A UR e-Series arm through RTDE: 500 Hz; torques are motor currents times a constant.

    Without the constants there are currents only: see docs/panda.md for what a UR can give.
    """

    def __init__(
        self,
        host: str = LOOPBACK,
        *,
        torque_constant_Nm_A: ArrayLike | None = None,
        rate_hz: float = 500.0,
        robot: Any = None,
    ) -> None:
        """Connect.

        Raises:
            MissingClientError: ur_rtde is not installed.
            LinkError: The arm does not answer.
            DeviceSettingError: Constants that are not six positive numbers.
        """
        super().__init__(UR_JOINTS, 1.0 / rate_hz, robot)
        self._constant: Array | None = None
        if torque_constant_Nm_A is not None:
            constant = np.array(torque_constant_Nm_A, dtype=float)
            if constant.shape != (UR_JOINTS,) or not (constant > 0.0).all():
                raise DeviceSettingError(
                    f"torque_constant_Nm_A={torque_constant_Nm_A!r}: expected six positive numbers"
                )
            self._constant = constant
        library: Any = client("rtde_receive", "ur_rtde")
        try:
            self._arm = library.RTDEReceiveInterface(host, rate_hz, list(UR_SIGNALS))
        except RuntimeError as error:
            raise LinkError(f"no UR arm at {host}: {error}") from error

    def __iter__(self) -> Iterator[ArmSample]:
        """Samples as they come; the client keeps only the newest, so some are missed."""
        while self._is_open and self._arm.isConnected():
            time_s = self._arm.getTimestamp()
            if time_s > self._last_s:
                reads = self._arm.getActualQ, self._arm.getActualQd, self._arm.getActualCurrent
                q, dq, current = (np.array(read()) for read in reads)
                if self._arm.getTimestamp() != time_s:
                    continue  # parts of two packages
                tau = None if self._constant is None else self._constant * current
                sample = self._sample(time_s, q, dq, tau, None)
                if sample is not None:
                    yield sample._replace(current_A=current)
            else:  # the client holds the newest only: look oftener than it comes
                sleep(POLLS * self._period_s)
        if self._is_open:
            self.report.outages += 1

    def close(self) -> None:
        """End the samples and the connection."""
        super().close()
        self._arm.disconnect()
