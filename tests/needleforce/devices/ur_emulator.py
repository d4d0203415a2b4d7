"""An emulator of a UR e-Series controller that the vendor-independent client accepts.

A function for `emulators.Emulator`. It serves the ports of a controller on loopback:
the dashboard, the port that takes a program, and RTDE version 2 with inputs and
outputs. Of the client's program it does what moves the arm: velocities, the stop, the
watchdog.
"""

import socketserver
import struct
import threading
import time
from dataclasses import dataclass
from enum import IntEnum
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.datagram_link import LOOPBACK

PORTS = {"dashboard": 29999, "script": 30003, "rtde": 30004}

RTDE_HEADER = struct.Struct(">HB")

LAYOUTS = {"DOUBLE": "d", "VECTOR6D": "6d", "UINT32": "I", "INT32": "i"}
"""How values of RTDE are packed, big endian."""

SCALARS = {
    "timestamp": "DOUBLE",
    "runtime_state": "UINT32",
    "robot_status_bits": "UINT32",
    "safety_status_bits": "UINT32",
}


class Command(IntEnum):
    """What the client writes into the first integer register."""

    NONE = 0
    SPEED_J = 9
    SPEED_STOP = 15
    WATCHDOG = 35
    STOP_SCRIPT = 255


@dataclass(frozen=True, kw_only=True)
class ArmSettings:
    """What the emulated arm sends: rows over and over, at a rate.

    Its watchdog bears `patience` times the silence that the client asks for: the
    machine that runs the test pauses, too.
    """

    q_rad: Array  # shape (m, 6)
    dq_rad_s: Array
    effort: Array  # currents [A]
    rate_hz: float = 500.0
    patience: float = 30.0


def kind_of(name: str) -> str:
    """The type of a value of RTDE, by its name."""
    if "int_register" in name:
        return "INT32"
    return "DOUBLE" if "double_register" in name else SCALARS.get(name, "VECTOR6D")


class _Controller:
    """What the ports share.

    Attributes:
        moved_rad: How far the arm has been moved from where its rows say it is.
        stops: How often the client has stopped a motion.
        watchdog_Hz: How often the client has to be heard, as it says; 0 until then.
        is_running: Whether the client's program runs.
        watchdog_ended: Whether it was ended since the client was silent.
    """

    def __init__(self, settings: ArmSettings) -> None:
        self.settings = settings
        self._lock = threading.Lock()
        self._heard_s = time.monotonic()
        self.watchdog_Hz = 0.0  # as the client asks for it
        self._wish_rad_s = np.zeros(6)
        self._max_step_rad_s = 0.0
        self._velocity_rad_s = np.zeros(6)
        self._program_state = 1  # ready; 2: done
        self.is_running = False
        self.moved_rad = np.zeros(6)
        self.stops = 0
        self.watchdog_ended = False

    def run_cycle(self) -> None:
        """Move the arm for one period, and look after the watchdog."""
        with self._lock:
            silent_s = time.monotonic() - self._heard_s
            is_late = silent_s * self.watchdog_Hz > self.settings.patience
            if self.is_running and is_late:
                self.watchdog_ended = True
                self.end_program()
            change = self._wish_rad_s - self._velocity_rad_s
            step = np.clip(change, -self._max_step_rad_s, self._max_step_rad_s)
            self._velocity_rad_s = self._velocity_rad_s + step
            moved_rad = self._velocity_rad_s / self.settings.rate_hz
            self.moved_rad = self.moved_rad + moved_rad

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
            if command == Command.SPEED_J:
                self._wish_rad_s = np.array(values[1:7])
                self._max_step_rad_s = values[7] / self.settings.rate_hz
            elif command == Command.SPEED_STOP:
                self.stops += 1
                self._wish_rad_s = np.zeros(6)
            elif command == Command.WATCHDOG:
                self.watchdog_Hz = values[1]
            elif command == Command.STOP_SCRIPT:
                self.end_program()
            if command != Command.SPEED_J:  # others are over when the next may come
                self._program_state = 1 if command == Command.NONE else 2

    def output(self, name: str, number: int) -> bytes:
        """What an output of RTDE holds at a cycle."""
        settings = self.settings
        row = number % len(settings.q_rad)
        layout = LAYOUTS[kind_of(name)]
        with self._lock:
            known = {
                "timestamp": [number / settings.rate_hz],
                "actual_q": settings.q_rad[row] + self.moved_rad,
                "actual_qd": settings.dq_rad_s[row] + self._velocity_rad_s,
                "actual_current": settings.effort[row],
                "runtime_state": [2 if self.is_running else 1],  # playing, stopped
                "robot_status_bits": [1 + 2 * self.is_running],  # power, program
                "output_int_register_0": [self._program_state],
            }
        values = known.get(name, [0] * int(layout[:-1] or 1))
        return struct.pack(f">{layout}", *values)


