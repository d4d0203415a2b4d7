"""An ATI Net F/T: records byte for byte, and an emulated box."""

import socket
import struct
import time
from contextlib import closing

import numpy as np
import pytest

from needleforce.devices import (
    DeviceSettingError,
    LinkError,
    NetFT,
    Scale,
    describe_status,
)

PATIENCE_S = 20.0

GOLDEN_RECORD = bytes.fromhex(
    "00000007"  # count of the stream
    "0001e240"  # count of the sensor
    "00000000"  # status
    "000f4240"  # Fx: 1,000,000 counts
    "ffe17b80"  # Fy: -2,000,000
    "002dc6c0"  # Fz: 3,000,000
    "00000fa0"  # Tx: 4,000
    "ffffec78"  # Ty: -5,000
    "00001770"  # Tz: 6,000
)


def record(count, status=0):
    return struct.pack(">3I", count, count, status) + GOLDEN_RECORD[12:]


class Box:
    """A sensor at the other end of a `NetFT`, which has been asked for records."""

    def __init__(self, scale=(1e6, 1e3)):
        self.socket = socket.socket(type=socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(10.0)
        port = self.socket.getsockname()[1]
        self.link = NetFT(port=port, scale=scale)
        self.request, self.asked_from = self.socket.recvfrom(64)

    def send(self, data):
        self.socket.sendto(data, self.asked_from)

    def read(self):
        """What the link reads once nothing more waits."""
        newest = None
        for _ in range(5):
            time.sleep(0.01)
            wrench = self.link.read()
            newest = newest if wrench is None else wrench
        return newest

    def close(self):
        self.link.close()
        self.socket.close()


@pytest.fixture
def box():
    with closing(Box()) as box:
        yield box


def test_a_record_is_asked_for_and_read_byte_for_byte(box):
    assert box.request.hex() == "1234000200000000"

    box.send(GOLDEN_RECORD)
    assert box.read().tolist() == [1.0, -2.0, 3.0, 4.0, -5.0, 6.0]

    box.link.close()
    assert box.socket.recv(64).hex() == "1234000000000000"
    assert box.link.read() is None


@pytest.mark.parametrize("status", [*(1 << bit for bit in range(17, 32)), 0x80000020])
def test_a_record_of_a_faulty_sensor_is_not_used(box, status):
    box.send(GOLDEN_RECORD)
    box.send(record(8, status))
    box.send(record(9))

    assert box.read() is not None
    report = box.link.report
    assert (report.used, report.malformed, report.missed) == (2, 1, 0)
    assert box.link.faults == status


@pytest.mark.parametrize("status", [0x00010000, 0x80010000, 0x00000020])
def test_a_latched_threshold_leaves_forces_valid(box, status):
    box.send(record(7, status))

    assert box.read() is not None
    assert (box.link.status, box.link.faults) == (status, 0)


@pytest.mark.parametrize(
    ("status", "word"),
    [(0x80020000, "saturated"), (0x80000004, "temperature"), (0, "well")],
)
def test_a_status_word_is_put_in_words(status, word):
    assert word in describe_status(status)
    assert f"0x{status:08x}: " in describe_status(status)


def test_lost_repeated_late_and_malformed_records_are_counted(box):
    for count in (0, 1, 1, 4, 3, 5, 20_000):
        box.send(record(count))
    for data in (b"", GOLDEN_RECORD[:-1], GOLDEN_RECORD * 41, GOLDEN_RECORD * 1800):
        box.send(data)
    assert box.read() is not None
    report = box.link.report

    assert (report.used, report.missed) == (4, 2)
    assert (report.stale, report.malformed) == (3, 4)


def test_silence_is_counted_and_the_sensor_asked_anew(box):
    silences_s = []
    box.send(record(5_000_000))
    assert box.read() is not None
    assert box.link.silent_s == 0.0
    box.link.on_silence = silences_s.append
    while not silences_s or silences_s[-1] < 1.2:
        assert box.link.read() is None
        time.sleep(0.01)
    assert 0.1 <= silences_s[0] < 0.1 + PATIENCE_S
    box.socket.settimeout(0.5)
    assert box.socket.recv(64) == box.request
    box.send(record(0))  # it was off
    assert box.read() is not None
    assert box.link.report.outages == 1
    assert 1.0 < box.link.report.longest_gap_s < 1.0 + PATIENCE_S


def test_foreign_datagrams_never_reach_a_force_sensor(box):
    with socket.socket(type=socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.9", 0))
        for _ in range(50):
            stranger.sendto(GOLDEN_RECORD, box.asked_from)
        assert box.read() is None
        assert box.link.report.used == 0


COUNTS = "<calcpf>1000</calcpf><calcpt>2000</calcpt>"


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (f"<scalfu>N</scalfu><scaltu>N-m</scaltu>{COUNTS}", None),
        (COUNTS, None),
        (f"<scalfu></scalfu>{COUNTS}", "scalfu"),
        (f"<scalfu>lbf</scalfu>{COUNTS}", "lbf"),
        (f"<scalfu>N</scalfu><scaltu>N-mm</scaltu>{COUNTS}", "N-mm"),
        ("<ft>", "counts"),
        ("", "counts"),
        ("<calcpf>many</calcpf>", "counts"),
    ],
)
def test_a_page_without_counts_or_of_other_units_is_refused(content, word, tmp_path):
    page = tmp_path / "netftapi2.xml"
    page.write_text(f"<ft>{content}</ft>")
    if word is None:
        with closing(Box(page.as_uri())) as box:
            box.send(GOLDEN_RECORD)
            assert box.read().tolist() == [1000.0, -2000.0, 3000.0, 2.0, -2.5, 3.0]
    else:
        with pytest.raises(LinkError, match=word):
            NetFT(scale=page.as_uri())


@pytest.mark.parametrize(
    ("settings", "error", "word"),
    [
        ({"scale": "http://127.0.0.1:9/none.xml"}, LinkError, "none.xml"),
        ({"host": "no-such-host.invalid"}, LinkError, "no-such-host"),
        ({"scale": Scale(0.0, 1.0)}, DeviceSettingError, "positive"),
        ({"scale": (1,)}, DeviceSettingError, "positive"),
        ({"scale": (1, np.inf)}, DeviceSettingError, "positive"),
        ({"port": 0, "scale": Scale(1.0, 1.0)}, DeviceSettingError, "port 0"),
        ({"port": 70000, "scale": Scale(1.0, 1.0)}, DeviceSettingError, "70000"),
    ],
)
def test_a_sensor_that_cannot_be_is_refused(settings, error, word):
    with pytest.raises(error, match=word):
        NetFT(**settings)
