"""ATI Net F/T: force and torque through its raw data transfer (RDT).

One request begins the stream; records of 36 bytes come back, one to a datagram.
Numbers are big endian; counts per newton are set in the sensor and
read from it, never assumed. Bits of the status word as the manual of the sensor (Net
F/T, system status code) and public drivers give them.
"""

import struct
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


RECORD = np.dtype(
    [("count", ">u4"), ("ft_count", ">u4"), ("status", ">u4"), ("counts", ">i4", 6)]
)
"""What the sensor sends."""

COUNTS = 1 << 32
"""Counters of records go round after so many."""

BIT_NAMES = {
    31: "error",
    30: "CPU or RAM error",
    29: "digital board error",
    28: "analog board error",
    27: "serial link error",
    26: "program memory error",
    25: "halted by its configuration",
    24: "settings invalid",
    23: "configuration does not fit the calibration",
    22: "network failure",
    21: "CAN error",
    20: "RDT error",
    19: "EtherNet/IP failure",
    18: "DeviceNet failure",
    17: "transducer saturated or converter error",
    16: "threshold latched",
    14: "watchdog timeout",
    13: "stack error",
    12: "EEPROM failure",
    11: "flash failure",
    10: "analog board watchdog timeout",
    9: "strain gauge current too high",
    8: "strain gauge current too low",
    7: "analog ground out of range",
    6: "analog supply too high",
    5: "analog supply too low",
    4: "serial link without data",
    3: "reference voltage or supply error",
    2: "temperature out of range",
    1: "HTTP failure",
}
"""What each bit of the status word means."""


def is_faulty(status: int) -> bool:
    """Return whether a record with this status word has no valid force.

    Bits below 17 come with bit 31, and so does with some firmware the latched
    threshold, which leaves the forces valid.
    """
    fault_bits = 0xFFFE0000
    error_and_latched_threshold = 1 << 31 | 1 << 16
    return bool(status & fault_bits) and status != error_and_latched_threshold


def describe_status(status: int) -> str:
    """Return a status word in words, such as ``0x80020000: error, ...``."""
    names = [
        BIT_NAMES.get(bit, f"bit {bit}")
        for bit in reversed(range(32))
        if status >> bit & 1
    ]
    return f"0x{status:08x}: {', '.join(names) or 'well'}"


class Scale(NamedTuple):
    """How many counts the sensor gives.

    Attributes:
        per_N: For a newton.
        per_Nm: For a newton metre.
    """

    per_N: float
    per_Nm: float


def read_scale(url: str) -> Scale:
    """Read the counts from the sensor's page of its calibration.

    Args:
        url: Address of the page.

    Raises:
        LinkError: The page cannot be read, names no counts, or counts per another unit
            than SI.
    """
    max_wait_s = 2.0
    max_reply_bytes = 1 << 20
    try:
        with urlopen(url, timeout=max_wait_s) as reply:
            tree = ElementTree.fromstring(reply.read(max_reply_bytes))
        per_N = float(tree.findtext(".//calcpf", ""))
        per_Nm = float(tree.findtext(".//calcpt", ""))
    except (OSError, HTTPException, ElementTree.ParseError, ValueError) as error:
        raise LinkError(f"no counts per newton from {url}: {error}") from error

    for name, si_unit in (("scalfu", "N"), ("scaltu", "Nm")):
        unit = tree.findtext(f".//{name}", si_unit).strip()
        if unit.replace("-", "") != si_unit:
            raise LinkError(
                f"{url} counts per {unit!r} under <{name}>, expected {si_unit}",
                "Set the sensor to N and Nm, or give its `scale`.",
            )
    return Scale(per_N, per_Nm)


class NetFT(DatagramLink):
    """The sensor, of which the newest reading is taken.

    Args:
        host: Address of the sensor, or its name.
        port: Its port.
        scale: Its counts, or the page that says them; None: the sensor's own page.

    Attributes:
        scale: Counts per newton and per newton metre.
        status: Word of the latest record; 0 when all is well, see `describe_status`.
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

        local = LOOPBACK if host.startswith("127.") else "0.0.0.0"
        super().__init__(local, 0, peer=host)
        self.peer = Endpoint(host, port)
        self.status = 0
        self.faults = 0
        self._counts_per_unit = np.repeat(self.scale, 3)
        self._latest_count: int | None = None
        self._request(RdtCommand.STREAM)

    def read(self) -> Array | None:
        """Return the newest wrench of all that have come.

        It takes 2 ms at most, also when more waits to be read. Malformed and
        old records are counted in the report; see `silent_s` for how long none came.
        After 1 s of silence the sensor is asked anew: it may have been off.

        Returns:
            Force [N] and torque [Nm], shape (6,); None if nothing has come.
        """
        # After so long no further datagram is taken.
        max_read_s = 1.5e-3
        newest = None
        end_s = monotonic() + max_read_s
        while self._is_open and (data := self._receive(0.0)) is not None:
            wrench = self._process(data)
            newest = newest if wrench is None else wrench
            if monotonic() >= end_s:
                break

        if newest is None:
            silent_s = self._count_silence()
            retry_s = 1.0
            if min(silent_s, monotonic() - self._asked_s) > retry_s:
                self._request(RdtCommand.STREAM)
        return newest

    def close(self) -> None:
        """Ask the sensor to stop, and free the port."""
        self._request(RdtCommand.STOP)
        super().close()

    def _request(self, command: RdtCommand) -> None:
        """Send a command to the sensor."""
        self._asked_s = monotonic()
        self._send(REQUEST.pack(REQUEST_MARK, command, 0))

    def _process(self, data: bytes) -> Array | None:
        """Return the wrench of a record, shape (6,); None if it is old or invalid.

        After a silence the sensor may have begun to count anew.
        """
        if len(data) != RECORD.itemsize:
            self.report.malformed += 1
            return None

        [record] = np.frombuffer(data, RECORD)
        # Records of a second or so; one further on, or further back, is no new one.
        max_ahead = 10_000
        count = int(record["count"])
        ahead = 1
        if self._latest_count is not None:
            ahead = (count - self._latest_count) % COUNTS
        if ahead > max_ahead and self._is_silent:
            ahead = 1
        if not 0 < ahead <= max_ahead:
            self.report.stale += 1
            return None

        self._latest_count = count
        self.report.missed += ahead - 1
        self.status = int(record["status"])
        if is_faulty(self.status):
            self.report.malformed += 1
            self.faults |= self.status
            return None

        self.report.used += 1
        self._hear()
        return record["counts"] / self._counts_per_unit
