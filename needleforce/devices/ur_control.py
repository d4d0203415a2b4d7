"""The motion of a UR arm: velocities through RTDE, a watchdog, and a stop on every way.

The client library runs a program of its own on the controller. That program ends by
itself, and the arm stands, when it hears nothing for `1 / WATCHDOG_HZ`.
"""

import socket
from contextlib import suppress
from time import sleep
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.errors import LinkError, import_client
from needleforce.devices.guard import Guard

JOINTS = 6

WATCHDOG_HZ = 10.0
"""The program on the controller ends when it is heard less often: a loop may pause for
100 ms."""

ACCELERATION_rad_s2 = 10.0
"""With which the controller reaches velocities: above that of the guard, whose
velocities so pass unchanged."""

DASHBOARD_PORT = 29999
"""Of the controller, for questions in plain text."""

ANSWER_WAIT_S = 1.0
"""So long the dashboard may take to answer."""

PROGRAM_ENDED = "the program on the controller has ended"

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
        guard: Of the commands.

    Raises:
        MissingClientError: ur_rtde is not installed.
        LinkError: The arm does not take the program.
    """

    def __init__(self, host: str, rate_hz: float, guard: Guard) -> None:
        library = import_client("rtde_control", "ur_rtde")
        self._period_s = 1.0 / rate_hz
        self._guard = guard
        self._place_rad = np.zeros(JOINTS)
        self._is_cycle_sent = True  # whether this cycle's velocity has been sent
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

    @property
    def is_running(self) -> bool:
        """Whether the program on the controller takes commands."""
        return self._client is not None and self._client.isProgramRunning()

    def send_once(self) -> bool:
        """Send this cycle's velocity, if it is not; return whether it was taken."""
        if self._is_cycle_sent:
            return self.is_running
        self._is_cycle_sent = True
        velocity_rad_s = self._guard.advance(self._place_rad).tolist()
        is_taken = self.is_running and self._client.speedJ(
            velocity_rad_s, ACCELERATION_rad_s2, self._period_s
        )
        if not self.is_running:  # the arm stands
            self._guard.anchor()
            return self._guard.refuse(PROGRAM_ENDED)
        if not is_taken:  # the arm goes on as it was
            self._guard.interrupt()
            return self._guard.refuse("the controller has not taken the command")
        return True

    def pass_cycle(self, place_rad: Array) -> None:
        """Begin a cycle with the arm there; go on without a command for the last one.

        Raises:
            LinkError: The program on the controller has ended.
        """
        if not self.is_running:
            self._guard.anchor()
            self._guard.interrupt()
            raise LinkError(
                "the UR arm has stopped: its program has ended, after "
                f"{1.0 / WATCHDOG_HZ:g} s without a cycle of this one, a protective "
                "stop, or by its panel",
                "Release it at its own panel, see to the cause that the "
                "message names, and open the connection again.",
            )

        self._place_rad = place_rad
        if self._guard.is_at_rest:
            self._client.kickWatchdog()
        else:
            self.send_once()
        self._is_cycle_sent = False

    def stop(self) -> None:
        """Brake the arm to rest, and end the program on the controller."""
        self._guard.brake()
        while self.is_running and not self._guard.is_at_rest:
            self._is_cycle_sent = False
            self.send_once()
            sleep(self._period_s)
        client = self._client
        self._client = None
        if client is None:
            return

        with suppress(RuntimeError):
            if client.isProgramRunning():
                client.speedStop(ACCELERATION_rad_s2)
                client.stopScript()

        with suppress(RuntimeError):
            client.disconnect()
