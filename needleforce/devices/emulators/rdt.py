"""An emulator of a Net F/T box, which speaks the protocol of `devices.rdt`."""

import threading
import time
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, HTTPServer
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices import rdt
from needleforce.devices.datagram_link import LOOPBACK, Endpoint
from needleforce.devices.emulators.wire import FaultyWire, WireFaults

DEFAULT_SCALE = rdt.Scale(per_N=1e6, per_Nm=1e6)
"""Of the emulated sensor, unless said otherwise."""


@dataclass(frozen=True, kw_only=True)
class RdtSettings:
    """What the emulated sensor does: it sends rows of wrenches over and over.

    Attributes:
        wrench: Force [N] and torque [Nm], shape (m, 6).
        rate_hz: Records per second.
        scale: Counts per N and per Nm.
        records: To a datagram in buffered mode.
        faults: What goes wrong on the wire.
    """

    wrench: Array
    rate_hz: float = 7000.0
    scale: rdt.Scale = DEFAULT_SCALE
    records: int = 40
    faults: WireFaults = field(default_factory=WireFaults)


def emulate_rdt(pipe: Connection, settings: RdtSettings) -> dict[str, Any]:
    """Emulate a Net F/T box with its page; a function for `Emulator`.

    Returns:
        Counts of the records and of the packets sent.
    """
    box = _Box(settings)
    page = _serve_scale(rdt.Scale(*settings.scale))
    pipe.send({"port": box.wire.address.port, "page": page})
    while not pipe.poll():
        box.send_due_records()
        # It listens for requests for a millisecond before it sends what is due.
        for data, sender in box.wire.received(time.monotonic() + 1e-3):
            box.take_request(data, sender)

    return {"records": box.record_count, "sent": box.wire.sent}


class _Box:
    """The box: sends records to whoever has asked for them.

    Attributes:
        wire: The link to the sensor's user.
        record_count: How many records were sent.
    """

    def __init__(self, settings: RdtSettings) -> None:
        self._settings = settings
        self.wire = FaultyWire(settings.faults)
        self.record_count = 0
        counts_per_unit = np.repeat(settings.scale, 3)
        self._rows = np.round(settings.wrench * counts_per_unit).astype(">i4")
        self._records_per_datagram = 1
        self._begin_s = time.monotonic()

    def send_due_records(self) -> None:
        """Send the records whose time has come, if somebody has asked for them."""
        size = self._records_per_datagram
        rate_hz = self._settings.rate_hz
        due_count = (time.monotonic() - self._begin_s) * rate_hz
        while self.wire.peer is not None and self.record_count + size <= due_count:
            numbers = np.arange(self.record_count, self.record_count + size)
            records = np.zeros(size, rdt.RECORD)
            records["count"] = numbers % rdt.COUNTS
            records["ft_count"] = numbers % rdt.COUNTS
            records["counts"] = self._rows[numbers % len(self._rows)]
            self.wire.put(records.tobytes(), self.record_count / rate_hz)
            self.record_count += size

    def take_request(self, data: bytes, sender: Endpoint) -> None:
        """Do what a request asks for; other datagrams are none."""
        if len(data) != rdt.REQUEST.size:
            return

        mark, command, _ = rdt.REQUEST.unpack(data)
        if mark != rdt.REQUEST_MARK:
            return

        if command == rdt.RdtCommand.STOP:
            self.wire.peer = None
        elif self.wire.peer is None:
            is_buffered = command == rdt.RdtCommand.BUFFERED
            self.wire.peer = sender
            self._records_per_datagram = self._settings.records if is_buffered else 1
            sent_s = self.record_count / self._settings.rate_hz
            self._begin_s = time.monotonic() - sent_s


def _serve_scale(scale: rdt.Scale) -> str:
    """Serve the page that says the counts per unit; return its address."""
    text = (
        f"<netft><calcpf>{scale.per_N:g}</calcpf>"
        f"<calcpt>{scale.per_Nm:g}</calcpt></netft>"
    )

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response_only(200)  # `send_response` would log
            self.end_headers()
            self.wfile.write(text.encode())

    server = HTTPServer((LOOPBACK, 0), Page)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://{LOOPBACK}:{server.server_address[1]}/netftcalapi.xml"
