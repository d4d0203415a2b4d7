"""A link over UDP with one peer."""

import socket
from contextlib import suppress
from time import monotonic
from typing import NamedTuple

from needleforce.devices.errors import DeviceSettingError, LinkError
from needleforce.devices.link import Link, run_within

LOOPBACK = "127.0.0.1"
"""Where links bind and connect unless an address is named."""

MAX_PORT = 65535

MAX_DATAGRAM_BYTES = 65536
"""No datagram of UDP is longer."""

RECEIVE_BUFFER_BYTES = 1 << 17
"""Room for datagrams that wait to be read: no more than usual, old ones are stale."""

MAX_FOREIGN_S = 2e-3
"""So long beyond its deadline a link looks for a datagram of its peer among foreign
ones."""

MAX_LOOK_UP_S = 2.0
"""So long the address of a name is looked up."""


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
        return run_within(MAX_LOOK_UP_S, lambda: socket.gethostbyname(host))
    except (OSError, ValueError) as error:
        raise LinkError(
            f"{host!r} is no address and no name that is known here: {error}",
        ) from error


class DatagramLink(Link):
    """A link over UDP with one peer; datagrams from elsewhere are dropped.

    Once the peer is known the kernel drops them; those that came before are counted.

    Args:
        host: Address of this machine to bind to.
        port: To bind to; 0 for any free one.
        peer: Address or name of the only host that is listened to; None for any.
        buffer_bytes: Room for datagrams that wait to be read.

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

    def __init__(
        self,
        host: str,
        port: int,
        *,
        peer: str | None = None,
        buffer_bytes: int = RECEIVE_BUFFER_BYTES,
    ) -> None:
        if not 0 <= port <= MAX_PORT:
            raise DeviceSettingError(
                f"port {port}: expected 0 to {MAX_PORT} (0: any free one)"
            )

        super().__init__()
        self.is_peer_named = peer is not None
        self._peer_host = peer and resolve_host(peer)
        self.sender: Endpoint | None = None
        self.peer: Endpoint | None = None
        self._buffer_bytes = buffer_bytes
        self._socket = self._bind(host, port)
        self.address = Endpoint(*self._socket.getsockname())
        self._bound = self.address  # which connecting changes from any to one
        self._connected: Endpoint | None = None
        self._empty_s = monotonic()
        """When nothing waited to be read for the last time: what came, came later."""

    def _bind(self, host: str, port: int) -> socket.socket:
        """Return a socket that listens on an address of this machine."""
        new = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        new.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._buffer_bytes)
        try:
            new.bind((host, port))
        except OSError as error:
            new.close()
            raise LinkError(
                f"cannot listen on {host}:{port}: {error.strerror or error}",
                "End the other program that uses the port, or give an "
                "address of this machine.",
            ) from error

        return new

    def _receive(
        self, timeout_s: float, max_bytes: int = MAX_DATAGRAM_BYTES
    ) -> bytes | None:
        """Return the next datagram that may be the peer's.

        Args:
            max_bytes: A longer one is cut off there.
            timeout_s: How long it is waited for; 0: only what waits already. Foreign
                datagrams delay the return by `MAX_FOREIGN_S` at most.

        Returns:
            Its bytes; None when none came in time.
        """
        deadline_s = monotonic() + timeout_s
        is_empty = False
        while True:
            asked_s = monotonic()
            self._socket.settimeout(max(deadline_s - asked_s, 0.0) if is_empty else 0.0)
            try:
                data, address = self._socket.recvfrom(max_bytes)
            except (TimeoutError, BlockingIOError):
                self._empty_s = asked_s
                is_empty = True
                if asked_s >= deadline_s:
                    return None

                continue
            except ConnectionError:  # what was sent before found nobody listening
                continue

            sender = Endpoint(*address)
            if self._is_peer(sender):
                self.sender = sender
                return data

            self.report.foreign += 1
            if monotonic() >= deadline_s + MAX_FOREIGN_S:
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
                with suppress(ConnectionError):  # as in `_receive`
                    self._socket.recv(MAX_DATAGRAM_BYTES)
        self._empty_s = monotonic()

    def _keep_sender(self) -> None:
        """Listen only to the sender of the latest datagram from now on."""
        if self.sender is not None and self.peer != self.sender:
            self._keep_peer(self.sender)
            self._peer_host = self.sender.host

    def _keep_peer(self, peer: Endpoint) -> None:
        """Let the kernel drop what others send, before it takes a reading's time."""
        self.peer = peer
        with suppress(OSError):  # a peer that cannot be reached is a silent one
            self._socket.connect(peer)
            self._connected = peer

    def _forget_port(self) -> None:
        """Listen to any port of the peer's host: it may have been started anew.

        Raises:
            LinkError: Another program has taken our port meanwhile.
        """
        self.peer = None
        if self._connected is not None:
            # Python cannot undo `connect`.
            self._connected = None
            self._socket.close()
            self._socket = self._bind(*self._bound)

    def _is_peer(self, sender: Endpoint) -> bool:
        """Return whether a datagram from there may be the peer's."""
        is_host = self._peer_host is None or sender.host == self._peer_host
        return is_host and self.peer in (None, sender)

    def _send(self, data: bytes, receiver: Endpoint | None = None) -> None:
        """Send to the peer, or to another receiver.

        What the network refuses is lost, as on a wire.
        """
        receiver = receiver or self.peer
        if receiver is not None:
            with suppress(OSError):
                if receiver == self._connected:
                    self._socket.send(data)
                else:
                    self._socket.sendto(data, receiver)

    def close(self) -> None:
        """End the readings, and free the port."""
        super().close()
        self._socket.close()
