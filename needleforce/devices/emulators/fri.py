"""An emulator of the controller of an LWR, which speaks `devices.fri`."""

import time
from collections import deque
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices import fri
from needleforce.devices.datagram_link import LOOPBACK, Endpoint
from needleforce.devices.emulators.wire import FaultyWire, WireFaults, is_within


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
        faults: What goes wrong on the wire.
    """

    port: int
    q_rad: Array
    tau_Nm: Array
    period_s: float = 1e-3
    cycles: int | None = None
    extra_wait_s: float = 0.0
    command_from_s: float = float("inf")
    delay_cycles: int | None = None
    faults: WireFaults = field(default_factory=WireFaults)


def emulate_fri(pipe: Connection, settings: FriSettings) -> dict[str, Any]:
    """Emulate the controller of an LWR; a function for `Emulator`.

    Returns:
        Counts of the cycles, of answers in the same cycle, of packets sent; and the
        position that was commanded at the end.
    """
    controller = _Controller(settings)
    pipe.send({"port": controller.wire.address.port})
    cycles_between_looks = max(1, round(0.1 / settings.period_s))
    while controller.cycles != settings.cycles:
        if controller.cycles % cycles_between_looks == 0 and pipe.poll():
            break
        controller.run_cycle()
    return {
        "cycles": controller.cycles,
        "same_cycle": controller.answered_in_cycle,
        "sent": controller.wire.sent,
        "commanded_rad": controller.packet["commanded_rad"].copy(),
    }


class _Controller:
    """A controller: sends a measurement every cycle, and takes the answer.

    Attributes:
        wire: The link to the arm's program.
        cycles: How many have passed.
        answered_in_cycle: How many were answered before they ended.
        packet: The latest measurement.
    """

    def __init__(self, settings: FriSettings) -> None:
        self.wire = FaultyWire(settings.faults, Endpoint(LOOPBACK, settings.port))
        self.cycles = 0
        self.answered_in_cycle = 0
        self._settings = settings
        self._due_s = time.monotonic()
        self.packet = np.zeros((), fri.MEASUREMENT)
        self.packet["size"] = fri.MEASUREMENT.itemsize
        self.packet["kind"] = fri.MEASUREMENT_KIND
        self.packet["period_s"] = settings.period_s
        self.packet["commanded_rad"] = settings.q_rad[0]
        length = (settings.delay_cycles or 0) + 1
        self._commanded: deque[Array] = deque([settings.q_rad[0]] * length, length)

    def run_cycle(self) -> None:
        """Send a measurement, and wait for its answer until the cycle is over."""
        settings = self._settings
        t_s = self.cycles * settings.period_s
        self._measure(t_s)
        was_sent = self.wire.put(self.packet.tobytes(), t_s)
        self._due_s += settings.period_s
        end_s = self._due_s + (settings.extra_wait_s if was_sent else 0.0)
        while (received := next(self.wire.received(end_s), None)) is not None:
            if not self._take_answer(received[0]):
                continue
            self.answered_in_cycle += 1
            if end_s > self._due_s:  # the cycles after a long one are not hurried
                self._due_s = max(self._due_s, time.monotonic())
                end_s = self._due_s
        self.cycles += 1

    def _measure(self, t_s: float) -> None:
        """Write the measurement of this cycle, at a time since the first one."""
        settings = self._settings
        is_bad = is_within(settings.faults.bad_quality, t_s)
        is_commanded = t_s >= settings.command_from_s and not is_bad
        row = self.cycles % len(settings.q_rad)
        packet = self.packet
        packet["count"] = self.cycles % fri.COUNTS
        packet["stamp_s"] = t_s
        packet["state"] = fri.FriState.COMMAND if is_commanded else fri.FriState.MONITOR
        packet["quality"] = fri.FriQuality.BAD if is_bad else fri.FriQuality.PERFECT
        packet["position_rad"] = settings.q_rad[row]
        if settings.delay_cycles is not None:
            self._commanded.append(packet["commanded_rad"].copy())
            packet["position_rad"] = self._commanded[0]
        packet["torque_Nm"] = settings.tau_Nm[row]

    def _take_answer(self, data: bytes) -> bool:
        """Do what a datagram commands; return whether it answers this cycle."""
        if len(data) != fri.COMMAND.itemsize:
            return False
        answer = np.frombuffer(data, fri.COMMAND)[0]
        if answer["reflected"] != self.packet["count"]:
            return False
        if self.packet["state"] == fri.FriState.COMMAND:
            self.packet["commanded_rad"] = answer["position_rad"]
        return True
