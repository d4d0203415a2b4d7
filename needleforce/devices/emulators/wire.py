"""A wire that breaks on demand.

Packets may be lost, late, reordered, repeated or truncated; there may be garbage,
silence, and a connection that gets worse.
"""

import select
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from needleforce.devices.datagram_link import LOOPBACK, DatagramLink, Endpoint

Window = tuple[float, float]
"""A span of time: its start and end [s] since the first packet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WireFaults:
    """What goes wrong on the wire: probabilities per packet, and windows of time.

    Attributes:
        lost: Probability that a packet is not sent.
        late: Probability that it comes by three packets late, out of order.
        repeated: Probability that it is sent twice.
        truncated: Probability that its end is missing.
        garbage: Probability that a datagram of random bytes and length goes before.
        silent: When nothing is sent.
        bad_quality: When the controller rates the connection as bad.
        seed: Of the random numbers.
    """

    lost: float = 0.0
    late: float = 0.0
    repeated: float = 0.0
    truncated: float = 0.0
    garbage: float = 0.0
    silent: tuple[Window, ...] = ()
    bad_quality: tuple[Window, ...] = ()
    seed: int = 0


def is_within(windows: tuple[Window, ...], t_s: float) -> bool:
    """Return whether a time lies in one of the windows, each a start and an end."""
    return any(start_s <= t_s < end_s for start_s, end_s in windows)


class FaultyWire(DatagramLink):
    """A link on loopback that breaks the datagrams that it sends to its peer.

    Args:
        faults: What goes wrong.
        peer: To which it sends; None: not known yet.

    Attributes:
        sent: How many packets went out whole and in time.
    """

    def __init__(self, faults: WireFaults, peer: Endpoint | None = None) -> None:
        super().__init__(LOOPBACK, 0)
        self._faults = faults
        self.peer = peer
        self._rng = np.random.default_rng(faults.seed)
        self._late: dict[int, bytes] = {}  # by number of the packet they come before
        self._number = 0
        self.sent = 0
        self._socket.setblocking(False)

    def received(self, end_s: float) -> Iterator[tuple[bytes, Endpoint]]:
        """Yield datagrams, each with its sender, that come before a time."""
        # `select` waits for microseconds, a socket's own timeout for whole
        # milliseconds.
        while (wait_s := end_s - time.monotonic()) > 0.0:
            if select.select([self._socket], [], [], wait_s)[0]:
                with suppress(ConnectionError, BlockingIOError):  # nobody listens yet
                    # No request to a device is longer than 2048 bytes.
                    data, sender = self._socket.recvfrom(2048)
                    yield data, Endpoint(*sender)

    def put(self, data: bytes, t_s: float) -> bool:
        """Send a packet, or break it.

        Args:
            data: The packet.
            t_s: Time since the first one.

        Returns:
            Whether it went out whole and in time.
        """
        faults = self._faults
        draws = self._rng.random(5)
        chances = (
            faults.lost,
            faults.late,
            faults.garbage,
            faults.truncated,
            faults.repeated,
        )
        is_lost, is_late, has_garbage, is_truncated, is_repeated = draws < chances
        self._number += 1
        if self._number in self._late:
            self._send(self._late.pop(self._number))
        if is_within(faults.silent, t_s) or is_lost:
            return False
        if is_late:
            overtaking = 3  # packets
            self._late[self._number + overtaking] = data
            return False
        if has_garbage:
            self._send(self._rng.bytes(int(self._rng.integers(0, 2000))))
        if is_truncated:
            self._send(data[: int(self._rng.integers(0, len(data)))])
            return False

        self._send(data)
        self.sent += 1
        if is_repeated:
            self._send(data)

        return True
