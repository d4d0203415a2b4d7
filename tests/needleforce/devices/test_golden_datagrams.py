"""Datagrams as devices send them, byte for byte, at the offsets of their manuals."""

import socket
import struct
import threading
import time

import pytest

from needleforce.devices import FriArm, NetFT, Scale
from needleforce.devices.rdt_status import BIT_NAMES, describe_status


def f32(*values):
    return struct.pack(f"<{len(values)}f", *values)


GOLDEN_POSITION = (0.5, -0.25, 0.125, -1.5, 0.75, 1.0, -2.0)
GOLDEN_COMMANDED = (1.5, 1.25, 1.125, 1.0, 0.875, 0.75, 0.625)
GOLDEN_ADDED = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75)
GOLDEN_TORQUE = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0)
GOLDEN_EXTERNAL = (-1.0, -2.0, -3.0, -4.0, -5.0, -6.0, -7.0)


def golden_measurement(count=0x1234, state=1):
    """A measurement of FRI 1.0: its bytes at their offsets, by the published layout."""
    data = bytearray(916)
    data[0:8] = bytes([count & 255, count >> 8, 0x78, 0x56, 0x94, 0x03, 0x06, 0x20])
    data[140:144] = f32(12.5)  # time stamp [s]
    data[144:148] = bytes([state, 0, 3, 0])  # mode, quality 3: perfect
    data[148:152] = f32(0.002)  # period of the measurements [s]
    data[152:156] = f32(0.003)  # of the commands
    data[216:244] = f32(*GOLDEN_POSITION)
    data[244:292] = f32(*range(100, 112))  # Cartesian position
    data[292:320] = f32(*GOLDEN_COMMANDED)
    data[320:348] = f32(*GOLDEN_ADDED)
    data[348:444] = f32(*range(200, 224))  # Cartesian commands
    data[444:472] = f32(*GOLDEN_TORQUE)
    data[472:500] = f32(*GOLDEN_EXTERNAL)
    data[500:524] = f32(*range(300, 306))  # force at the tool
    data[888:916] = f32(*range(400, 407))  # gravity
    return bytes(data)


def test_a_golden_measurement_of_fri_is_read_and_answered():
    arm = FriArm(port=0, wait_s=0.05, give_up_s=1.0)
    with arm, socket.socket(type=socket.SOCK_DGRAM) as box:
        box.settimeout(10.0)
        box.sendto(golden_measurement(), arm.address)
        reading = next(iter(arm))
        answer = box.recv(2048)

    assert reading.q_rad.tolist() == list(GOLDEN_POSITION)
    assert reading.tau_Nm.tolist() == list(GOLDEN_TORQUE)
    assert reading.external_Nm.tolist() == list(GOLDEN_EXTERNAL)
    assert reading.dq_rad_s is None
    assert reading.dt_s == 0.002
    assert not reading.accepts_commands

    # The answer mirrors the commanded position plus what the interface has added.
    mirrored = [1.75, 1.75, 1.875, 2.0, 2.125, 2.25, 2.375]

    assert len(answer) == 376
    # Count 1, reflected 0x1234, 376 bytes, command of version 1.0.
    assert answer[0:8] == bytes([1, 0, 0x34, 0x12, 0x78, 0x01, 0x05, 0x10])
    assert answer[140:144] == bytes([1, 0, 0, 0])  # joint positions are commanded
    assert list(struct.unpack_from("<7f", answer, 144)) == mirrored
    assert answer[172:] == bytes(376 - 172)


