"""Emulated devices: a process of its own for each, and a wire that breaks on demand.

Emulators speak the devices' own protocols over loopback, in real time. Packets may be
lost, late, reordered, repeated or truncated; there may be garbage, silence, and a
connection that gets worse.
"""

import multiprocessing
import os
import select
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NamedTuple, Protocol

import numpy as np

from needleforce.devices.datagram_link import (
    LOOPBACK,
    Datagram,
    DatagramLink,
    Endpoint,
)
from needleforce.devices.errors import LinkError

START_S = 30.0
"""A process that imports numpy on a busy machine takes its time to start or end."""

PRIORITY = 60
"""Of an emulator in real time, among 1 to 99."""

LATE_PACKETS = 3
"""So many packets overtake a late one."""

MAX_GARBAGE_BYTES = 2000
"""Of a datagram of random bytes."""

MAX_REQUEST_BYTES = 2048
"""No request to a device is longer."""


class CyclicController(Protocol):
    """A controller that is emulated cycle by cycle.

    Attributes:
        cycles: How many have passed.
    """

    cycles: int

    def run_cycle(self) -> None:
        """Send what a cycle sends, and wait for its answer until the cycle is over."""
        ...


def run_cycles(
    controller: CyclicController,
    cycles: int | None,
    pipe: Connection,
    cycles_between_looks: int,
) -> None:
    """Run a controller for so many cycles, or until something comes in the pipe.

    Args:
        controller: To be run.
        cycles: After so many it ends; None for no end of its own.
        pipe: To the process that has begun this one.
        cycles_between_looks: Cycles between two looks into the pipe.
    """
    while controller.cycles != cycles:
        if controller.cycles % cycles_between_looks == 0 and pipe.poll():
            break

        controller.run_cycle()


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


class _PacketFaults(NamedTuple):
    """What goes wrong with one packet."""

    is_lost: bool
    is_late: bool
    has_garbage: bool
    is_truncated: bool
    is_repeated: bool


def take_real_time(priority: int = PRIORITY) -> bool:
    """Ask for first-in-first-out scheduling; return whether the system grants it."""
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        return True

    return False


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

    def received(self, end_s: float) -> Iterator[Datagram]:
        """Yield datagrams that come before a time, from anywhere."""
        # `select` waits for microseconds, a socket's own timeout for whole
        # milliseconds.
        while (wait_s := end_s - time.monotonic()) > 0.0:
            if select.select([self._socket], [], [], wait_s)[0]:
                with suppress(ConnectionError, BlockingIOError):  # nobody listens yet
                    data, sender = self._socket.recvfrom(MAX_REQUEST_BYTES)
                    yield Datagram(data, Endpoint(*sender))

    def put(self, data: bytes, t_s: float) -> bool:
        """Send a packet, or break it.

        Args:
            data: The packet.
            t_s: Time since the first one.

        Returns:
            Whether it went out whole and in time.
        """
        faults = self._draw_faults()
        self._number += 1
        if self._number in self._late:
            self._send(self._late.pop(self._number))
        if is_within(self._faults.silent, t_s) or faults.is_lost:
            return False
        if faults.is_late:
            self._late[self._number + LATE_PACKETS] = data
            return False
        if faults.has_garbage:
            size = int(self._rng.integers(0, MAX_GARBAGE_BYTES))
            self._send(self._rng.bytes(size))
        if faults.is_truncated:
            self._send(data[: int(self._rng.integers(0, len(data)))])
            return False

        self._send(data)
        self.sent += 1
        if faults.is_repeated:
            self._send(data)

        return True

    def _draw_faults(self) -> _PacketFaults:
        """Return what goes wrong with the next packet."""
        lost, late, garbage, truncated, repeated = self._rng.random(5)
        return _PacketFaults(
            is_lost=lost < self._faults.lost,
            is_late=late < self._faults.late,
            has_garbage=garbage < self._faults.garbage,
            is_truncated=truncated < self._faults.truncated,
            is_repeated=repeated < self._faults.repeated,
        )


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
        self._pipe, other_end = context.Pipe()
        self._process = context.Process(
            target=_run_work, args=(other_end, work, settings), daemon=True
        )
        self._process.start()
        other_end.close()
        self.ready: dict[str, Any] = self._receive(START_S)

    def _receive(self, wait_s: float | None) -> dict[str, Any]:
        """Return what the process sends next; `LinkError` if it has ended."""
        with suppress(EOFError, ConnectionError):
            if self._pipe.poll(wait_s):
                return self._pipe.recv()

        self._process.kill()
        raise LinkError(
            "the emulator has ended without an answer; its message stands above"
        )

    def counts(self, wait_s: float | None = None) -> dict[str, Any]:
        """Return what the emulator has counted, once it has ended by itself.

        Args:
            wait_s: How long it may take; None: any time.
        """
        counts = self._receive(wait_s)
        self._process.join(START_S)
        return counts

    def stop(self) -> dict[str, Any]:
        """End the emulator, unless it has ended; return what it has counted."""
        with suppress(ConnectionError):
            self._pipe.send("stop")

        return self.counts(START_S)

    def __exit__(self, *error: object) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.join()


def _run_work(
    pipe: Connection, work: Callable[..., dict[str, Any]], settings: Sequence[Any]
) -> None:
    """Run an emulator in its process, and send what it has counted."""
    pipe.send(work(pipe, *settings))
