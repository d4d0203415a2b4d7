"""What the emulated controllers of arms share: their cycle."""

import time
from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

from foundation.arrays import Array
from needleforce.devices.datagram_link import LOOPBACK, Endpoint
from needleforce.devices.emulators.wire import FaultyWire, WireFaults


@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """What an emulated controller does.

    Rows of the signals are sent in turn, one a cycle.

    Attributes:
        port: To which it sends.
        q_rad: Joint positions, shape (m, 7).
        tau_Nm: Joint torques, shape (m, 7).
        period_s: Of a cycle.
        cycles: After so many it ends; None: when it is stopped.
        extra_wait_s: So much longer a cycle lasts until it is answered; one of a real
            controller never does.
        command_from_s: When it goes from monitoring to commanding.
        faults: What goes wrong on the wire.
    """

    port: int
    q_rad: Array
    tau_Nm: Array
    period_s: float
    cycles: int | None = None
    extra_wait_s: float = 0.0
    command_from_s: float = float("inf")
    faults: WireFaults = field(default_factory=WireFaults)


class ArmController(ABC):
    """A controller: sends a message every cycle, and takes the answer.

    Attributes:
        wire: The link to the arm's program.
        cycles: How many have passed.
        answered_in_cycle: How many were answered before they ended.
    """

    def __init__(self, settings: ArmSettings) -> None:
        self.wire = FaultyWire(settings.faults, Endpoint(LOOPBACK, settings.port))
        self.cycles = 0
        self.answered_in_cycle = 0
        self._settings = settings
        self._due_s = time.monotonic()

    @abstractmethod
    def _message(self, t_s: float) -> bytes:
        """Return what this cycle sends, at a time since the first one."""

    @abstractmethod
    def _take_answer(self, data: bytes) -> bool:
        """Do what a datagram commands; return whether it answers this cycle."""

    def run(self, pipe: Connection) -> None:
        """Run until the cycles are over, or something comes in the pipe."""
        pipe.send({"port": self.wire.address.port})
        cycles_between_looks = max(1, round(0.1 / self._settings.period_s))
        while self.cycles != self._settings.cycles:
            if self.cycles % cycles_between_looks == 0 and pipe.poll():
                break
            self._run_cycle()

    def _run_cycle(self) -> None:
        """Send a message, and wait for its answer until the cycle is over."""
        settings = self._settings
        t_s = self.cycles * settings.period_s
        was_sent = self.wire.put(self._message(t_s), t_s)
        self._due_s += settings.period_s
        end_s = self._due_s + (settings.extra_wait_s if was_sent else 0.0)
        while (datagram := next(self.wire.received(end_s), None)) is not None:
            if not self._take_answer(datagram.data):
                continue
            self.answered_in_cycle += 1
            if end_s > self._due_s:  # the cycles after a long one are not hurried
                self._due_s = max(self._due_s, time.monotonic())
                end_s = self._due_s
        self.cycles += 1
