"""An emulator of a UR e-Series controller that the vendor-independent client accepts.

A function for `emulators.Emulator`. It serves the ports of a controller on loopback:
the dashboard, the port that takes a program, and RTDE version 2 with inputs and
outputs. Of the client's program it does what moves the arm: velocities, the stop, the
watchdog.
"""

import socket
import struct
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.datagram_link import LOOPBACK

DASHBOARD_PORT = 29999
SCRIPT_PORT = 30003
RTDE_PORT = 30004

RTDE_HEADER = struct.Struct(">HB")
VERSION = b"V"[0]
CONTROLLER = b"v"[0]
OUTPUTS = b"O"[0]
INPUTS = b"I"[0]
START = b"S"[0]
DATA = b"U"[0]

KINDS = {
    "DOUBLE": "d",
    "VECTOR6D": "6d",
    "UINT32": "I",
    "INT32": "i",
}
"""How values of RTDE are packed, big endian."""

SCALARS = {
    "timestamp": "DOUBLE",
    "runtime_state": "UINT32",
    "robot_status_bits": "UINT32",
    "safety_status_bits": "UINT32",
}

STOPPED = 1
PLAYING = 2
"""States of the controller's runtime."""

READY = 1
DONE = 2
"""States of the client's program."""

NO_COMMAND = 0
SPEED_J = 9
SPEED_STOP = 15
WATCHDOG = 35
STOP_SCRIPT = 255
"""Commands that the client writes into the first integer register."""

PROGRAM_END = b"NODE_CONTROL_LOOP_ENDS"
"""In the last line of the client's program."""


@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """What the emulated arm sends: rows over and over, at a rate."""

    q_rad: Array  # shape (m, 6)
    dq_rad_s: Array
    effort: Array  # currents [A]
    rate_hz: float = 500.0


def listen(port: int) -> socket.socket:
    listener = socket.socket()
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind((LOOPBACK, port))
    listener.listen(1)
    listener.settimeout(0.1)
    return listener


def read_exactly(link: socket.socket, size: int) -> bytes:
    """So many bytes; `ConnectionError` if the other has gone."""
    data = b""
    while len(data) < size:
        piece = link.recv(size - len(data))
        if not piece:
            raise ConnectionError
        data += piece
    return data


def kind_of(name: str) -> str:
    """The type of a value of RTDE, by its name."""
    if "int_register" in name:
        return "INT32"
    if "double_register" in name:
        return "DOUBLE"

    return SCALARS.get(name, "VECTOR6D")


class _Controller:
    """What the ports share.

    Attributes:
        moved_rad: How far the arm has been moved from where its rows say it is.
        sent: How many states were sent.
        stops: How often the client has stopped a motion.
        watchdog_ended: Whether the client's program was ended since the client was
            silent.
    """

    def __init__(self, settings: ArmSettings) -> None:
        self._settings = settings
        self._lock = threading.Lock()
        self._begin_s = time.monotonic()
        self._heard_s = self._begin_s
        self._silence_s = np.inf  # that the watchdog bears
        self._wish_rad_s = np.zeros(6)
        self._max_step_rad_s = 0.0
        self._velocity_rad_s = np.zeros(6)
        self._program_state = READY
        self.is_running = False
        self.moved_rad = np.zeros(6)
        self.sent = 0
        self.stops = 0
        self.watchdog_ended = False
        self.is_over = False

    @property
    def now_s(self) -> float:
        """Time since the start."""
        return time.monotonic() - self._begin_s

    def run_cycle(self) -> None:
        """Move the arm for one period, and look after the watchdog."""
        period_s = 1.0 / self._settings.rate_hz
        with self._lock:
            is_silent = time.monotonic() - self._heard_s > self._silence_s
            if self.is_running and is_silent:
                self.watchdog_ended = True
                self.end_program()

            change = self._wish_rad_s - self._velocity_rad_s
            step = np.clip(change, -self._max_step_rad_s, self._max_step_rad_s)
            self._velocity_rad_s = self._velocity_rad_s + step
            self.moved_rad = self.moved_rad + period_s * self._velocity_rad_s

    def end_program(self) -> None:
        """End the client's program; the arm stops at once."""
        self.is_running = False
        self._wish_rad_s = np.zeros(6)
        self._velocity_rad_s = np.zeros(6)

    def take_input(self, values: list[float]) -> None:
        """Take what a client has written: a command and its numbers."""
        command = int(values[0])
        with self._lock:
            self._heard_s = time.monotonic()
            if command == SPEED_J:
                self._wish_rad_s = np.array(values[1:7])
                self._max_step_rad_s = values[7] / self._settings.rate_hz
            elif command == SPEED_STOP:
                self.stops += 1
                self._wish_rad_s = np.zeros(6)
            elif command == WATCHDOG:
                self._silence_s = 1.0 / values[1]
            elif command == STOP_SCRIPT:
                self.end_program()

            if command != SPEED_J:  # the others are over when the next may come
                self._program_state = READY if command == NO_COMMAND else DONE

    def values_of(self, name: str, number: int) -> list[float]:
        """What an output of RTDE holds at a cycle."""
        settings = self._settings
        row = number % len(settings.q_rad)
        with self._lock:
            known = {
                "timestamp": [number / settings.rate_hz],
                "actual_q": settings.q_rad[row] + self.moved_rad,
                "actual_qd": settings.dq_rad_s[row] + self._velocity_rad_s,
                "actual_current": settings.effort[row],
                "runtime_state": [PLAYING if self.is_running else STOPPED],
                "robot_status_bits": [1 + 2 * self.is_running],  # power, program
                "output_int_register_0": [self._program_state],
            }
            size = int(KINDS[kind_of(name)][:-1] or 1)
            return list(known.get(name, [0] * size))


