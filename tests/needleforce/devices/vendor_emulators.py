"""An emulator of a Franka FER that its own client, libfranka 0.9, accepts.

A function for `emulators.Emulator`. It serves one client after the other on loopback,
on the fixed port of the arm. The layout is that of the public protocol, version 5.
"""

import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.emulators.wire import Window, is_within

FRANKA_PORT = 1337
FRANKA_VERSION = 5
FRANKA_HEADER = struct.Struct("<3I")  # command, number of the command, bytes in all
FRANKA_DOUBLES = 284
FRANKA_AT = {
    "tau_Nm": 126,
    "q_rad": 147,
    "dq_rad_s": 161,
    "desired_rad_s": 168,
    "desired_rad_s2": 175,
    "external_Nm": 208,
}
"""Doubles at which the arrays of seven begin, in the state's 284, after its number."""
FRANKA_STATE_BYTES = 2373
FRANKA_MOVE = 1
FRANKA_STARTED = 1
FRANKA_COMMAND = struct.Struct("<Q 7d 7d 16d 6d 2d ? ? 7d")
"""Number of the state; positions, velocities, pose, twist, elbow of a motion, whether
the elbow counts and the motion is finished; torques."""


@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """What an emulated arm sends: rows over and over."""

    q_rad: Array  # shape (m, n)
    dq_rad_s: Array
    effort: Array  # torques [Nm] of a Franka, currents [A] of a UR
    rate_hz: float = 1000.0
    silent: tuple[Window, ...] = ()  # nothing is sent meanwhile


def listen(port: int) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind((LOOPBACK, port))
    listener.listen(1)
    listener.settimeout(0.1)
    return listener


def _stream(
    settings: ArmSettings, put: Callable[[int], object], ends: Callable[[], bool]
) -> int:
    """Call for each row in real time until it ends, or the other goes; how many were
    sent."""
    begin_s = time.monotonic()
    number = 0
    sent = 0
    while not (number % 50 == 0 and ends()):
        t_s = number / settings.rate_hz
        time.sleep(max(begin_s + t_s - time.monotonic(), 0.0))
        if not is_within(settings.silent, t_s):
            try:
                put(number)
            except OSError:
                break

            sent += 1

        number += 1

    return sent


def read_exactly(link: socket.socket, size: int) -> bytes:
    """So many bytes; `ConnectionError` if the other has gone."""
    data = b""
    while len(data) < size:
        piece = link.recv(size - len(data))
        if not piece:
            raise ConnectionError

        data += piece

    return data


class _Fer:
    """The arm of one connection: sends states, takes the commands of a motion.

    Attributes:
        moved_rad: How far it was commanded from where its rows say it is, shape (7,).
    """

    def __init__(self, link, states, client, settings):
        self._link = link
        self._states = states
        self._client = client
        self._settings = settings
        self._motion = 0  # number of the command that began it; 0 while there is none
        self.moved_rad = np.zeros(7)
        self._velocity_rad_s = np.zeros(7)
        self._acceleration_rad_s2 = np.zeros(7)
        self.is_gone = False

    def run_cycle(self, number):
        """Take what has come, then send the state of this millisecond."""
        self._take_requests()
        self._take_velocities()
        # Where none has come it goes on as it was: one cycle is one millisecond.
        self.moved_rad = self.moved_rad + 1e-3 * self._velocity_rad_s
        state = franka_state(number, self._settings, self)
        self._states.sendto(state, self._client)

    @property
    def signals(self):
        """Signals of a motion, by name; modes of generator, controller and robot."""
        arrays = {
            "q_rad": self.moved_rad,
            "dq_rad_s": self._velocity_rad_s,
            "desired_rad_s": self._velocity_rad_s,
            "desired_rad_s2": self._acceleration_rad_s2,
        }
        return arrays, bytes([2, 0]) if self._motion else bytes(2), self._motion > 0

    def _reply(self, command, number, status):
        whole = FRANKA_HEADER.size + 1
        self._link.sendall(FRANKA_HEADER.pack(command, number, whole) + bytes([status]))

    def _take_requests(self):
        try:
            head = self._link.recv(FRANKA_HEADER.size)
        except BlockingIOError:
            return
        except ConnectionError:
            head = b""

        if not head:
            self.is_gone = True
            return

        command, number, size = FRANKA_HEADER.unpack(head)
        self._link.setblocking(True)
        read_exactly(self._link, size - FRANKA_HEADER.size)
        self._link.setblocking(False)
        if command == FRANKA_MOVE:
            self._motion = number
            self._reply(command, number, FRANKA_STARTED)
        else:
            self._reply(command, number, 0)

    def _take_velocities(self):
        while True:
            try:
                data = self._states.recv(FRANKA_COMMAND.size)
            except BlockingIOError:
                return

            if self._motion == 0:
                continue

            values = FRANKA_COMMAND.unpack(data)
            velocity = np.array(values[8:15])
            self._acceleration_rad_s2 = (velocity - self._velocity_rad_s) / 1e-3
            self._velocity_rad_s = velocity
            if values[40]:  # the motion is finished
                self._reply(FRANKA_MOVE, self._motion, 0)
                self._motion = 0


