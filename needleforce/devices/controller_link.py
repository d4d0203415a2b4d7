"""A link to a controller that sends a packet every cycle, and wants an answer to it."""

from abc import abstractmethod
from time import monotonic
from typing import Any

from needleforce.devices.datagram_link import DatagramLink
from needleforce.devices.guard import GuardedArm
from needleforce.devices.link import SILENCE_S, ArmReading


class ControllerLink(GuardedArm, DatagramLink):
    """An arm whose controller sends to this machine; one reading per valid packet.

    Args:
        host: Address of this machine to which the controller sends.
        port: The port set in its configuration; 0 for any free one, see `address`.
        counts: The counter of its packets goes round after so many.
        joints: How many there are.
        peer: Address or name of the controller; others are dropped. None: the first
            that sends a valid packet is kept, see `DatagramLink.peer`; after a silence
            only its port may have changed.
        give_up_s: After so long without a valid packet the arm is lost.
        robot: The model of the arm, kept for those who need both.

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
        give_up_s: float,
        robot: Any,
    ) -> None:
        super().__init__(joints, robot, give_up_s, host=host, port=port, peer=peer)
        self._counts = counts
        self._latest_count: int | None = None
        self._latest_s = monotonic()  # when the latest packet was read

    def _read(self, wait_s: float) -> ArmReading | None:
        data = self._receive(wait_s)
        return None if data is None else self._process(data)

    def _place(self) -> str:
        return f"that sends to {self.address.host}, port {self.address.port},"

    def _lose(self) -> None:
        self._lose_controller()
        self.peer = None  # it may come back on another port

    def close(self) -> None:
        """Brake the arm to rest while its controller asks, and end the connection."""
        # An arm that moves at its highest speed has come to rest before.
        max_brake_s = 2.0
        self._guard.brake()
        end_s = monotonic() + max_brake_s
        while not self._guard.is_at_rest and monotonic() < end_s:
            data = self._receive(SILENCE_S)
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

        The counter says so. After a silence the controller may count anew, and after a
        long pause of this program its counter may have gone round: our own clock says
        it then.

        Args:
            count: Its number.
            period_s: Time of a cycle.

        Returns:
            The cycles; None for a packet that is not newer.
        """
        # No more time than this is counted, and a longer pause drops what waits.
        max_counted_gap_s = 1.0
        now_s = monotonic()
        gap_s = now_s - self._latest_s
        cycles = 1
        if self._latest_count is not None:
            cycles = (count - self._latest_count) % self._counts
            if self._is_silent:
                cycles = min(cycles, 1) * max(round(gap_s / period_s), 1)
            elif gap_s > max_counted_gap_s:
                self.drop_waiting()
                self._is_silent = True
                return None
            elif cycles * period_s > max_counted_gap_s:
                cycles = 0
        if not cycles:
            self.report.stale += 1
            return None

        self._keep_sender()
        self._latest_count = count
        self._latest_s = now_s
        self.report.count_used(cycles, cycles * period_s)
        return cycles
