"""Emulators of an LWR's controller and of a Net F/T sensor, each in a process of its
own.

They speak the protocols of `fri` and `rdt` over loopback, in real time, and break on
demand: lost, late, reordered, repeated, truncated packets, garbage, silence, a
connection that gets worse.
"""

import multiprocessing
import os
import select
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, HTTPServer
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from needleforce.devices import fri, rdt
from needleforce.devices.proxy import LOOPBACK, Array, DatagramLink, LinkError

START_s = 30.0  # A process that imports numpy on a busy machine takes its time
Window = tuple[float, float]  # Start and end [s] since the first packet


@dataclass(frozen=True, slots=True, kw_only=True)
class Faults:
    """What goes wrong on the wire: probabilities per packet, and windows of time.

    Attributes:
        late: By three packets: it comes out of order.
        garbage: A datagram of random bytes and length goes before.
        silent: Nothing is sent.
        bad_quality: The controller rates the connection as bad.
    """

    lost: float = 0.0
    late: float = 0.0
    repeated: float = 0.0
    truncated: float = 0.0
    garbage: float = 0.0
    silent: tuple[Window, ...] = ()
    bad_quality: tuple[Window, ...] = ()
    seed: int = 0


def take_real_time(priority: int = 60) -> bool:
    """Ask for first-in-first-out scheduling; whether the system grants it."""
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        return True
    return False


class _Wire(DatagramLink):
    """A link on loopback that breaks the datagrams that it sends to its peer."""

    def __init__(self, faults: Faults, peer: tuple[str, int] | None = None) -> None:
        super().__init__(LOOPBACK, 0)
        self._faults = faults
        self.peer = peer
        self._rng = np.random.default_rng(faults.seed)
        self._late: dict[
            int, bytes
        ] = {}  # by the number of the packet they come before
        self._number = self.sent = 0
        self._socket.setblocking(False)

    def received(self, end_s: float) -> Iterator[tuple[bytes, tuple[str, int]]]:
        """Datagrams that come before a time, and from where: from anywhere."""
        # `select` waits for microseconds, a socket's own timeout for whole
        # milliseconds.
        while (left_s := end_s - time.monotonic()) > 0.0:
            if select.select([self._socket], [], [], left_s)[0]:
                with suppress(ConnectionError, BlockingIOError):  # nobody listens yet
                    yield self._socket.recvfrom(2048)

    def put(self, data: bytes, t_s: float) -> bool:
        """Send a packet, or break it; whether it went out whole and now."""
        faults = self._faults
        draw = self._rng.random(5)
        self._number += 1
        if self._number in self._late:
            self._send(self._late.pop(self._number))
        if is_within(faults.silent, t_s) or draw[0] < faults.lost:
            return False
        if draw[1] < faults.late:
            self._late[self._number + 3] = data
            return False
        if draw[2] < faults.garbage:
            self._send(self._rng.bytes(int(self._rng.integers(0, 2000))))
        if draw[3] < faults.truncated:
            self._send(data[: int(self._rng.integers(0, len(data)))])
            return False
        self._send(data)
        self.sent += 1
        if draw[4] < faults.repeated:
            self._send(data)
        return True


def is_within(windows: tuple[Window, ...], t_s: float) -> bool:
    """Whether a time lies in one of the windows."""
    return any(start <= t_s < end for start, end in windows)