class _Rtde:
    """One client of RTDE."""

    def __init__(self, reader: Any, writer: Any, controller: _Controller) -> None:
        self._reader = reader
        self._writer = writer
        self._controller = controller
        self._sending = threading.Lock()
        self._outputs: list[str] = []
        self._inputs: dict[int, list[str]] = {}

    def serve(self) -> None:
        """Answer the client until it goes."""
        while header := self._reader.read(RTDE_HEADER.size):
            size, kind = RTDE_HEADER.unpack(header)
            self._answer(chr(kind), self._reader.read(size - RTDE_HEADER.size))

    def _send(self, kind: str, payload: bytes) -> None:
        header = RTDE_HEADER.pack(RTDE_HEADER.size + len(payload), ord(kind))
        with self._sending:
            self._writer.write(header + payload)

    def _answer(self, kind: str, payload: bytes) -> None:
        names = payload[8 if kind == "O" else 0 :].decode("latin-1").rstrip(",")
        kinds = ",".join(kind_of(name) for name in names.split(",")).encode()
        if kind == "v":  # version of the controller
            self._send(kind, struct.pack(">4I", 5, 12, 0, 0))
        elif kind == "O":
            self._outputs = names.split(",")
            self._send(kind, bytes([1]) + kinds)
        elif kind == "I":
            recipe = len(self._inputs) + 1
            self._inputs[recipe] = names.split(",")
            self._send(kind, bytes([recipe]) + kinds)
        elif kind == "U":
            inputs = self._inputs[payload[0]]
            layout = "".join(LAYOUTS[kind_of(name)] for name in inputs)
            self._controller.take_input(list(struct.unpack(f">{layout}", payload[1:])))
        else:
            self._send(kind, bytes([1]))
        if kind == "S":
            threading.Thread(target=self._stream, daemon=True).start()

    def _stream(self) -> None:
        """Send the outputs in real time until the client goes."""
        begin_s = time.monotonic()
        number = 0
        while not self._writer.closed:
            t_s = number / self._controller.settings.rate_hz
            time.sleep(max(begin_s + t_s - time.monotonic(), 0.0))
            outputs = (self._controller.output(name, number) for name in self._outputs)
            try:
                self._send("U", bytes([1]) + b"".join(outputs))
            except (OSError, ValueError):
                return
            number += 1


def _serve_dashboard(reader: Any, writer: Any, controller: _Controller) -> None:
    """Answer what the client asks the dashboard."""
    answers = {
        b"polyscope": b"URSoftware 5.12.0.1101319 (Sep 04 2021)\n",
        b"serial": b"20215599999\n",
        b"stop": b"Stopped\n",
    }
    writer.write(b"Connected: Universal Robots Dashboard Server\n")
    for request in reader:
        asked = [word for word in answers if word in request.lower()]
        if asked == [b"stop"]:
            controller.end_program()
        writer.write(answers[asked[0]] if asked else b"true\n")


def _serve_script(reader: Any, _writer: Any, controller: _Controller) -> None:
    """Take the client's program, and begin it when all of it has come."""
    for line in reader:
        if b"NODE_CONTROL_LOOP_ENDS" in line:  # the last one
            controller.is_running = True


def _serve_rtde(reader: Any, writer: Any, controller: _Controller) -> None:
    _Rtde(reader, writer, controller).serve()


def _open_port(port: int, controller: _Controller, serve: Any) -> None:
    """Serve every client of a port by a thread."""

    class Talk(socketserver.StreamRequestHandler):
        def handle(self) -> None:
            try:
                serve(self.rfile, self.wfile, controller)
            except OSError:
                return

    class Server(socketserver.ThreadingTCPServer):
        allow_reuse_address = True
        daemon_threads = True

    server = Server((LOOPBACK, port), Talk)
    threading.Thread(target=server.serve_forever, daemon=True).start()


def emulate_ur(pipe: Connection, settings: ArmSettings) -> dict[str, Any]:
    """A controller that sends what clients ask for, and moves as they command."""
    controller = _Controller(settings)
    served = (_serve_dashboard, _serve_script, _serve_rtde)
    for port, serve in zip(PORTS.values(), served, strict=True):
        _open_port(port, controller, serve)
    pipe.send({"port": PORTS["rtde"]})
    begin_s = time.monotonic()
    cycle = 0
    while not pipe.poll():
        cycle += 1
        time.sleep(max(begin_s + cycle / settings.rate_hz - time.monotonic(), 0.0))
        controller.run_cycle()
    return {
        "moved_rad": controller.moved_rad,
        "stops": controller.stops,
        "is_running": controller.is_running,
        "watchdog_ended": controller.watchdog_ended,
        "watchdog_Hz": controller.watchdog_Hz,
    }
