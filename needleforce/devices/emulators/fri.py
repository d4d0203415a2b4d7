"""An emulator of the controller of an LWR, which speaks `devices.fri`."""

import select
import socket
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices import fri
from needleforce.devices.datagram_link import LOOPBACK


@dataclass(frozen=True, kw_only=True)
class FriSettings:
    """What the emulated controller of an LWR does.

    Rows of the signals are sent in turn, one a cycle. Commands move only the reported
    command, unless `delay_cycles` is set.

    Attributes:
        port: To which it sends.
        q_rad: Joint positions, shape (m, 7).
        tau_Nm: Joint torques, shape (m, 7).
        period_s: Of a cycle.
        cycles: After so many it ends; None: when it is stopped.
        extra_wait_s: So much longer a cycle lasts until it is answered; one of a real
            controller never does.
        command_from_s: When it goes from monitoring to commanding.
        delay_cycles: So many cycles after a command the reported position is there;
            None: positions are those of ``q_rad``.
        silent_s: Start and end of a time in which nothing is sent [s].
    """

    port: int
    q_rad: Array
    tau_Nm: Array
    period_s: float = 1e-3
    cycles: int | None = None
    extra_wait_s: float = 0.0
    command_from_s: float = float("inf")
    delay_cycles: int | None = None
    silent_s: tuple[float, float] = (0.0, 0.0)


def emulate_fri(pipe: Connection, settings: FriSettings) -> dict[str, Any]:
    """Emulate the controller of an LWR; a function for `Emulator`.

    Returns:
        Counts of the cycles, and of those that were answered before they ended; and
        the position that was commanded at the end.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as box:
        box.bind((LOOPBACK, 0))
        box.connect((LOOPBACK, settings.port))
        controller = _Controller(settings, box)
        pipe.send({"port": box.getsockname()[1]})
        while controller.cycles != settings.cycles and not pipe.poll():
            controller.run_cycle()
    return {
        "cycles": controller.cycles,
        "same_cycle": controller.answered_in_cycle,
        "commanded_rad": controller.packet["commanded_rad"].copy(),
    }


class _Controller:
    """A controller: sends a measurement every cycle, and takes the answer.

    Attributes:
        cycles: How many have passed.
        answered_in_cycle: How many were answered before they ended.
        packet: The latest measurement.
    """

    def __init__(self, settings: FriSettings, box: socket.socket) -> None:
        self.cycles = 0
        self.answered_in_cycle = 0
        self._settings = settings
        self._box = box
        self._due_s = time.monotonic()
        self.packet = np.zeros((), fri.MEASUREMENT)
        self.packet["size"] = fri.MEASUREMENT.itemsize
        self.packet["kind"] = fri.MEASUREMENT_KIND
        self.packet["quality"] = fri.FriQuality.PERFECT
        self.packet["period_s"] = settings.period_s
        self.packet["commanded_rad"] = settings.q_rad[0]
        length = (settings.delay_cycles or 0) + 1
        self._commanded: deque[Array] = deque([settings.q_rad[0]] * length, length)

    def run_cycle(self) -> None:
        """Send a measurement, and wait for its answer until the cycle is over."""
        settings = self._settings
        t_s = self.cycles * settings.period_s
        self._measure(t_s)
        start_s, stop_s = settings.silent_s
        self._due_s += settings.period_s
        end_s = self._due_s
        if not start_s <= t_s < stop_s:
            end_s += settings.extra_wait_s
            with suppress(ConnectionError):  # nobody listens yet
                self._box.send(self.packet.tobytes())
        # `select` waits for microseconds, a socket's own timeout for milliseconds.
        while (wait_s := end_s - time.monotonic()) > 0.0:
            if select.select([self._box], [], [], wait_s)[0] and self._take_answer():
                self.answered_in_cycle += 1
                # The cycles after a long one are not hurried.
                self._due_s = max(self._due_s, time.monotonic())
                end_s = self._due_s
        self.cycles += 1

    def _measure(self, t_s: float) -> None:
        """Write the measurement of this cycle, at a time since the first one."""
        settings = self._settings
        is_commanded = t_s >= settings.command_from_s
        row = self.cycles % len(settings.q_rad)
        packet = self.packet
        packet["count"] = self.cycles % fri.COUNTS
        packet["stamp_s"] = t_s
        packet["state"] = fri.FriState.COMMAND if is_commanded else fri.FriState.MONITOR
        packet["position_rad"] = settings.q_rad[row]
        if settings.delay_cycles is not None:
            self._commanded.append(packet["commanded_rad"].copy())
            packet["position_rad"] = self._commanded[0]
        packet["torque_Nm"] = settings.tau_Nm[row]

    def _take_answer(self) -> bool:
        """Do what a datagram commands; return whether it answers this cycle."""
        data = b""
        with suppress(ConnectionError):
            data = self._box.recv(fri.COMMAND.itemsize)
        if len(data) != fri.COMMAND.itemsize:
            return False
        answer = np.frombuffer(data, fri.COMMAND)[0]
        if answer["reflected"] != self.packet["count"]:
            return False
        if self.packet["state"] == fri.FriState.COMMAND:
            self.packet["commanded_rad"] = answer["position_rad"]
        return True
