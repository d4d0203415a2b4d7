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
from contextlib import suppress

import numpy as np

from needleforce.devices.datagram_link import LOOPBACK

RATE_Hz = 500.0
PATIENCE = 30.0
"""Times the silence that the client asks for the watchdog bears: the machine that runs
the test pauses, too."""

HEADER = struct.Struct(">HB")
LAYOUTS = {"DOUBLE": "d", "VECTOR6D": "6d", "UINT32": "I", "INT32": "i"}
"""How values of RTDE are packed, big endian."""

SCALARS = {
    "timestamp": "DOUBLE",
    "runtime_state": "UINT32",
    "robot_status_bits": "UINT32",
    "safety_status_bits": "UINT32",
}
SPEED_J, SPEED_STOP, WATCHDOG, STOP_SCRIPT = 9, 15, 35, 255
"""What the client writes into the first integer register; 0: nothing."""

DASHBOARD = {
    b"polyscope": b"URSoftware 5.12.0.1101319 (Sep 04 2021)\n",
    b"serial": b"20215599999\n",
    b"stop": b"Stopped\n",
}


def kind_of(name):
    """The type of a value of RTDE, by its name."""
    if "int_register" in name:
        return "INT32"
    return "DOUBLE" if "double_register" in name else SCALARS.get(name, "VECTOR6D")


class Controller:
    """What the ports share; it sends rows of position, velocity, current in turn.

    Attributes:
        moved_rad: How far the arm has been moved from where its rows say it is.
        stops: How often the client has stopped a motion.
        watchdog_Hz: How often the client has to be heard, as it says; 0 until then.
        is_running: Whether the client's program runs.
        watchdog_ended: Whether it was ended since the client was silent.
    """

    def __init__(self, rows):
        self.rows = rows
        self.heard_s = time.monotonic()
        self.watchdog_Hz = 0.0
        self.watchdog_ended = False
        self.max_step_rad_s = 0.0
        self.moved_rad = np.zeros(6)
        self.program_state = 1  # ready; 2: done
        self.stops = 0
        self.end_program()

    def end_program(self):
        """The arm stops at once."""
        self.is_running = False
        self.wish_rad_s = np.zeros(6)
        self.velocity_rad_s = np.zeros(6)

    def run_cycle(self):
        """Move the arm for one period, and look after the watchdog."""
        silent_s = time.monotonic() - self.heard_s
        if self.is_running and silent_s * self.watchdog_Hz > PATIENCE:
            self.watchdog_ended = True
            self.end_program()
        change_rad_s = self.wish_rad_s - self.velocity_rad_s
        step_rad_s = np.clip(change_rad_s, -self.max_step_rad_s, self.max_step_rad_s)
        self.velocity_rad_s = self.velocity_rad_s + step_rad_s
        self.moved_rad = self.moved_rad + self.velocity_rad_s / RATE_Hz

    def take_input(self, values):
        """Take what a client has written: a command and its numbers."""
        command = int(values[0])
        self.heard_s = time.monotonic()
        if command == SPEED_J:
            self.max_step_rad_s = values[7] / RATE_Hz
            self.wish_rad_s = np.array(values[1:7])
            return
        if command == SPEED_STOP:
            self.stops += 1
            self.wish_rad_s = np.zeros(6)
        elif command == WATCHDOG:
            self.watchdog_Hz = values[1]
        elif command == STOP_SCRIPT:
            self.end_program()
        self.program_state = 2 if command else 1

    def output(self, name, number):
        """What an output of RTDE holds at a cycle."""
        q_rad, dq_rad_s, current_A = self.rows[:, number % self.rows.shape[1]]
        known = {
            "timestamp": [number / RATE_Hz],
            "actual_q": q_rad + self.moved_rad,
            "actual_qd": dq_rad_s + self.velocity_rad_s,
            "actual_current": current_A,
            "runtime_state": [1 + self.is_running],  # stopped, playing
            "robot_status_bits": [1 + 2 * self.is_running],  # power, program
            "output_int_register_0": [self.program_state],
        }
        layout = LAYOUTS[kind_of(name)]
        values = known.get(name, [0] * int(layout[:-1] or 1))
        return struct.pack(f">{layout}", *values)

    def serve_dashboard(self, reader, writer):
        """Answer what the client asks the dashboard."""
        writer.write(b"Connected: Universal Robots Dashboard Server\n")
        for request in reader:
            asked = [word for word in DASHBOARD if word in request.lower()]
            if asked == [b"stop"]:
                self.end_program()
            writer.write(DASHBOARD[asked[0]] if asked else b"true\n")

    def serve_script(self, reader, _writer):
        """Begin the client's program when all of it has come."""
        for line in reader:
            if b"NODE_CONTROL_LOOP_ENDS" in line:  # the last one
                self.is_running = True

    def serve_rtde(self, reader, writer):
        """Answer a client of RTDE until it goes."""
        outputs = []
        inputs = {}

        def send(kind, payload):
            writer.write(HEADER.pack(HEADER.size + len(payload), ord(kind)) + payload)

        while header := reader.read(HEADER.size):
            size, number = HEADER.unpack(header)
            kind = chr(number)
            payload = reader.read(size - HEADER.size)
            text = payload[8 if kind == "O" else 0 :].decode("latin-1").rstrip(",")
            names = text.split(",")
            answer = bytes([1])
            if kind == "U":
                values = struct.unpack(inputs[payload[0]], payload[1:])
                self.take_input(values)
                continue
            if kind == "v":  # version of the controller
                answer = struct.pack(">4I", 5, 12, 0, 0)
            elif kind == "O":
                outputs = names
                answer += ",".join(map(kind_of, names)).encode()
            elif kind == "I":
                answer = bytes([len(inputs) + 1])
                answer += ",".join(map(kind_of, names)).encode()
                layout = "".join(LAYOUTS[kind_of(name)] for name in names)
                inputs[len(inputs) + 1] = f">{layout}"
            send(kind, answer)
            if kind == "S":
                threading.Thread(
                    target=self.stream, args=(writer, send, outputs), daemon=True
                ).start()

    def stream(self, writer, send, names):
        """Send the outputs in real time until the client goes."""
        begin_s = time.monotonic()
        number = 0
        with suppress(OSError, ValueError):
            while not writer.closed:
                due_s = begin_s + number / RATE_Hz
                time.sleep(max(due_s - time.monotonic(), 0.0))
                outputs = [self.output(name, number) for name in names]
                send("U", bytes([1]) + b"".join(outputs))
                number += 1


def open_port(port, serve):
    """Serve every client of a port by a thread."""

    class Talk(socketserver.StreamRequestHandler):
        def handle(self):
            with suppress(OSError):
                serve(self.rfile, self.wfile)

    class Server(socketserver.ThreadingTCPServer):
        allow_reuse_address = True
        daemon_threads = True

    server = Server((LOOPBACK, port), Talk)
    threading.Thread(target=server.serve_forever, daemon=True).start()


def emulate_ur(pipe, rows):
    """A controller that sends what clients ask for, and moves as they command."""
    controller = Controller(rows)
    open_port(29999, controller.serve_dashboard)
    open_port(30003, controller.serve_script)
    open_port(30004, controller.serve_rtde)
    pipe.send({})
    due_s = time.monotonic()
    while not pipe.poll():
        due_s += 1.0 / RATE_Hz
        time.sleep(max(due_s - time.monotonic(), 0.0))
        controller.run_cycle()
    names = ("moved_rad", "stops", "is_running", "watchdog_ended", "watchdog_Hz")
    return {name: getattr(controller, name) for name in names}
