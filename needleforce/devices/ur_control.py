"""The motion of a UR arm: velocities through RTDE, a watchdog, and a stop on every way.

The client library runs a program of its own on the controller. That program ends by
itself, and the arm stands, when it hears nothing for `1 / WATCHDOG_HZ`.
"""

import atexit
import socket
from contextlib import suppress
from typing import Any

from foundation.arrays import Array
from needleforce.devices.errors import LinkError, import_client

JOINTS = 6

WATCHDOG_HZ = 10.0
"""The program on the controller ends when it is heard less often: a loop may pause for
100 ms."""

MAX_SILENT_CYCLES = 5
"""A velocity is held for so many cycles without a new one; then the arm brakes."""

ACCELERATION_rad_s2 = 10.0
"""With which velocities are reached: above that of a controller's commands, which so
pass unchanged."""

BRAKE_ACCELERATION_rad_s2 = 5.0
"""With which an arm that is no longer commanded comes to rest."""

DASHBOARD_PORT = 29999
"""Of the controller, for questions in plain text."""

ANSWER_WAIT_S = 1.0
"""So long the dashboard may take to answer."""

CLIENT = "ur_rtde 1.6, for PolyScope 3.3 to 3.15 and 5"
"""The client library, with the software of controllers that it is made for."""


def read_polyscope(host: str) -> str:
    """Return what software a controller says that it runs; empty without an answer.

    Args:
        host: Address of the arm.
    """
    with (
        suppress(OSError),
        socket.create_connection((host, DASHBOARD_PORT), ANSWER_WAIT_S) as link,
        link.makefile("rw", encoding="ascii", errors="replace") as lines,
    ):
        link.settimeout(ANSWER_WAIT_S)
        lines.readline()  # its greeting
        lines.write("PolyscopeVersion\n")
        lines.flush()
        return lines.readline().strip()

    return ""


def describe_controller(host: str) -> str:
    """Return what a message about an arm that cannot be used says of its software."""
    software = read_polyscope(host)
    return f" (it runs {software}; {CLIENT})" if software else ""


class UrControl:
    """Commands velocities until it is stopped.

    Args:
        host: Address of the arm.
        rate_hz: Of the commands.

    Raises:
        MissingClientError: ur_rtde is not installed.
        LinkError: The arm does not take the program.
    """

    def __init__(self, host: str, rate_hz: float) -> None:
        library = import_client("rtde_control", "ur_rtde")
        self._period_s = 1.0 / rate_hz
        self._silent_cycles = MAX_SILENT_CYCLES
        self._is_braked = True
        self._client: Any = None
        try:
            self._client = library.RTDEControlInterface(host, rate_hz)
            self._client.setWatchdog(WATCHDOG_HZ)
        except RuntimeError as error:
            self.stop()
            raise LinkError(
                f"the UR arm at {host} takes no commands{describe_controller(host)}: "
                f"{error}"
            ) from error

        atexit.register(self.stop)

    @property
    def is_running(self) -> bool:
        """Whether the program on the controller takes commands."""
        return self._client is not None and self._client.isProgramRunning()

    def command(self, velocity_rad_s: Array) -> bool:
        """Command a velocity, shape (6,); return whether it was taken."""
        self._silent_cycles = 0
        self._is_braked = False
        return self._set_velocity(velocity_rad_s.tolist(), ACCELERATION_rad_s2)

    def pass_cycle(self) -> None:
        """Let the watchdog know of a cycle; brake after some without a command.

        Raises:
            LinkError: The program on the controller has ended.
        """
        if not self.is_running:
            raise LinkError(
                "the UR arm has stopped: its program has ended, after "
                f"{1.0 / WATCHDOG_HZ:g} s without a cycle of this one, a protective "
                "stop, or by its panel",
                "Release it at its own panel, see to the cause that the "
                "message names, and open the connection again.",
            )

        self._silent_cycles += 1
        if self._silent_cycles > MAX_SILENT_CYCLES and not self._is_braked:
            rest_rad_s = [0.0] * JOINTS
            self._is_braked = self._set_velocity(rest_rad_s, BRAKE_ACCELERATION_rad_s2)
        elif self._is_braked:
            self._client.kickWatchdog()

    def _set_velocity(self, velocity_rad_s: list[float], limit_rad_s2: float) -> bool:
        """Send a velocity; return whether it was taken."""
        return self.is_running and self._client.speedJ(
            velocity_rad_s, limit_rad_s2, self._period_s
        )

    def stop(self) -> None:
        """Brake the arm to rest, and end the program on the controller."""
        client = self._client
        self._client = None
        atexit.unregister(self.stop)
        if client is None:
            return

        with suppress(RuntimeError):
            if client.isProgramRunning():
                client.speedStop(BRAKE_ACCELERATION_rad_s2)
                client.stopScript()

        with suppress(RuntimeError):
            client.disconnect()
