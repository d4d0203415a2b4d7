"""ATI Net F/T: force and torque through its raw data transfer (RDT).

One request begins the stream; records of 36 bytes come back, one to a datagram or,
buffered, forty. Numbers are big endian; counts per newton are set in the sensor and
read from it, never assumed.
"""

import struct
from collections.abc import Iterator
from enum import IntEnum
from http.client import HTTPException
from time import monotonic
from typing import NamedTuple
from urllib.request import urlopen
from xml.etree import ElementTree

import numpy as np

from foundation.arrays import Array
from needleforce.devices.datagram_link import (
    LOOPBACK,
    MAX_PORT,
    DatagramLink,
    Endpoint,
    resolve_host,
)
from needleforce.devices.errors import DeviceSettingError, LinkError
from needleforce.devices.link import run_within
from needleforce.devices.rdt_status import is_faulty

PORT = 49152
"""Of the sensor, unless it is configured otherwise."""

REQUEST_MARK = 0x1234
"""How a request begins."""

REQUEST = struct.Struct(">HHI")
"""Mark, command, and how many records are asked for; 0: any number."""


class RdtCommand(IntEnum):
    """Commands in a request."""

    STOP = 0
    STREAM = 2
    BUFFERED = 3
    SOFTWARE_BIAS = 0x42


RECORD = np.dtype(
    [("count", ">u4"), ("ft_count", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)]
)
"""What the sensor sends."""

COUNTS = 1 << 32
"""Counters of records go round after so many."""

MAX_COUNTED_GAP_S = 1.0
"""A sensor silent for longer may have been off, and count from zero."""

MAX_RECORDS_AHEAD = 10_000
"""Records of such a time; one further on, or further back, is not a new record."""

MIN_RENUMBERED_RECORDS = 400
"""After so many in a row that are no new records the sensor has restarted its count."""

MAX_REPLY_BYTES = 1 << 20
"""So much of the sensor's page is read."""

RECEIVE_BUFFER_BYTES = 1 << 22
"""Room for the records of half a second, if net.core.rmem_max allows as much."""

MAX_READ_S = 1.5e-3
"""After so long `NetFT.read` takes no further datagram; the last of forty records takes
0.2 ms. A loop of 1 kHz misses a cycle or two, whatever the network sends."""

MAX_DATAGRAM_BYTES = 40 * RECORD.itemsize
"""Of a buffered datagram; a longer one is none of the sensor."""


class Scale(NamedTuple):
    """How many counts the sensor gives.

    Attributes:
        per_N: For a newton.
        per_Nm: For a newton metre.
    """

    per_N: float
    per_Nm: float


def read_scale(url: str, *, timeout_s: float = 2.0) -> Scale:
    """Read the counts from the sensor's page of its calibration.

    Args:
        url: Address of the page.
        timeout_s: Within it the whole page has to be there.

    Raises:
        LinkError: The page cannot be read in time, names no counts, or counts per
            another unit than SI.
    """

    def fetch() -> bytes:
        with urlopen(url, timeout=timeout_s) as reply:
            return reply.read(MAX_REPLY_BYTES)

    try:
        tree = ElementTree.fromstring(run_within(timeout_s, fetch))
    except (OSError, HTTPException, ElementTree.ParseError, ValueError) as error:
        raise LinkError(f"no counts per newton from {url}: {error}") from error

    return Scale(
        per_N=_read_counts(tree, url, "calcpf", "scalfu", "N"),
        per_Nm=_read_counts(tree, url, "calcpt", "scaltu", "Nm"),
    )


def _read_counts(
    tree: ElementTree.Element, url: str, name: str, unit_name: str, si_unit: str
) -> float:
    """Return the counts per unit that the sensor's page gives.

    Args:
        tree: The page.
        url: Its address, for messages.
        name: Of the element with the counts.
        unit_name: Of the element with the unit; it may be missing.
        si_unit: Which the unit has to be.
    """
    text = tree.findtext(f".//{name}")
    unit = tree.findtext(f".//{unit_name}")
    try:
        counts = float(text or "")
    except ValueError:
        raise LinkError(f"{url} has no number under <{name}>: {text!r}") from None

    if unit is not None and unit.strip().replace("-", "") != si_unit:
        raise LinkError(
            f"{url} counts per {unit.strip()!r} under <{unit_name}>, expected "
            f"{si_unit}",
            "Set the sensor to N and Nm, or give its `scale`: `Scale(per_N, per_Nm)`.",
        )

    return counts


