"""UR e-Series through RTDE, with the client library ur_rtde.

The client is imported when an arm is opened. To move the arm it runs a program of its
own on the controller, which ends, so that the arm stands, when it hears nothing for
`1 / WATCHDOG_HZ`.
"""

from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.devices.client_arm import ClientArm, StampedReading
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.errors import DeviceSettingError, import_client
from needleforce.devices.link import GIVE_UP_S, ArmReading

JOINTS = 6

UR_RATE_HZ = 500.0

WATCHDOG_HZ = 10.0
"""The program on the controller ends when it is heard less often: a loop may pause for
100 ms."""

ACCELERATION_rad_s2 = 10.0
"""With which the controller reaches velocities: above that of the guard, whose
velocities so pass unchanged."""


class UrArm(ClientArm):
    """A UR e-Series arm through RTDE; torques are motor currents times a constant.

    Without the constants there are currents only: see docs/how-to/arm-ur.md for
    what a UR can give. With ``takes_commands`` the client library runs a program on the
    controller, which has to be in remote control. A program that is not heard for 100
    ms ends, and the arm stands; `close` and the end of the process brake it.

    Args:
        host: Address of the arm.
        takes_commands: Whether it shall move; otherwise it is only listened to.
        torque_constant_Nm_A: Joint torque per motor current, shape (6,); None if it is
            not known.
        rate_hz: How often the arm sends.
        give_up_s: After so long a silence the arm is lost.
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
        give_up_s: float = GIVE_UP_S,
        robot: Any = None,
    ) -> None:
        if not 0.0 < rate_hz < np.inf:
            raise DeviceSettingError(f"{rate_hz=}: expected a positive number")
        self._constant_Nm_A: Array | None = None
        if torque_constant_Nm_A is not None:
            self._constant_Nm_A = np.array(torque_constant_Nm_A, dtype=float)
            is_six = self._constant_Nm_A.shape == (JOINTS,)
            if not (is_six and (self._constant_Nm_A > 0.0).all()):
                raise DeviceSettingError(
                    f"{torque_constant_Nm_A=}: expected six positive numbers"
                )

        self._rate_hz = rate_hz
        self._receiver: Any = None
        self._control: Any = None
        self._stamp_s = -1.0  # of what was read last
        super().__init__(
            host,
            JOINTS,
            1.0 / rate_hz,
            (RuntimeError,),
            takes_commands=takes_commands,
            give_up_s=give_up_s,
            robot=robot,
        )

    def _connect(self) -> None:
        receiving = import_client("rtde_receive", "ur_rtde")
        # What is asked for through RTDE.
        signals = ["timestamp", "actual_q", "actual_qd", "actual_current"]
        self._receiver = receiving.RTDEReceiveInterface(
            self._host, self._rate_hz, signals
        )
        if self.takes_commands:
            commanding = import_client("rtde_control", "ur_rtde")
            self._control = commanding.RTDEControlInterface(self._host, self._rate_hz)
            self._control.setWatchdog(WATCHDOG_HZ)

    def _read_client(self) -> StampedReading | None:
        receiver = self._receiver
        if not receiver.isConnected():
            raise RuntimeError("the connection has ended")
        stamp_s = receiver.getTimestamp()
        if stamp_s == self._stamp_s:
            return None
        current_A = np.array(receiver.getActualCurrent())
        has_constants = self._constant_Nm_A is not None
        reading = ArmReading(
            dt_s=self._period_s,
            q_rad=np.array(receiver.getActualQ()),
            dq_rad_s=np.array(receiver.getActualQd()),
            tau_Nm=self._constant_Nm_A * current_A if has_constants else None,
            external_Nm=None,
            missed=0,
            accepts_commands=False,
            current_A=current_A,
            is_real=True,
        )
        # A newer package may have come meanwhile.
        if receiver.getTimestamp() != stamp_s:
            return None
        self._stamp_s = stamp_s
        return stamp_s, reading

    def _move(self, velocity_rad_s: Array | None) -> None:
        control = self._control
        if not control.isProgramRunning():
            raise RuntimeError(
                "its program has ended, by a protective stop, by its panel, or after "
                f"{1.0 / WATCHDOG_HZ:g} s without a cycle of this one"
            )
        if velocity_rad_s is None:
            control.kickWatchdog()
        elif not control.speedJ(
            velocity_rad_s.tolist(), ACCELERATION_rad_s2, self._period_s
        ):
            self._guard.interrupt()  # the arm goes on as it was

    def _release(self) -> None:
        if self._control is not None:
            with suppress(RuntimeError):
                if self._control.isProgramRunning():
                    self._control.speedStop(ACCELERATION_rad_s2)
                    self._control.stopScript()
                self._control.disconnect()
        self._control = None
        if self._receiver is not None:
            self._receiver.disconnect()