class Emulator(AbstractContextManager["Emulator"]):
    """A process that emulates a device; for the ``with`` statement.

    Args:
        work: Module-level function: takes a connection to this process and the
            settings; sends what is `ready`, ends when something comes back, and returns
            counts.
        settings: Passed on.

    Attributes:
        ready: What the device says when it is up: its ports.

    Raises:
        LinkError: It did not start.
    """

    def __init__(self, work: Callable[..., dict[str, Any]], *settings: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(
            target=_run, args=(other, work, settings), daemon=True
        )
        self._process.start()
        other.close()
        self.ready: dict[str, Any] = self._reply(START_s)

    def _reply(self, wait_s: float | None) -> dict[str, Any]:
        with suppress(EOFError, ConnectionError):
            if self._pipe.poll(wait_s):
                return self._pipe.recv()
        self._process.kill()
        raise LinkError(
            "the emulator has ended without an answer; its message stands above"
        )

    def counts(self, wait_s: float | None = None) -> dict[str, Any]:
        """What it has counted, once it has ended by itself, however long that takes
        if None.
        """
        found = self._reply(wait_s)
        self._process.join(START_s)
        return found

    def stop(self) -> dict[str, Any]:
        """End it, unless it has ended by itself; what it has counted."""
        with suppress(ConnectionError):
            self._pipe.send("stop")
        return self.counts(START_s)

    def __exit__(self, *error: object) -> None:
        self._process.kill()
        self._process.join()


def _run(
    pipe: Connection, work: Callable[..., dict[str, Any]], settings: tuple[Any, ...]
) -> None:
    pipe.send(work(pipe, *settings))


@dataclass(frozen=True, kw_only=True)
class FriSettings:
    """What the emulated controller does.

    Rows of the signals are sent in turn, one a cycle; commands move only the reported
    command.

    Attributes:
        port: To which it sends.
        q_rad: Shape (m, 7).
        tau_Nm: Shape (m, 7).
        cycles: Then it ends.
        in_real_time: Whether it asks the system for real-time priority.
        command_from_s: When it goes from monitor to command mode.
    """

    port: int
    q_rad: Array
    tau_Nm: Array
    period_s: float = 1e-3
    cycles: int | None = None
    in_real_time: bool = False
    patience_s: float = (
        0.0  # so much longer a cycle lasts until it is answered; a real one never
    )
    command_from_s: float = float("inf")
    faults: Faults = field(default_factory=Faults)


def emulate_fri(pipe: Connection, settings: FriSettings) -> dict[str, Any]:
    """The controller of an LWR; counts of cycles and of answers in the same cycle."""
    if settings.in_real_time:
        take_real_time()
    wire = _Wire(settings.faults, (LOOPBACK, settings.port))
    packet = np.zeros((), fri.MEASUREMENT)
    packet["size"] = fri.MEASUREMENT.itemsize
    packet["kind"] = fri.MEASUREMENT_KIND
    packet["period_s"] = settings.period_s
    packet["commanded_rad"] = settings.q_rad[0]
    pipe.send({"port": wire.address[1]})
    counts = {"cycles": 0, "same_cycle": 0}
    due_s = time.monotonic()
    while counts["cycles"] != settings.cycles and not (
        counts["cycles"] % 100 == 0 and pipe.poll()
    ):
        number = counts["cycles"]
        t_s = counts["cycles"] * settings.period_s
        row = number % len(settings.q_rad)
        is_bad = is_within(settings.faults.bad_quality, t_s)
        is_commanded = t_s >= settings.command_from_s and not is_bad
        packet["count"] = number % fri.COUNTS
        packet["stamp_s"] = t_s
        packet["state"] = fri.State.COMMAND if is_commanded else fri.State.MONITOR
        packet["quality"] = fri.Quality.BAD if is_bad else fri.Quality.PERFECT
        packet["position_rad"] = settings.q_rad[row]
        packet["torque_Nm"] = settings.tau_Nm[row]
        due_s += settings.period_s
        patience_s = settings.patience_s if wire.put(packet.tobytes(), t_s) else 0.0
        while found := next(wire.received(due_s + patience_s), None):
            if len(found[0]) != fri.COMMAND.itemsize:
                continue
            answer = np.frombuffer(found[0], fri.COMMAND)[0]
            if answer["reflected"] == packet["count"]:
                counts["same_cycle"] += 1
                if patience_s:  # the cycles after a long one are not hurried
                    due_s = max(due_s, time.monotonic())
                    patience_s = 0.0
                if is_commanded:
                    packet["commanded_rad"] = answer["position_rad"]
        counts["cycles"] += 1
    return {
        **counts,
        "sent": wire.sent,
        "commanded_rad": packet["commanded_rad"].copy(),
    }


@dataclass(frozen=True, kw_only=True)
class RdtSettings:
    """What the emulated sensor does: rows of wrenches are sent over and over once it
    is asked.

    Attributes:
        wrench: Force [N] and torque [Nm], shape (m, 6).
        scale: Counts per N and per Nm.
        records: To a datagram in buffered mode.
    """

    wrench: Array
    rate_hz: float = 7000.0
    scale: tuple[float, float] = (1e6, 1e6)
    records: int = 40
    faults: Faults = field(default_factory=Faults)


def emulate_rdt(pipe: Connection, settings: RdtSettings) -> dict[str, Any]:
    """A Net F/T box with its page; counts of the records sent."""
    wire = _Wire(settings.faults)
    pipe.send({"port": wire.address[1], "page": _serve_scale(*settings.scale)})
    rows = np.round(settings.wrench * np.repeat(settings.scale, 3)).astype(">i4")
    zero = np.zeros(6, dtype=">i4")
    number = 0
    size = 1
    begin_s = time.monotonic()
    while not pipe.poll():
        due = (time.monotonic() - begin_s) * settings.rate_hz
        while wire.peer is not None and number + size <= due:
            records = np.zeros(size, rdt.RECORD)
            counted = np.arange(number, number + size)
            records["count"] = records["ft_count"] = counted % rdt.COUNTS
            records["counts"] = rows[counted % len(rows)] - zero
            wire.put(records.tobytes(), number / settings.rate_hz)
            number += size
        for data, sender in wire.received(time.monotonic() + 1e-3):
            if (
                len(data) != rdt.REQUEST.size
                or rdt.REQUEST.unpack(data)[0] != rdt.REQUEST_MARK
            ):
                continue
            command = rdt.REQUEST.unpack(data)[1]
            if command == rdt.SOFTWARE_BIAS:
                zero = rows[number % len(rows)].copy()
            elif command == rdt.STOP:
                wire.peer = None
            elif wire.peer is None:
                wire.peer = sender
                size = settings.records if command == rdt.BUFFERED else 1
                begin_s = time.monotonic() - number / settings.rate_hz
    return {"records": number, "sent": wire.sent}


def _serve_scale(per_N: float, per_Nm: float) -> str:
    """Serve the page that says the counts per unit; its address."""
    text = f"<netft><calcpf>{per_N:g}</calcpf><calcpt>{per_Nm:g}</calcpt></netft>"

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response_only(200)  # `send_response` would log
            self.end_headers()
            self.wfile.write(text.encode())

    server = HTTPServer((LOOPBACK, 0), Page)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://{LOOPBACK}:{server.server_address[1]}/netftcalapi.xml"