def emulate_franka(pipe: Connection, settings: ArmSettings) -> dict[str, Any]:
    """An arm that answers the connection, sends its state at 1 kHz, and moves."""
    with (
        listen(FRANKA_PORT) as listener,
        socket.socket(type=socket.SOCK_DGRAM) as states,
    ):
        pipe.send({"port": FRANKA_PORT})
        states.setblocking(False)
        counts = {"sent": 0, "moved_rad": np.zeros(7), "speed_rad_s": 0.0}
        while not pipe.poll():
            try:
                link, (host, _) = listener.accept()
            except TimeoutError:
                continue

            with link:
                _, number, size = FRANKA_HEADER.unpack(
                    read_exactly(link, FRANKA_HEADER.size)
                )
                version, port = struct.unpack_from(
                    "<2H", read_exactly(link, size - FRANKA_HEADER.size)
                )
                # Status 1: another version of the interface.
                reply = struct.pack("<BH", version != FRANKA_VERSION, FRANKA_VERSION)
                whole = FRANKA_HEADER.size + len(reply)
                link.sendall(FRANKA_HEADER.pack(0, number, whole) + reply)
                link.setblocking(False)
                arm = _Fer(link, states, (host, port), settings)
                counts["sent"] += _stream(
                    settings,
                    arm.run_cycle,
                    lambda arm=arm: arm.is_gone or pipe.poll(),
                )
                counts["moved_rad"] = counts["moved_rad"] + arm.moved_rad
                speeds, _, _ = arm.signals
                counts["speed_rad_s"] = float(np.abs(speeds["dq_rad_s"]).max())

    return counts


def franka_state(number: int, settings: ArmSettings, arm: _Fer) -> bytes:
    """The state of one millisecond: 2,373 bytes."""
    row = number % len(settings.q_rad)
    values = np.zeros(FRANKA_DOUBLES)
    rows = {
        "q_rad": settings.q_rad,
        "dq_rad_s": settings.dq_rad_s,
        "tau_Nm": settings.effort,
    }
    for name, array in rows.items():
        values[FRANKA_AT[name] :][:7] = array[row]

    motion, modes, is_moving = arm.signals
    for name, array in motion.items():
        values[FRANKA_AT[name] :][:7] += array

    values[:96] = np.tile(np.eye(4).ravel(), 6)  # six poses
    # Modes, errors, reasons of a reflex; the robot's mode: idle or moving.
    flags = modes + bytes(2 * 41) + bytes([2 if is_moving else 1])
    return (
        struct.pack("<Q", number + 1)
        + values.tobytes()
        + flags
        + struct.pack("<d", 1.0)
    )
