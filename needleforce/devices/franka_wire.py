"""What a Franka arm is asked without a client library: its version and its model.

Only the two commands that the libraries do not offer, or not for every arm; layouts as
public sources of libfranka have them. An arm serves one connection at a time: ask while
no client is connected.
"""

import socket
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from needleforce.devices.errors import LinkError

COMMAND_PORT = 1337
"""Of the arm, for commands."""

HEADER = struct.Struct("<3I")
"""Command, number of the command, bytes in all."""

CONNECT = 0
"""The command with which a client says its version."""

GET_ROBOT_MODEL = 11
"""The command that asks an FR3 for its description."""

UNKNOWN_VERSION = 0
"""Of no library: the arm answers with its own version."""

SHORT_REPLY = struct.Struct("<BH")
"""Status and version, as an FER replies."""

REPLY = struct.Struct("<HH")
"""The same as an FR3 replies, before four bytes without meaning."""

ANSWER_WAIT_S = 2.0
"""So long an arm may take to answer."""

MAX_REPLY_BYTES = 1 << 24
"""A longer reply is none of an arm."""


@contextmanager
def _connection(host: str, version: int) -> Iterator[tuple[socket.socket, int]]:
    """Connect to an arm; give the connection, and the version that the arm speaks."""
    with (
        socket.create_connection((host, COMMAND_PORT), ANSWER_WAIT_S) as link,
        socket.socket(type=socket.SOCK_DGRAM) as states,
    ):
        link.settimeout(ANSWER_WAIT_S)
        states.bind((link.getsockname()[0], 0))
        port = states.getsockname()[1]
        reply = _ask(link, CONNECT, struct.pack("<2H", version, port))
        layout = SHORT_REPLY if len(reply) == SHORT_REPLY.size else REPLY
        yield link, layout.unpack_from(reply)[1]


def _ask(link: socket.socket, command: int, payload: bytes = b"") -> bytes:
    """Send a command; return what the arm replies."""
    size = HEADER.size + len(payload)
    link.sendall(HEADER.pack(command, 1, size) + payload)
    _, _, reply_size = HEADER.unpack(_read(link, HEADER.size))
    return _read(link, min(reply_size, MAX_REPLY_BYTES) - HEADER.size)


def _read(link: socket.socket, size: int) -> bytes:
    """Return so many bytes; `LinkError` if the arm ends the connection."""
    data = bytearray()
    while len(data) < size:
        piece = link.recv(size - len(data))
        if not piece:
            raise LinkError("the arm has ended the connection")

        data += piece

    return bytes(data)


def read_server_version(host: str) -> int | None:
    """Return the version of the interface that an arm speaks; None without an answer.

    Args:
        host: Address of the arm.
    """
    with (
        suppress(OSError, struct.error),
        _connection(host, UNKNOWN_VERSION) as (_, version),
    ):
        return version

    return None


def read_urdf(host: str, version: int) -> str:
    """Return the description that an FR3 has of itself, as URDF.

    Args:
        host: Address of the arm.
        version: Of the interface, as its client library speaks it.

    Raises:
        LinkError: The arm does not answer, or gives no description.
    """
    try:
        with _connection(host, version) as (link, _):
            text = _ask(link, GET_ROBOT_MODEL).decode(errors="replace")
    except (OSError, struct.error) as error:
        raise LinkError(f"{host} gives no model of the arm: {error}") from error

    begin = text.find("<")
    if begin < 0 or "</robot>" not in text:
        raise LinkError(f"{host} gives no model of the arm: {text[:40]!r}")

    return text[begin : text.rindex("</robot>") + len("</robot>")]
