"""A link over UDP with one peer."""

import socket
from contextlib import suppress
from time import monotonic
from typing import NamedTuple

from needleforce.devices.errors import DeviceSettingError, LinkError
from needleforce.devices.link import Link

LOOPBACK = "127.0.0.1"
"""Where links bind and connect unless an address is named."""

MAX_PORT = 65535

MAX_DATAGRAM_BYTES = 65536
"""No datagram of UDP is longer."""


class Endpoint(NamedTuple):
    """An address of UDP.

    Attributes:
        host: Numeric address.
        port: From 0 to 65535.
    """

    host: str
    port: int


def resolve_host(host: str) -> str:
    """Return the numeric address of a host, which its datagrams bear.

    Raises:
        LinkError: The name is unknown.
    """
    try:
        return socket.gethostbyname(host)
    except (OSError, ValueError) as error:
        raise LinkError(
            f"{host!r} is no address and no name that is known here: {error}",
        ) from error


class DatagramLink(Link):
    """A link over UDP with one peer; datagrams from elsewhere are counted and dropped.

    Args:
        host: Address of this machine to bind to.
        port: To bind to; 0 for any free one.
        peer: Address or name of the only host that is listened to; None for any.

    Attributes:
        address: Where it listens.
        sender: From where the latest datagram came.
        peer: Where it sends to, and the only one it listens to; None: not known yet.
        is_peer_named: Whether the peer's host was given; else it is the first that
            sent something valid.

    Raises:
        LinkError: The address cannot be bound, or the peer's name is unknown.
        DeviceSettingError: A port outside 0 to 65535.
    """

    def __init__(self, host: str, port: int, *, peer: str | None = None) -> None:
        if not 0 <= port <= MAX_PORT:
            raise DeviceSettingError(
                f"port {port}: expected 0 to {MAX_PORT} (0: any free one)"
            )

        super().__init__()
        self.is_peer_named = peer is not None
        self._peer_host = peer and resolve_host(peer)
        self.sender: Endpoint | None = None
        self.peer: Endpoint | None = None
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        # Room for datagrams that wait to be read: no more than usual, old ones are
        # stale.
        buffer_bytes = 1 << 17
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, buffer_bytes)
        try:
            self._socket.bind((host, port))
        except OSError as error:
            self._socket.close()
            raise LinkError(
                f"cannot listen on {host}:{port}: {error.strerror or error}",
                "End the other program that uses the port, or give an "
                "address of this machine.",
            ) from error

        self.address = Endpoint(*self._socket.getsockname())

    def _receive(self, timeout_s: float) -> bytes | None:
        """Return the next datagram that may be the peer's; None if none comes in time.

        Args:
            timeout_s: How long it is waited for; 0: only what waits already.
        """
        # So long beyond the deadline it is looked for among foreign ones.
        max_foreign_s = 2e-3
        deadline_s = monotonic() + timeout_s
        wait_s = timeout_s
        while wait_s > -max_foreign_s:
            self._socket.settimeout(max(wait_s, 0.0))
            try:
                data, address = self._socket.recvfrom(MAX_DATAGRAM_BYTES)
            except (TimeoutError, BlockingIOError):
                return None

            self.sender = Endpoint(*address)
            is_host = self._peer_host in (None, self.sender.host)
            if is_host and self.peer in (None, self.sender):
                return data

            self.report.foreign += 1
            wait_s = deadline_s - monotonic()
        return None

    def drop_waiting(self) -> None:
        """Drop the datagrams that wait to be read: they tell of the past."""
        self._socket.settimeout(0.0)
        # So long waiting datagrams are dropped, though others flood the link; they take
        # a fraction of it.
        max_drop_s = 0.01
        deadline_s = monotonic() + max_drop_s
        with suppress(BlockingIOError):
            while monotonic() < deadline_s:
                self._socket.recv(MAX_DATAGRAM_BYTES)

    def _keep_sender(self) -> None:
        """Listen only to the sender of the latest datagram from now on."""
        self.peer = self.sender
        self._peer_host = self.sender and self.sender.host

    def _send(self, data: bytes) -> None:
        """Send to the peer; what the network refuses is lost, as on a wire."""
        if self.peer is not None:
            with suppress(OSError):
                self._socket.sendto(data, self.peer)

    def close(self) -> None:
        """End the readings, and free the port."""
        super().close()
        self._socket.close()
