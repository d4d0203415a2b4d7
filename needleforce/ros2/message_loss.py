"""How many messages were lost on their way, and how late the others come."""

from collections.abc import Hashable, Mapping
from typing import Any, NamedTuple

NS_PER_S = 10**9


class Sender(NamedTuple):
    """Who sent a message.

    Attributes:
        publisher: Its identity.
        number: The message's sequence number; None if the middleware gives none.
    """

    publisher: Hashable
    number: int | None


def identify_sender(info: Mapping[str, Any]) -> Sender:
    """Return the sender of a message from what rclpy says of it."""
    publisher = info.get("publisher_gid") or {}
    number = info.get("publication_sequence_number")
    return Sender(publisher.get("data"), number)


class LossCounter:
    """Counts the gaps in the sequence numbers of each publisher.

    Numbers are those of the middleware, so a message counts as lost wherever it was: in
    the network, or in a queue that was full.

    Attributes:
        received: Messages that came.
        lost: Messages between those that came.
        is_counting: Whether the middleware numbers messages; without, nothing is known.
    """

    def __init__(self) -> None:
        self._latest: dict[Hashable, int] = {}
        self.received = 0
        self.lost = 0
        self.is_counting = False

    def count(self, publisher: Hashable, number: int | None) -> None:
        """Count a message.

        Args:
            publisher: Who sent it.
            number: Its sequence number; None if the middleware gives none.
        """
        self.received += 1
        if number is None:
            return
        self.is_counting = True
        latest = self._latest.get(publisher, number - 1)
        self.lost += max(number - latest - 1, 0)
        self._latest[publisher] = max(number, latest)

    def __str__(self) -> str:
        """Return the loss in words."""
        if not self.is_counting:
            return f"{self.received} received, loss not counted by this middleware"
        sent = self.received + self.lost
        ratio_percent = 100.0 * self.lost / sent if sent else 0.0
        return f"{self.received} received, {self.lost} lost ({ratio_percent:.2f} %)"


class DelayMeter:
    """Keeps the largest delay of a sample since it was last asked for."""

    def __init__(self) -> None:
        self._max_ns = 0

    def add(self, delay_ns: int) -> None:
        """Add the time between a sample's stamp and its result [ns]."""
        self._max_ns = max(self._max_ns, delay_ns)

    def take_max_s(self) -> float:
        """Return the largest delay since the last call [s], and begin anew."""
        max_s = self._max_ns / NS_PER_S
        self._max_ns = 0
        return max_s
