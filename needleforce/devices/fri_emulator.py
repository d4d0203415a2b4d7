"""An emulator of the controller of an LWR, which speaks the protocol of `fri`."""

import time
from collections import deque
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices import fri
from needleforce.devices.datagram_link import LOOPBACK, Endpoint
from needleforce.devices.emulators import (
    FaultyWire,
    WireFaults,
    is_within,
    run_cycles,
    take_real_time,
)

STOP_CHECK_CYCLES = 100
"""Once in so many cycles the emulator looks whether it shall end."""


@dataclass(frozen=True, kw_only=True)
class FriSettings:
    """What the emulated controller does.

    Rows of the signals are sent in turn, one a cycle; commands move only the reported
    command, unless `delay_cycles` is set.

    Attributes:
        port: To which it sends.
        q_rad: Joint positions, shape (m, 7).
        tau_Nm: Joint torques, shape (m, 7).
        period_s: Of a cycle.
        cycles: After so many it ends; None: when it is stopped.
        in_real_time: Whether it asks the system for real-time priority.
        extra_wait_s: So much longer a cycle lasts until it is answered; one of a real
            controller never does.
        delay_cycles: So many cycles after a command the reported position is there;
            None: positions are those of ``q_rad``.
        command_from_s: When it goes from monitor to command mode.
        faults: What goes wrong on the wire.
    """

    port: int
    q_rad: Array
    tau_Nm: Array
    period_s: float = 1e-3
    cycles: int | None = None
    in_real_time: bool = False
    extra_wait_s: float = 0.0
    delay_cycles: int | None = None
    command_from_s: float = float("inf")
    faults: WireFaults = field(default_factory=WireFaults)


def emulate_fri(pipe: Connection, settings: FriSettings) -> dict[str, Any]:
    """Emulate the controller of an LWR; a function for `Emulator`.

    Returns:
        Counts of the cycles, of answers in the same cycle, of packets sent; and the
        position that was commanded at the end.
    """
    if settings.in_real_time:
        take_real_time()

    controller = _Controller(settings)
    pipe.send({"port": controller.wire.address.port})
    run_cycles(controller, settings.cycles, pipe, STOP_CHECK_CYCLES)
    return {
        "cycles": controller.cycles,
        "same_cycle": controller.answered_in_cycle,
        "sent": controller.wire.sent,
        "commanded_rad": controller.commanded_rad,
    }


class _Controller:
    """The controller: sends a measurement every cycle, and takes the answer.

    Attributes:
        wire: The link to the arm's program.
        cycles: How many have passed.
        answered_in_cycle: How many were answered before they ended.
    """

    def __init__(self, settings: FriSettings) -> None:
        self._settings = settings
        self.wire = FaultyWire(settings.faults, Endpoint(LOOPBACK, settings.port))
        self.cycles = 0
        self.answered_in_cycle = 0
        self._packet = np.zeros((), fri.MEASUREMENT)
        self._packet["size"] = fri.MEASUREMENT.itemsize
        self._packet["kind"] = fri.MEASUREMENT_KIND
        self._packet["period_s"] = settings.period_s
        self._packet["commanded_rad"] = settings.q_rad[0]
        delay_cycles = settings.delay_cycles or 0
        self._commanded: deque[Array] = deque(
            [settings.q_rad[0]] * (delay_cycles + 1), maxlen=delay_cycles + 1
        )
        self._due_s = time.monotonic()

    @property
    def commanded_rad(self) -> Array:
        """The position that was commanded, shape (7,)."""
        return self._packet["commanded_rad"].copy()

    def run_cycle(self) -> None:
        """Send a measurement, and wait for its answer until the cycle is over."""
        settings = self._settings
        t_s = self.cycles * settings.period_s
        is_bad = is_within(settings.faults.bad_quality, t_s)
        is_commanded = t_s >= settings.command_from_s and not is_bad
        self._fill_packet(t_s, is_bad=is_bad, is_commanded=is_commanded)
        self._due_s += settings.period_s
        was_sent = self.wire.put(self._packet.tobytes(), t_s)
        extra_wait_s = settings.extra_wait_s if was_sent else 0.0
        while True:
            end_s = self._due_s + extra_wait_s
            datagram = next(self.wire.received(end_s), None)
            if datagram is None:
                break
            if len(datagram.data) != fri.COMMAND.itemsize:
                continue

            answer = np.frombuffer(datagram.data, fri.COMMAND)[0]
            if answer["reflected"] != self._packet["count"]:
                continue

            self.answered_in_cycle += 1
            if extra_wait_s:  # the cycles after a long one are not hurried
                self._due_s = max(self._due_s, time.monotonic())
                extra_wait_s = 0.0
            if is_commanded:
                self._packet["commanded_rad"] = answer["position_rad"]

        self.cycles += 1

    def _fill_packet(self, t_s: float, *, is_bad: bool, is_commanded: bool) -> None:
        """Fill in the measurement of this cycle."""
        packet = self._packet
        row = self.cycles % len(self._settings.q_rad)
        state = fri.FriState.COMMAND if is_commanded else fri.FriState.MONITOR
        packet["count"] = self.cycles % fri.COUNTS
        packet["stamp_s"] = t_s
        packet["state"] = state
        packet["quality"] = fri.FriQuality.BAD if is_bad else fri.FriQuality.PERFECT
        packet["position_rad"] = self._settings.q_rad[row]
        if self._settings.delay_cycles is not None:
            self._commanded.append(self.commanded_rad)
            packet["position_rad"] = self._commanded[0]
        packet["torque_Nm"] = self._settings.tau_Nm[row]
