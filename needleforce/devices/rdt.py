"""ATI Net F/T: force and torque through its raw data transfer (RDT).

One request begins the stream; records of 36 bytes come back, one to a datagram or,
buffered, forty. Numbers are big endian; counts per newton are set in the sensor and
read from it, never assumed.
"""

import struct
from collections.abc import Iterator
from http.client import HTTPException
from time import monotonic
from typing import NamedTuple
from urllib.request import urlopen
from xml.etree import ElementTree

import numpy as np

from needleforce.devices.proxy import (
    LOOPBACK,
    Array,
    DatagramLink,
    DeviceSettingError,
    LinkError,
    resolved,
)

PORT = 49152
REQUEST_MARK = 0x1234
REQUEST = struct.Struct(">HHI")
STOP = 0
STREAM = 2
BUFFERED = 3
SOFTWARE_BIAS = 0x42
RECORD = np.dtype(
    [("count", ">u4"), ("ft_count", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)]
)
COUNTS = 1 << 32
LONGEST_COUNTED_s = (
    1.0  # A sensor silent for longer may have been off, and count from zero
)
MOST_AHEAD = 10_000  # Records of such a time; one further on, or further back, is not a new record
RENUMBERED = 400  # Unless so many in a row are: the sensor has restarted its count
MOST_REPLY = 1 << 20
ROOM = (
    1 << 22
)  # Bytes for the records of half a second, if net.core.rmem_max allows as many
FAULT_BITS = (
    0xFFFF0000  # Of the status word: error of the sensor, saturated gauge, lost supply
)


class Scale(NamedTuple):
    """How many counts the sensor gives."""

    per_N: float
    per_Nm: float


def read_scale(url: str, *, timeout_s: float = 2.0) -> Scale:
    """Ask the sensor's page of its calibration for its counts.

    Raises:
        LinkError: The page cannot be read, names no counts, or counts per another unit
            than SI.
    """
    try:
        with urlopen(url, timeout=timeout_s) as reply:
            tree = ElementTree.fromstring(reply.read(MOST_REPLY))
    except (OSError, HTTPException, ElementTree.ParseError, ValueError) as error:
        raise LinkError(
            f"no counts per newton from {url}: {error}; is it the sensor?"
        ) from error
    numbers = []
    for name, unit_name, si in (("calcpf", "scalfu", "N"), ("calcpt", "scaltu", "Nm")):
        text, unit = (tree.findtext(f".//{each}") for each in (name, unit_name))
        try:
            numbers.append(float(text or ""))
        except ValueError:
            raise LinkError(f"{url} has no number under <{name}>: {text!r}") from None
        if unit is not None and unit.strip().replace("-", "") != si:
            what = (
                f"{url} counts per {unit.strip()!r} under <{unit_name}>, expected {si}"
            )
            raise LinkError(
                f"{what}: set the sensor to it, or give scale=Scale(per_N, per_Nm)"
            )
    return Scale(*numbers)


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
        status: Word of the last record; 0 when all is well.

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
        host = resolved(host)
        page = scale or f"http://{host}/netftcalapi.xml"
        self.scale = read_scale(page) if isinstance(page, str) else page
        if np.shape(self.scale) != (2,) or not all(
            0.0 < each < np.inf for each in self.scale
        ):
            raise DeviceSettingError(
                f"{self.scale}: expected positive counts per N and per Nm"
            )
        if not 0 < port <= 65535:
            raise DeviceSettingError(f"port {port} of the sensor: expected 1 to 65535")
        local = listen_on or (LOOPBACK if host.startswith("127.") else "0.0.0.0")
        super().__init__(local, 0, peer=host, room=ROOM)
        self.status = 0
        self._sensor = (host, port)
        self._mode = BUFFERED if buffered else STREAM
        self._divisor = np.repeat(self.scale, 3)
        self._last: int | None = None
        self._odd = self._odd_row = (
            0  # Last count out of sequence, and how many in a row
        )
        self._arrival_s = monotonic()
        self._zero = np.zeros(6)
        self._newest = np.zeros(6)
        self._request(self._mode)

    def read(self) -> Array | None:
        """The newest wrench of all that have come: force [N], torque [Nm], shape (6,);
        else None.

        Raises nothing: `report` counts malformed and old ones. After 1 s of silence it
        asks anew.
        """
        found = None
        while self._is_open and (data := self._receive(0.0)) is not None:
            for wrench in self._records(data):
                found = wrench
        if monotonic() - self._arrival_s > LONGEST_COUNTED_s:
            self._ask_again()
        return found

    def stream(self, wait_s: float = 0.1) -> Iterator[Array | None]:
        """Every wrench as it comes, shape (6,); None after a silence: it is asked
        for again.
        """
        while self._is_open:
            data = self._receive(wait_s)
            if data is None:
                self._ask_again()
                yield None
            else:
                yield from self._records(data)

    def bias(self) -> None:
        """Take the last reading for zero, here; the sensor's own zero stays as it
        is.
        """
        self._zero = self._newest.copy()

    def unbias(self) -> None:
        """Forget that."""
        self._zero = np.zeros(6)

    def bias_sensor(self) -> None:
        """Let the sensor itself take its present load for zero."""
        self._request(SOFTWARE_BIAS)

    def close(self) -> None:
        """Ask the sensor to stop, and free the port."""
        self._request(STOP)
        super().close()

    def _ask_again(self) -> None:
        self.report.outages += 1
        self._arrival_s = monotonic()
        self._last = None
        self._request(self._mode)

    def _request(self, command: int) -> None:
        self._send(REQUEST.pack(REQUEST_MARK, command, 0), self._sensor)

    def _records(self, data: bytes) -> Iterator[Array]:
        """Valid wrenches of a datagram, oldest first."""
        report = self.report
        now_s = monotonic()
        if not data or len(data) % RECORD.itemsize:
            report.malformed += 1
            return
        if now_s - self._arrival_s > LONGEST_COUNTED_s:
            self._last = None  # it may have begun to count anew
            report.longest_gap_s = max(report.longest_gap_s, now_s - self._arrival_s)
        self._arrival_s = now_s
        for record in np.frombuffer(data, RECORD):
            count = int(record["count"])
            status = int(record["status"])
            last = self._last
            is_faulty = status & FAULT_BITS
            ahead = 1 if last is None else (count - last) % COUNTS
            if not 0 < ahead <= MOST_AHEAD:
                follows = 0 < (count - self._odd) % COUNTS <= MOST_AHEAD
                self._odd = count
                self._odd_row = self._odd_row + 1 if follows else 0
                report.stale += 1
                if self._odd_row >= RENUMBERED:
                    self._last = None
                continue
            report.malformed += bool(is_faulty)
            self.status = status
            if last is not None or not is_faulty:  # a faulty first one may be garbage
                self._last = count
                self._odd_row = 0
                report.missed += ahead - 1
            if not is_faulty:
                report.used += 1
                self._newest = record["counts"] / self._divisor
                yield self._newest - self._zero
