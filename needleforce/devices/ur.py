"""UR e-Series through RTDE, with the client library ur_rtde.

The client is imported when an arm is opened.
"""

from collections.abc import Iterator
from time import sleep
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.devices.checked_arm import ArmSignals, CheckedArm
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.errors import DeviceSettingError, LinkError, import_client
from needleforce.devices.link import ArmReading
from needleforce.devices.ur_control import (
    JOINTS,
    PROGRAM_ENDED,
    UrControl,
    describe_controller,
)

UR_RATE_HZ = 500.0


class UrArm(CheckedArm):
    """A UR e-Series arm through RTDE; torques are motor currents times a constant.

    Without the constants there are currents only: see docs/how-to/your-robot.md for
    what a UR can give. With ``takes_commands`` the client library runs a program on the
    controller, which has to be in remote control. A program that is not heard for 100
    ms ends, and the arm stands; `close` and the end of the process brake it.

    Args:
        host: Address of the arm.
        takes_commands: Whether it shall move; otherwise it is only listened to.
        torque_constant_Nm_A: Joint torque per motor current, shape (6,); None if it is
            not known.
        rate_hz: How often the arm sends.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        preset: Name of its limits, see `needleforce.control.Limits.of_arm`: those of a
            UR5e, and the speeds of the model where they are lower.

    Raises:
        MissingClientError: ur_rtde is not installed.
        LinkError: The arm does not answer, or takes no commands.
        DeviceSettingError: Constants that are not six positive numbers, or no positive
            rate.
    """

    preset = "ur5e"

    def __init__(
        self,
        host: str = LOOPBACK,
        *,
        takes_commands: bool = False,
        torque_constant_Nm_A: ArrayLike | None = None,
        rate_hz: float = UR_RATE_HZ,
        robot: Any = None,
    ) -> None:
        if not 0.0 < rate_hz < np.inf:
            raise DeviceSettingError(f"{rate_hz=}: expected a positive number")

        super().__init__(JOINTS, 1.0 / rate_hz, robot)
        self._guard = self._make_guard(1.0 / rate_hz)
        self._constant_Nm_A: Array | None = None
        if torque_constant_Nm_A is not None:
            constant_Nm_A = np.array(torque_constant_Nm_A, dtype=float)
            is_shaped = constant_Nm_A.shape == (JOINTS,)
            if not (is_shaped and (constant_Nm_A > 0.0).all()):
                raise DeviceSettingError(
                    f"{torque_constant_Nm_A=}: expected six positive numbers"
                )

            self._constant_Nm_A = constant_Nm_A

        library = import_client("rtde_receive", "ur_rtde")
        try:
            # What is asked for through RTDE.
            ur_signals = ("timestamp", "actual_q", "actual_qd", "actual_current")
            self._arm: Any = library.RTDEReceiveInterface(
                host, rate_hz, list(ur_signals)
            )
        except RuntimeError as error:
            software = describe_controller(host)
            raise LinkError(f"no UR arm at {host}{software}: {error}") from error

        self._control: UrControl | None = None
        if takes_commands:
            try:
                self._control = UrControl(host, rate_hz, self._guard)
            except Exception:
                self._arm.disconnect()
                raise

    def __iter__(self) -> Iterator[ArmReading]:
        """Yield readings as they come.

        The client keeps only the newest, so some are missed.

        Raises:
            LinkError: An arm that is commanded has stopped.
        """
        while self._is_open and self._arm.isConnected():
            time_s = self._arm.getTimestamp()
            if time_s > self._latest_s:
                signals = self._read_signals(time_s)
                if signals is not None:
                    yield from self._readings(signals)
            else:  # the client holds the newest only: look oftener than it comes
                # Fraction of a period between two looks for a newer reading.
                poll_ratio = 0.2
                sleep(poll_ratio * self._period_s)

        if self._is_open:
            self.report.outages += 1

    def _read_signals(self, time_s: float) -> ArmSignals | None:
        """Return the signals of a time; None if a newer package came meanwhile."""
        # The currents are checked in place of torques, which may not be known.
        signals = ArmSignals(
            time_s=time_s,
            q_rad=np.array(self._arm.getActualQ()),
            dq_rad_s=np.array(self._arm.getActualQd()),
            effort=np.array(self._arm.getActualCurrent()),
        )
        return signals if self._arm.getTimestamp() == time_s else None

    def _readings(self, signals: ArmSignals) -> Iterator[ArmReading]:
        """Yield signals as a reading, if they are valid and new."""
        current_A = signals.effort
        constant_Nm_A = self._constant_Nm_A
        tau_Nm = None if constant_Nm_A is None else constant_Nm_A * current_A
        control = self._control
        if control is not None and self._is_open:
            control.pass_cycle(signals.q_rad)

        for reading in self._checked(signals):
            yield reading._replace(tau_Nm=tau_Nm, current_A=current_A)

    def _find_refusal(self) -> str:
        if self._control is None:
            return "the arm was opened without takes_commands=True"
        return "" if self._control.is_running else PROGRAM_ENDED

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """Command a joint velocity; see `GuardedArm.send`."""
        if not super().send(dq_rad_s) or self._control is None:
            return False
        return self._control.send_once()

    def close(self) -> None:
        """Brake the arm to rest if it was commanded, end readings and connection."""
        super().close()
        if self._control is not None:
            self._control.stop()

        self._arm.disconnect()
