"""How many cycles a packet is later than the one before: its counter and a clock."""

MAX_COUNTED_GAP_S = 1.0
"""After a longer gap the counter may have gone round or begun anew: our own clock says
how long the gap was."""

MAX_DELAY_S = 0.1
"""One datagram may come so much later than others."""


class CycleCounter:
    """Counts the cycles between the packets of a controller.

    Args:
        counts: The counter of packets goes round after so many.
        now_s: Time on our clock.
    """

    def __init__(self, counts: int, now_s: float) -> None:
        self._counts = counts
        self._latest: int | None = None
        self._refused: int | None = None  # since the latest
        self._refused_in_row = 0
        self._read_s = now_s  # when the latest was read
        self._sent_after_s = now_s  # the latest was sent later than this

    def cycles_to(
        self, count: int, period_s: float, now_s: float, empty_s: float
    ) -> int | None:
        """Return how many cycles a packet is later than the latest.

        The counter says so; after a long gap our own clock does. Both this packet and
        the latest may have waited to be read: no more time is between them than since
        the latest can have been sent. A packet that is not newer, or further on than
        that, is refused, unless it comes after a silence or is one of a row.

        Args:
            count: Its number, modulo the counts.
            period_s: Time of a cycle.
            now_s: When it was read.
            empty_s: When nothing waited to be read for the last time.

        Returns:
            The cycles; 1 for the first packet, None for one that is refused.
        """
        if self._latest is None:
            return 1

        cycles = (count - self._latest) % self._counts
        max_gap_s = now_s - self._sent_after_s + MAX_DELAY_S
        is_short = empty_s - self._read_s < MAX_COUNTED_GAP_S
        is_counted = is_short and max_gap_s < self._counts // 2 * period_s
        is_ahead = 0 < cycles < self._counts // 2
        if is_counted and is_ahead and cycles * period_s <= max_gap_s:
            return cycles

        # Too far ahead after a silence: the controller has begun anew.
        is_anew = is_ahead and now_s - self._read_s > MAX_DELAY_S
        if is_counted and not is_anew and not self._is_renumbered(count):
            return None
        return max(round((now_s - self._read_s) / period_s), 1)

    def _is_renumbered(self, count: int) -> bool:
        """Note a packet that is not newer; return whether a row of them has come."""
        is_next = self._refused is not None and (
            count == (self._refused + 1) % self._counts
        )
        self._refused = count
        self._refused_in_row = self._refused_in_row + 1 if is_next else 1
        # After so many in a row that are not newer, and follow each other, they are
        # those of the controller: it counts anew, or a foreign packet was taken for its
        # latest.
        min_renumbered_packets = 10
        return self._refused_in_row >= min_renumbered_packets

    def accept(self, count: int, now_s: float, empty_s: float) -> None:
        """Take a packet for the latest."""
        self._latest = count
        self._refused = None
        self._read_s = now_s
        self._sent_after_s = empty_s