class NetFT(DatagramLink):
    """The sensor: the newest reading, or a stream of all.

    Args:
        host: Address of the sensor, or its name.
        port: Its port.
        scale: Its counts, or the page that says them; None: the sensor's own page.
        buffered: Forty records to a datagram: fewer interruptions, up to 6 ms later.
        listen_on: Address of this machine; None: loopback for a sensor there, else any.

    Attributes:
        scale: Counts per newton and per newton metre.
        status: Word of the latest record; 0 when all is well, see
            `needleforce.devices.rdt_status.describe_status`.
        faults: All bits of the status words of records that were not used.

    Raises:
        LinkError: The sensor's name is unknown, its page cannot be read, or no port is
            free.
        DeviceSettingError: A scale that is not two positive numbers, or a port that is
            none.
    """

    def __init__(
        self,
        host: str = LOOPBACK,
        port: int = PORT,
        *,
        scale: Scale | str | None = None,
        buffered: bool = False,
        listen_on: str | None = None,
    ) -> None:
        host = resolve_host(host)
        page = scale or f"http://{host}/netftcalapi.xml"
        self.scale = read_scale(page) if isinstance(page, str) else page
        if np.shape(self.scale) != (2,) or not all(
            0.0 < counts < np.inf for counts in self.scale
        ):
            raise DeviceSettingError(
                f"{self.scale}: expected positive counts per N and per Nm"
            )

        if not 0 < port <= MAX_PORT:
            raise DeviceSettingError(
                f"port {port} of the sensor: expected 1 to {MAX_PORT}"
            )

        local = listen_on or (LOOPBACK if host.startswith("127.") else "0.0.0.0")
        super().__init__(local, 0, peer=host, buffer_bytes=RECEIVE_BUFFER_BYTES)
        self._keep_peer(Endpoint(host, port))
        self.status = 0
        self.faults = 0
        self._mode = RdtCommand.BUFFERED if buffered else RdtCommand.STREAM
        self._counts_per_unit = np.repeat(self.scale, 3)
        self._latest_count: int | None = None
        self._stray_count = 0  # of the latest record that was no new one
        self._stray_in_row = 0  # such records that follow each other
        self._read_s = monotonic()  # when the latest record was read
        self._zero = np.zeros(6)
        self._newest = np.zeros(6)
        self._request(self._mode)

    def read(self) -> Array | None:
        """Return the newest wrench of all that have come.

        It takes 2 ms at most, also when more waits to be read. Malformed and
        old records are counted in the report. After 1 s of silence the sensor is asked
        anew.

        Returns:
            Force [N] and torque [Nm], shape (6,); None if nothing has come.
        """
        newest = None
        end_s = monotonic() + MAX_READ_S
        while self._is_open and (data := self._next(0.0)) is not None:
            for wrench in self._wrenches(data):
                newest = wrench
            if monotonic() >= end_s:
                break

        if monotonic() - self._read_s > MAX_COUNTED_GAP_S:
            self._ask_again()

        return newest

    def stream(self, wait_s: float = 0.1) -> Iterator[Array | None]:
        """Yield every wrench as it comes.

        Args:
            wait_s: A silence longer than this counts as an outage.

        Yields:
            Force [N] and torque [Nm], shape (6,); None after a silence, when the sensor
            was asked again.
        """
        while self._is_open:
            data = self._next(wait_s)
            if data is None:
                self._ask_again()
                yield None
            else:
                yield from self._wrenches(data)

    def bias(self) -> None:
        """Take the latest reading for zero, here; the sensor's own zero stays."""
        self._zero = self._newest.copy()

    def unbias(self) -> None:
        """Take the sensor's own zero again."""
        self._zero = np.zeros(6)

    def bias_sensor(self) -> None:
        """Let the sensor itself take its present load for zero."""
        self._request(RdtCommand.SOFTWARE_BIAS)

    def close(self) -> None:
        """Ask the sensor to stop, and free the port."""
        self._request(RdtCommand.STOP)
        super().close()

    def _ask_again(self) -> None:
        """Count an outage, and ask for records once more."""
        self.report.outages += 1
        self._read_s = monotonic()
        self._latest_count = None
        self._request(self._mode)

    def _next(self, wait_s: float) -> bytes | None:
        """Return the next datagram; one that is too long has a byte too many."""
        return self._receive(wait_s, MAX_DATAGRAM_BYTES + 1)

    def _request(self, command: RdtCommand) -> None:
        """Send a command to the sensor."""
        self._send(REQUEST.pack(REQUEST_MARK, command, 0))

    def _wrenches(self, data: bytes) -> Iterator[Array]:
        """Yield the valid wrenches of a datagram, shape (6,), oldest first."""
        report = self.report
        now_s = monotonic()
        if not 0 < len(data) <= MAX_DATAGRAM_BYTES or len(data) % RECORD.itemsize:
            report.malformed += 1
            return

        gap_s = now_s - self._read_s
        if gap_s > MAX_COUNTED_GAP_S:
            self._latest_count = None  # it may have begun to count anew
            report.longest_gap_s = max(report.longest_gap_s, gap_s)

        self._read_s = now_s
        for record in np.frombuffer(data, RECORD):
            wrench = self._process(record)
            if wrench is not None:
                yield wrench

    def _process(self, record: np.void) -> Array | None:
        """Return the wrench of a record, shape (6,); None if it is old or invalid."""
        report = self.report
        count = int(record["count"])
        status = int(record["status"])
        is_first = self._latest_count is None
        ahead = 1
        if self._latest_count is not None:
            ahead = (count - self._latest_count) % COUNTS

        if not 0 < ahead <= MAX_RECORDS_AHEAD:
            report.stale += 1
            self._count_stray(count)
            return None

        has_fault = is_faulty(status)
        report.malformed += has_fault
        self.status = status
        if not (is_first and has_fault):  # a faulty first one may be garbage
            self._latest_count = count
            self._stray_in_row = 0
            report.missed += ahead - 1

        if has_fault:
            self.faults |= status
            return None

        report.used += 1
        self._newest = record["counts"] / self._counts_per_unit
        return self._newest - self._zero

    def _count_stray(self, count: int) -> None:
        """Count a record that is no new one; begin anew after many in a row."""
        ahead = (count - self._stray_count) % COUNTS
        follows = 0 < ahead <= MAX_RECORDS_AHEAD
        self._stray_count = count
        self._stray_in_row = self._stray_in_row + 1 if follows else 0
        if self._stray_in_row >= MIN_RENUMBERED_RECORDS:
            self._latest_count = None
