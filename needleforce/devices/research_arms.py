"""Arms whose vendors' client libraries are on the package index: Franka FER and UR
e-Series.

Both are read only here: samples in, no commands. The clients are imported when an arm
is opened.
"""

from collections.abc import Iterator
from time import sleep
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from needleforce.devices.proxy import (
    LOOPBACK,
    ArmSample,
    Array,
    DeviceSettingError,
    LinkError,
    ReadOnlyArm,
    client,
)

POLLS = 0.2  # Of a period, between two looks for a newer sample
UR_JOINTS = 6
FRANKA_JOINTS = 7
FRANKA_PERIOD_s = 1e-3
UR_SIGNALS = ("timestamp", "actual_q", "actual_qd", "actual_current")


class _VendorArm(ReadOnlyArm):
    """What both have in common: checks and counts of samples."""

    def __init__(self, joints: int, period_s: float, robot: Any) -> None:
        super().__init__()
        self.robot = robot
        self.joints = joints
        self._period_s = period_s
        self._last_s = -np.inf

    def _checked(
        self, time_s: float, q: Array, *others: Array | None
    ) -> Iterator[ArmSample]:
        """Position, velocity, torque, external torque as a sample, if they are valid
        and new.
        """
        report = self.report
        gap_s = time_s - self._last_s
        given = [each for each in (q, *others) if each is not None]
        if not all(np.isfinite(x).all() and len(x) == self.joints for x in given):
            report.malformed += 1
            return
        if gap_s <= 0.0:
            report.stale += 1
            return
        dt_s = gap_s if np.isfinite(gap_s) else self._period_s
        missed = max(round(dt_s / self._period_s) - 1, 0)
        self._last_s = time_s
        report.use(missed + 1, dt_s)
        yield ArmSample(dt_s, q, *others, missed=missed, accepts_commands=False)


class FrankaArm(_VendorArm):
    """A Franka FER (Panda) through libfranka: 1 kHz; `external_Nm` is its own filtered
    estimate.

    Raises:
        MissingClientError: panda-python is not installed.
        LinkError: The arm does not answer, or speaks another version.
    """

    def __init__(self, host: str = LOOPBACK, *, robot: Any = None) -> None:
        super().__init__(FRANKA_JOINTS, FRANKA_PERIOD_s, robot)
        library = client("panda_py.libfranka", "panda-python")
        try:
            self._arm = library.Robot(host, library.RealtimeConfig.kIgnore)
        except RuntimeError as error:
            raise LinkError(
                f"no Franka arm at {host}: {error}; is its FCI activated?"
            ) from error

    def __iter__(self) -> Iterator[ArmSample]:
        """Samples as they come; ends when the arm stays away."""
        while self._is_open:
            try:
                state = self._arm.read_once()
            except RuntimeError:
                self.report.outages += 1
                return
            signals = (state.q, state.dq, state.tau_J, state.tau_ext_hat_filtered)
            yield from self._checked(
                1e-3 * state.time.to_msec(), *map(np.asarray, signals)
            )


class UrArm(_VendorArm):
    """A UR e-Series arm through RTDE: 500 Hz; torques are motor currents times a
    constant.

    Without the constants there are currents only: see docs/panda.md for what a UR can
    give.

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
        rate_hz: float = 500.0,
        robot: Any = None,
    ) -> None:
        if not 0.0 < rate_hz < np.inf:
            raise DeviceSettingError(f"{rate_hz=}: expected a positive number")
        super().__init__(UR_JOINTS, 1.0 / rate_hz, robot)
        given = torque_constant_Nm_A
        self._constant = constant = (
            None if given is None else np.array(given, dtype=float)
        )
        if constant is not None and (
            constant.shape != (UR_JOINTS,) or not (constant > 0.0).all()
        ):
            what = f"torque_constant_Nm_A={given!r}"
            raise DeviceSettingError(f"{what}: expected six positive numbers")
        library = client("rtde_receive", "ur_rtde")
        try:
            self._arm = library.RTDEReceiveInterface(host, rate_hz, list(UR_SIGNALS))
        except RuntimeError as error:
            raise LinkError(f"no UR arm at {host}: {error}") from error

    def __iter__(self) -> Iterator[ArmSample]:
        """Samples as they come; the client keeps only the newest, so some are
        missed.
        """
        while self._is_open and self._arm.isConnected():
            time_s = self._arm.getTimestamp()
            if time_s > self._last_s:
                reads = (
                    self._arm.getActualQ,
                    self._arm.getActualQd,
                    self._arm.getActualCurrent,
                )
                q, dq, current = (np.array(read()) for read in reads)
                if self._arm.getTimestamp() != time_s:
                    continue  # parts of two packages
                tau = None if self._constant is None else self._constant * current
                for sample in self._checked(time_s, q, dq, current, None):
                    yield sample._replace(tau_Nm=tau, current_A=current)
            else:  # the client holds the newest only: look oftener than it comes
                sleep(POLLS * self._period_s)
        if self._is_open:
            self.report.outages += 1

    def close(self) -> None:
        """End the samples and the connection."""
        super().close()
        self._arm.disconnect()