class Box:
    """A sensor at the other end of a `NetFT`, which has been asked for records."""

    def __init__(self, sensor):
        self.socket = socket.socket(type=socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(10.0)
        self.link = sensor(self.socket.getsockname()[1])
        self.request, self.asked_from = self.socket.recvfrom(64)

    def send(self, data):
        self.socket.sendto(data, self.asked_from)

    def read(self):
        """What the link reads once nothing more waits."""
        newest = None
        for _ in range(3):
            time.sleep(0.02)
            wrench = self.link.read()
            newest = newest if wrench is None else wrench

        return newest

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.link.close()
        self.socket.close()


def net_ft(port):
    return NetFT(port=port, scale=Scale(per_N=1e6, per_Nm=1e3))


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


def with_status(count, status):
    return struct.pack(">3I", count, count, status) + GOLDEN_RECORD[12:]


@pytest.mark.parametrize(
    ("buffered", "request_hex"),
    [(False, "1234000200000000"), (True, "1234000300000000")],
)
def test_a_golden_record_of_net_ft_is_asked_for_and_read(buffered, request_hex):
    def sensor(port):
        return NetFT(port=port, scale=Scale(1e6, 1e3), buffered=buffered)

    with Box(sensor) as box:
        assert box.request == bytes.fromhex(request_hex)

        box.send(GOLDEN_RECORD)

        assert box.read().tolist() == [1.0, -2.0, 3.0, 4.0, -5.0, 6.0]

        box.link.bias_sensor()

        assert box.socket.recv(64) == bytes.fromhex("1234004200000000")

        box.link.close()

        assert box.socket.recv(64) == bytes.fromhex("1234000000000000")


@pytest.mark.parametrize("bit", range(17, 32))
def test_a_record_of_a_faulty_sensor_is_not_used(bit):
    with Box(net_ft) as box:
        box.send(GOLDEN_RECORD)
        box.send(with_status(8, 1 << bit))

        assert box.read() is not None
        assert (box.link.report.used, box.link.report.malformed) == (1, 1)
        assert box.link.faults == 1 << bit


@pytest.mark.parametrize("status", [0x00010000, 0x80010000])
def test_a_latched_threshold_leaves_forces_valid(status):
    with Box(net_ft) as box:
        box.send(with_status(7, status))

        assert box.read() is not None
        assert box.link.status == status
        assert box.link.faults == 0


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (0x80020000, "transducer saturated"),
        (0x80000020, "supply too low"),
        (0x88000000, "serial link"),
        (0x80000004, "temperature"),
    ],
)
def test_a_status_word_is_put_in_words(status, words):
    assert words in describe_status(status)
    assert f"0x{status:08x}: error, " in describe_status(status)


def test_every_known_bit_has_its_own_words():
    assert len(set(BIT_NAMES.values())) == len(BIT_NAMES)
    assert "well" in describe_status(0)


def test_foreign_datagrams_never_reach_a_force_sensor():
    """A network that floods the link with datagrams of another host."""
    with Box(net_ft) as box:
        is_over = threading.Event()

        def flood():
            with socket.socket(type=socket.SOCK_DGRAM) as stranger:
                stranger.bind(("127.0.0.9", 0))
                while not is_over.is_set():
                    stranger.sendto(GOLDEN_RECORD, box.asked_from)

        flooding = [threading.Thread(target=flood, daemon=True) for _ in range(2)]
        for thread in flooding:
            thread.start()

        wrench = None
        deadline_s = time.monotonic() + 10.0
        while wrench is None and time.monotonic() < deadline_s:
            box.send(GOLDEN_RECORD)
            wrench = box.link.read()

        is_over.set()
        for thread in flooding:
            thread.join()

        assert wrench is not None
        assert box.link.report.foreign == 0


def test_datagrams_that_are_too_long_take_no_time():
    """A flood under the sensor's own address; the processor's time is judged, as other
    programs run beside this one."""
    with Box(net_ft) as box:
        for _ in range(40):
            box.send(GOLDEN_RECORD * 1800)

        time.sleep(0.05)
        took_s = []
        for _ in range(5):
            begin_s = time.thread_time()
            assert box.link.read() is None
            took_s.append(time.thread_time() - begin_s)

        assert min(took_s) < 2e-3
        assert max(took_s) < 5e-3
        assert box.link.report.malformed > 0
