"""A link to a controller that sends a packet every cycle, and wants an answer to it."""

from abc import ABC, abstractmethod
from collections.abc import Iterator
from time import monotonic
from typing import Any

from needleforce.devices.cycle_counter import CycleCounter
from needleforce.devices.datagram_link import DatagramLink
from needleforce.devices.errors import DeviceSettingError
from needleforce.devices.guard import GuardedArm
from needleforce.devices.link import ArmReading

MAX_WAIT_S = 3600.0
"""A socket waits for no infinite time."""

MAX_BRAKE_S = 2.0
"""An arm that moves at its highest speed has come to rest before."""


class ControllerLink(GuardedArm, DatagramLink, ABC):
    """An arm whose controller sends to this machine; one reading per valid packet.

    Args:
        host: Address of this machine to which the controller sends.
        port: The port set in its configuration; 0 for any free one, see `address`.
        counts: The counter of its packets goes round after so many.
        joints: How many there are.
        peer: Address or name of the controller; others are dropped. None: the first
            that sends a valid packet is kept, see `DatagramLink.peer`; after an outage
            only its port may have changed.
        wait_s: A silence longer than this counts as an outage.
        give_up_s: After so long without a valid packet the readings end.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        robot: The model of the arm.
        joints: How many there are.
        hint: What the packets that are not understood seem to be; empty for nothing.

    Raises:
        LinkError: The address cannot be bound, or the peer's name is unknown.
        DeviceSettingError: A port or a time that cannot work.
    """

    def __init__(
        self,
        host: str,
        port: int,
        counts: int,
        joints: int,
        *,
        peer: str | None,
        wait_s: float,
        give_up_s: float,
        robot: Any,
    ) -> None:
        if not 0.0 < wait_s <= min(give_up_s, MAX_WAIT_S):
            raise DeviceSettingError(
                f"{wait_s=}, {give_up_s=}: expected 0 < wait_s <= give_up_s, and "
                f"wait_s of at most {MAX_WAIT_S:g} s"
            )

        super().__init__(host, port, peer=peer)
        self.robot = robot
        self.joints = joints
        self.hint = ""
        self._guard = self._make_guard()
        self._counter = CycleCounter(counts, monotonic())
        self._wait_s = wait_s
        self._give_up_s = give_up_s

    def __iter__(self) -> Iterator[ArmReading]:
        """Yield readings as they come, each answered already."""
        heard_s = monotonic()
        is_silent = False
        while self._is_open and monotonic() - heard_s < self._give_up_s:
            data = self._receive(self._wait_s)
            if data is None:
                self.report.outages += not is_silent
                is_silent = True
                self._lose_controller()
                self._forget_port()  # after an outage it may come back on another
                continue

            reading = self._process(data)
            if reading is not None:
                yield reading
                heard_s = monotonic()
                is_silent = False

    def close(self) -> None:
        """Brake the arm to rest while its controller asks, and end the connection."""
        self._guard.brake()
        end_s = monotonic() + MAX_BRAKE_S
        while not self._guard.is_at_rest and monotonic() < end_s:
            data = self._receive(self._wait_s)
            if data is None:
                break
            self._process(data)
        self._guard.anchor()
        super().close()

    @abstractmethod
    def _lose_controller(self) -> None:
        """Note that the controller is silent."""

    @abstractmethod
    def _process(self, data: bytes) -> ArmReading | None:
        """Answer a packet newer than the latest, and return its reading."""

    def _count_cycles(self, count: int, period_s: float) -> int | None:
        """Return how many cycles a valid packet is later; count it, keep its sender.

        Args:
            count: Its number.
            period_s: Time of a cycle.

        Returns:
            The cycles; None for a packet that is not newer.
        """
        now_s = monotonic()
        cycles = self._counter.cycles_to(count, period_s, now_s, self._empty_s)
        if cycles is None:
            self.report.stale += 1
            return None

        self._keep_sender()
        self._counter.accept(count, now_s, self._empty_s)
        self.report.count_used(cycles, cycles * period_s)
        return cycles