class _RtdeClient:
    """One client of RTDE, served by a thread."""

    def __init__(self, link: socket.socket, controller: _Controller, rate_hz: float):
        self._link = link
        self._controller = controller
        self._rate_hz = rate_hz
        self._sending = threading.Lock()
        self._outputs: list[str] = []
        self._inputs: dict[int, list[str]] = {}

    def serve(self) -> None:
        """Answer the client until it goes."""
        try:
            while True:
                header = read_exactly(self._link, RTDE_HEADER.size)
                size, kind = RTDE_HEADER.unpack(header)
                payload = read_exactly(self._link, size - RTDE_HEADER.size)
                self._answer(kind, payload)
        except OSError:
            self._link.close()

    def _send(self, kind: int, payload: bytes) -> None:
        header = RTDE_HEADER.pack(RTDE_HEADER.size + len(payload), kind)
        with self._sending:
            self._link.sendall(header + payload)

    def _answer(self, kind: int, payload: bytes) -> None:
        if kind == VERSION:
            self._send(kind, bytes([payload == b"\x00\x02"]))
        elif kind == CONTROLLER:
            self._send(kind, struct.pack(">4I", 5, 12, 0, 0))
        elif kind == OUTPUTS:
            self._outputs = payload[8:].decode().rstrip(",").split(",")
            self._send(kind, bytes([1]) + self._kinds(self._outputs))
        elif kind == INPUTS:
            names = payload.decode().rstrip(",").split(",")
            recipe = len(self._inputs) + 1
            self._inputs[recipe] = names
            self._send(kind, bytes([recipe]) + self._kinds(names))
        elif kind == DATA:
            names = self._inputs[payload[0]]
            layout = ">" + "".join(KINDS[kind_of(name)] for name in names)
            values = list(struct.unpack(layout, payload[1:]))
            self._controller.take_input(values)
        else:
            self._send(kind, bytes([1]))
            if kind == START:
                threading.Thread(target=self._stream, daemon=True).start()

    def _kinds(self, names: list[str]) -> bytes:
        return ",".join(kind_of(name) for name in names).encode()

    def _stream(self) -> None:
        """Send the outputs in real time until the client goes."""
        controller = self._controller
        number = 0
        begin_s = time.monotonic()
        while not controller.is_over:
            t_s = number / self._rate_hz
            time.sleep(max(begin_s + t_s - time.monotonic(), 0.0))
            data = b"".join(
                struct.pack(
                    ">" + KINDS[kind_of(name)], *controller.values_of(name, number)
                )
                for name in self._outputs
            )
            try:
                self._send(DATA, bytes([1]) + data)
            except OSError:
                return

            controller.sent += 1
            number += 1


def _serve_dashboard(link: socket.socket, controller: _Controller) -> None:
    """Answer what the client asks the dashboard."""
    link.sendall(b"Connected: Universal Robots Dashboard Server\n")
    while request := link.recv(1000).decode().lower():
        if "polyscope" in request:
            link.sendall(b"URSoftware 5.12.0.1101319 (Sep 04 2021)\n")
        elif "serial" in request:
            link.sendall(b"20215599999\n")
        elif "stop" in request:
            controller.end_program()
            link.sendall(b"Stopped\n")
        else:
            link.sendall(b"true\n")


def _serve_script(link: socket.socket, controller: _Controller) -> None:
    """Take the client's program, and begin it when all of it has come."""
    latest = b""
    while piece := link.recv(1 << 16):
        latest = (latest + piece)[-2 * len(PROGRAM_END) - 20 :]
        controller.is_running = controller.is_running or PROGRAM_END in latest


def _accept(listener: socket.socket, controller: _Controller, serve: Any) -> None:
    """Serve every client of a port by a thread."""
    while not controller.is_over:
        try:
            link, _ = listener.accept()
        except OSError:
            continue

        link.setblocking(True)
        threading.Thread(target=serve, args=(link, controller), daemon=True).start()


def emulate_ur(pipe: Connection, settings: ArmSettings) -> dict[str, Any]:
    """A controller that sends what clients ask for, and moves as they command."""
    controller = _Controller(settings)

    def serve_rtde(link: socket.socket, controller: _Controller) -> None:
        _RtdeClient(link, controller, settings.rate_hz).serve()

    served = {
        DASHBOARD_PORT: _serve_dashboard,
        SCRIPT_PORT: _serve_script,
        RTDE_PORT: serve_rtde,
    }
    for port, serve in served.items():
        arguments = (listen(port), controller, serve)
        threading.Thread(target=_accept, args=arguments, daemon=True).start()

    pipe.send({"port": RTDE_PORT})
    cycle = 0
    while not pipe.poll():
        cycle += 1
        time.sleep(max(cycle / settings.rate_hz - controller.now_s, 0.0))
        controller.run_cycle()

    controller.is_over = True
    return {
        "sent": controller.sent,
        "moved_rad": controller.moved_rad,
        "stops": controller.stops,
        "is_running": controller.is_running,
        "watchdog_ended": controller.watchdog_ended,
    }
