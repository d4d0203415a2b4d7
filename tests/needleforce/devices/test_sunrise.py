"""An iiwa through FRI for Sunrise: golden messages, and an emulated controller."""

import socket
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

import urdf
from needleforce.cli import main
from needleforce.devices import FriArm, IiwaArm
from needleforce.devices.emulators import (
    Emulator,
    SunriseSettings,
    WireFaults,
    emulate_sunrise,
)
from needleforce.devices.protobuf_wire import read_doubles, read_fields, write_message
from needleforce.devices.sunrise_messages import (
    COMMAND_KIND,
    MONITORING_KIND,
    CommandMode,
    Header,
    Monitoring,
    PositionCommand,
    Quality,
    Session,
    read_command,
    read_monitoring,
    write_command,
    write_monitoring,
)
from tests.needleforce.devices.test_links import PATIENCE_S, measurement

GOLDEN_1 = bytes.fromhex(
    "0a0b08c2a2910110ac0218ab021216080710002802280228022802280228022802300238"
    "001ad2020a3f09000000000000e03f09000000000000e43f09000000000000e83f090000"
    "00000000ec3f09000000000000f03f09000000000000f23f09000000000000f43f123f09"
    "0000000000002440090000000000002640090000000000002840090000000000002a4009"
    "0000000000002c40090000000000002e400900000000000030401a3f09000000000000f0"
    "bf09000000000000e8bf09000000000000e0bf09000000000000d0bf0900000000000000"
    "0009000000000000d03f09000000000000e03f223f090000000000003440090000000000"
    "003540090000000000003640090000000000003740090000000000003840090000000000"
    "003940090000000000003a402a3f0900000000000008c00900000000000004c009000000"
    "00000000c009000000000000f8bf09000000000000f0bf09000000000000e0bf09000000"
    "00000000007a0b0880e2cfaa061080e59a77220808041003180220012a4e0a3f09000000"
    "000000f83f09000000000000f43f09000000000000f03f09000000000000e83f09000000"
    "000000e03f09000000000000d03f0900000000000000005001580161000000000000e83f"
)
"""A message of version 1, with fields that are not used, as an encoder of others gives
it: position 0.5, 0.625, ...; torque 10, 11, ...; commanded -1, -0.75, ...; commanded
torque 20, 21, ...; external torque -3, -2.5, ...; commanding, excellent, every 2 ms;
the program's position 1.5, 1.25, ..."""

GOLDEN_2 = bytes.fromhex(
    "0a0b08c2a2910110ac0218ab021216080710002802280228022802280228022802300238"
    "001ad3020a3f09000000000000e03f09000000000000e43f09000000000000e83f090000"
    "00000000ec3f09000000000000f03f09000000000000f23f09000000000000f43f123f09"
    "0000000000002440090000000000002640090000000000002840090000000000002a4009"
    "0000000000002c40090000000000002e40090000000000003040223f0900000000000034"
    "400900000000000035400900000000000036400900000000000037400900000000000038"
    "40090000000000003940090000000000003a402a3f0900000000000008c0090000000000"
    "0004c00900000000000000c009000000000000f8bf09000000000000f0bf090000000000"
    "00e0bf0900000000000000004a400a04706f736512380000000000005940000000000040"
    "594000000000008059400000000000c059400000000000005a400000000000405a400000"
    "000000805a407a0b0880e2cfaa061080e59a77220808041003180220012a4e0a3f090000"
    "00000000f83f09000000000000f43f09000000000000f03f09000000000000e83f090000"
    "00000000e03f09000000000000d03f0900000000000000005001580161000000000000e8"
    "3f"
)
"""The same of version 2: a Cartesian pose, no commanded position."""

GOLDEN_ANSWER = bytes.fromhex(
    "0a090881800d100018ac0212410a3f09000000000000f83f09000000000000f43f090000"
    "00000000f03f09000000000000e83f09000000000000e03f09000000000000d03f090000"
    "000000000000"
)
"""The first answer to either: reflects 300, commands 1.5, 1.25, ..."""

ROWS = np.linspace(0.0, 0.7, 70).reshape(10, 7)


@pytest.mark.parametrize(
    ("data", "commanded_rad"),
    [(GOLDEN_1, [-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5]), (GOLDEN_2, None)],
)
def test_a_golden_message_is_read_and_answered(data, commanded_rad):
    message = read_monitoring(data)

    assert message.header == (0x245142, 300, 299)
    assert message.stamp_s == 1_700_000_000.25
    if commanded_rad is not None:
        assert message.commanded_rad.tolist() == commanded_rad

    arm = IiwaArm(port=0, wait_s=0.05, give_up_s=1.0)
    with arm, socket.socket(type=socket.SOCK_DGRAM) as box:
        box.settimeout(10.0)
        arm.session = Session.COMMANDING_WAIT  # of a message before
        box.sendto(data, arm.address)
        reading = next(iter(arm))

        assert box.recv(2048) == GOLDEN_ANSWER

    assert reading.q_rad.tolist() == [0.5, 0.625, 0.75, 0.875, 1.0, 1.125, 1.25]
    assert reading.tau_Nm.tolist() == [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]
    assert reading.external_Nm.tolist() == [-3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.0]
    assert reading.dq_rad_s is None
    assert reading.dt_s == 0.002
    assert reading.accepts_commands
    assert arm.version == (2 if commanded_rad is None else 1)
    assert arm.stamp_s == 1_700_000_000.25


def test_doubles_may_be_packed():
    packed = np.arange(7.0).astype("<f8").tobytes()

    assert read_doubles(write_message(1, packed)).tolist() == list(range(7))


def test_what_is_no_message_is_refused():
    rng = np.random.default_rng(0)
    for size in range(len(GOLDEN_1)):
        message = read_monitoring(GOLDEN_1[:size])

        assert message is None or message.position_rad.shape == (7,)

    for _ in range(3000):
        data = bytearray(GOLDEN_1)
        for place in rng.integers(0, len(data), 3):
            data[place] = rng.integers(256)

        message = read_monitoring(bytes(data))

        assert message is None or np.isfinite(message.position_rad).all()
        assert read_command(rng.bytes(int(rng.integers(100)))) is None

    assert read_monitoring(GOLDEN_ANSWER) is None
    assert read_command(GOLDEN_1) is None
    assert read_fields(b"\xff" * 20) is None


def iiwa_run(version, *, drive, faults=None, cycles=500):
    """Readings, arm and counts of an emulated, patient controller."""
    arm = IiwaArm(port=0, wait_s=0.1, give_up_s=1.0)
    settings = SunriseSettings(
        port=arm.address.port,
        q_rad=ROWS,
        tau_Nm=2.0 * ROWS,
        version=version,
        period_s=2e-3,
        cycles=cycles,
        extra_wait_s=PATIENCE_S,
        command_from_s=0.1,
        faults=faults or WireFaults(),
    )
    readings = []
    with arm, Emulator(emulate_sunrise, settings) as emulator:
        for reading in arm:
            readings.append(reading)
            drive(arm, len(readings))

        return readings, arm, emulator.counts()


@pytest.mark.slow
@pytest.mark.parametrize("version", [1, 2])
def test_an_iiwa_is_read_and_driven(version):
    wish_rad_s = np.array([0.2, 0.0, -0.1, 0.0, 0.0, 0.0, 0.3])

    def drive(arm, count):
        assert arm.send(wish_rad_s) == (count > 70)  # 50 cycles monitored, 20 waited
        assert not arm.send([np.inf] * 7)

    readings, arm, counts = iiwa_run(version, drive=drive)

    assert len(readings) == counts["same_cycle"] == 500
    assert arm.version == version
    assert counts["refused"] == 0
    assert np.array_equal(readings[43].tau_Nm, 2.0 * ROWS[3])
    assert np.array_equal(readings[43].external_Nm, 0.2 * ROWS[3])
    assert [reading.accepts_commands for reading in readings] == [
        count > 70 for count in range(1, 501)
    ]
    # All cycles of 2 ms but the first one that takes commands, reached at 4.9 rad/s2.
    lost_rad = 0.5 * wish_rad_s * np.abs(wish_rad_s) / 4.9
    expected_rad = wish_rad_s * 429 * 2e-3 - lost_rad

    assert counts["moved_rad"] == pytest.approx(expected_rad, abs=5e-4)


@pytest.mark.slow
def test_an_iiwa_without_commands_brakes_to_rest():
    places = []

    def drive(arm, count):
        if count < 200:
            arm.send(np.full(7, min(max(count - 70, 0) / 50.0, 1.0) * 0.2))
        places.append(count)

    readings, _, counts = iiwa_run(2, drive=drive, cycles=400)
    moved_rad = [
        reading.q_rad[0] - ROWS[number % 10, 0]
        for number, reading in enumerate(readings)
    ]

    assert np.ptp(moved_rad[-50:]) < 1e-12
    assert moved_rad[-1] > 0.03
    assert counts["refused"] == 0


CYCLE_s = 2e-3


class Conversation:
    """A controller that sends one message after the other, and reads the answers."""

    def __init__(self, arm, box, *, tells_period=True):
        box.settimeout(10.0)
        self._arm = arm
        self._box = box
        self._readings = iter(arm)
        self._period_s = CYCLE_s if tells_period else 0.0
        self._count = 0
        self.places_rad = []  # commanded to the first joint

    def say(self, session=Session.COMMANDING_ACTIVE, place_rad=0.0, **changes):
        """Send a message of an arm that stands there; return its reading."""
        self.send(session, place_rad, **changes)
        reading = next(self._readings)
        answer = read_command(self._box.recv(2048))
        self.places_rad.append(answer.position_rad[0])
        return reading

    def send(self, session, place_rad=0.0, **changes):
        """Send a message, and wait for nothing."""
        self._count += 1
        message = Monitoring(
            header=Header(MONITORING_KIND, self._count, 0),
            session=session,
            quality=Quality.EXCELLENT,
            period_s=self._period_s,
            answer_cycles=1,
            safety_stop=0,
            command_mode=CommandMode.POSITION,
            stamp_s=self._count * CYCLE_s,
            position_rad=np.full(7, place_rad),
            torque_Nm=np.zeros(7),
            external_Nm=np.zeros(7),
            commanded_rad=None,
            interpolated_rad=np.zeros(7),
        )
        data = write_monitoring(message._replace(**changes))
        self._box.sendto(data, self._arm.address)

    def drive(self, cycles, speed_rad_s):
        """Let the arm be driven; return how many commands it took."""
        taken = 0
        for _ in range(cycles):
            self.say()
            taken += self._arm.send([speed_rad_s] + [0.0] * 6)
        return taken


@pytest.fixture
def iiwa():
    arm = IiwaArm(port=0, wait_s=5.0, give_up_s=10.0)
    with arm, socket.socket(type=socket.SOCK_DGRAM) as box:
        yield arm, box


def highest_rates(places_rad):
    """Return the highest speed [rad/s] and acceleration [rad/s2] commanded."""
    speeds_rad_s = np.diff(places_rad) / CYCLE_s
    return np.abs(speeds_rad_s).max(), np.abs(np.diff(speeds_rad_s)).max() / CYCLE_s


@pytest.mark.parametrize(
    "interruption",
    [
        {"quality": Quality.FAIR},
        {"safety_stop": 1},
        {"command_mode": CommandMode.NONE},
    ],
)
def test_an_interruption_moves_nothing_and_is_resumed_from_rest(iiwa, interruption):
    """The arm brakes from 0.3 rad/s at 5 rad/s2 and keeps its place, and a program
    that has seen nothing does not drive it."""
    arm, box = iiwa
    controller = Conversation(arm, box)
    for _ in range(30):
        controller.say(Session.COMMANDING_WAIT)
    for k in range(300):
        controller.drive(1, min(k / 100.0, 1.0) * 0.3)
    start_rad = controller.places_rad[-1]
    controller.places_rad = controller.places_rad[-3:]

    assert start_rad > 0.1
    assert not controller.say(**interruption).accepts_commands
    assert not arm.send([0.3] + [0.0] * 6)
    assert controller.drive(200, 0.3) == 0

    speed_rad_s, acceleration_rad_s2 = highest_rates(controller.places_rad)

    assert speed_rad_s <= 0.3 + 1e-9
    assert acceleration_rad_s2 <= 5.0 + 1e-6
    assert start_rad <= controller.places_rad[-1] <= start_rad + 0.012
    assert np.ptp(controller.places_rad[-100:]) == 0.0

    rest_rad = controller.places_rad[-1]
    controller.places_rad = []
    taken = sum(controller.drive(1, min(k / 100.0, 1.0) * 0.3) for k in range(200))

    assert taken == 200
    assert controller.places_rad[0] == rest_rad
    assert controller.places_rad[-1] == pytest.approx(rest_rad + 0.0894, abs=1e-3)


def test_an_interruption_at_rest_moves_nothing(iiwa):
    arm, box = iiwa
    controller = Conversation(arm, box)
    controller.say(Session.COMMANDING_WAIT)
    controller.drive(100, 0.2)
    controller.drive(50, 0.0)
    place_rad = controller.places_rad[-1]
    for interruption in ({"quality": Quality.POOR}, {"safety_stop": 2}):
        controller.say(**interruption)
        controller.drive(20, 0.0)

    assert place_rad == pytest.approx(0.04, abs=1e-3)
    assert controller.places_rad[-42:] == [place_rad] * 42


def test_a_session_that_is_found_running_begins_where_the_arm_is(iiwa):
    """The place that an earlier program has added to is not given up at once."""
    arm, box = iiwa
    controller = Conversation(arm, box)
    for _ in range(5):
        controller.say(place_rad=0.25)

    assert controller.places_rad == [0.25] * 5


def test_after_a_new_session_commands_start_from_rest(iiwa):
    arm, box = iiwa
    controller = Conversation(arm, box)
    controller.say(Session.COMMANDING_WAIT)
    controller.drive(100, 0.3)
    controller.say(Session.COMMANDING_WAIT)

    assert controller.drive(50, 0.3) == 0
    assert controller.places_rad[-50:] == [0.0] * 50
    assert controller.drive(50, 0.02) == 50


def test_a_period_that_is_not_told_is_found_from_the_stamps(iiwa):
    """The first message only starts the clock: velocities need the true period."""
    arm, box = iiwa
    controller = Conversation(arm, box, tells_period=False)
    controller.send(Session.COMMANDING_WAIT)

    assert controller.say(Session.COMMANDING_WAIT).dt_s == 2e-3

    controller.drive(101, 0.3)

    last_rad = controller.places_rad[-1] - controller.places_rad[-2]

    assert last_rad == pytest.approx(0.3 * 2e-3, abs=1e-9)
    assert arm.report.malformed == 0


@pytest.mark.slow
def test_lost_and_garbled_messages_are_counted():
    faults = WireFaults(lost=0.02, truncated=0.02, repeated=0.05, garbage=0.05)
    readings, arm, _ = iiwa_run(1, drive=lambda *_: None, faults=faults, cycles=600)
    report = arm.report

    assert report.used == len(readings)
    assert sum(reading.missed for reading in readings) == report.missed > 5
    assert report.malformed > 10
    assert report.stale > 5


@pytest.mark.parametrize(
    ("kind", "stranger", "words"),
    [
        ("iiwa", measurement(), "speaks FRI 1.0, of an LWR 4+: name it fri"),
        ("fri", GOLDEN_2, "speaks FRI for Sunrise, of an LBR iiwa: name it iiwa"),
        ("fri", measurement(kind=0x3007), "speaks version 0x3007 of FRI, expected 0x2"),
        (
            "iiwa",
            GOLDEN_2.replace(b"\xc2\xa2\x91\x01", b"\xc3\xa2\x91\x01"),
            "speaks kind 0x245143 of FRI for Sunrise, expected 0x245142",
        ),
    ],
)
def test_a_controller_of_another_kind_is_named(kind, stranger, words):
    arm_type = {"iiwa": IiwaArm, "fri": FriArm}[kind]
    arm = arm_type(port=0, wait_s=0.05, give_up_s=0.2)
    with arm, socket.socket(type=socket.SOCK_DGRAM) as box:
        box.sendto(stranger, arm.address)

        assert list(islice(arm, 1)) == []

    assert words in arm.hint


@pytest.mark.slow
def test_the_command_line_records_an_iiwa(tmp_path, capsys):
    path = tmp_path / "iiwa.csv"
    with IiwaArm(port=0) as arm:
        port = arm.address.port

    model = Path(urdf.__file__).parent / "data" / "lwr4plus.urdf"  # seven joints
    settings = SunriseSettings(port=port, q_rad=ROWS, tau_Nm=ROWS)
    options = [f"iiwa:{port}", "-o", str(path), "--seconds", "0.2"]
    with Emulator(emulate_sunrise, settings):
        assert main(["record", *options, "--urdf", str(model)]) == 0

    assert path.exists()
    assert main(["record", *options, "--overwrite"]) == 2
    assert "does not say what arm it is, expected --urdf" in capsys.readouterr().err


def test_messages_agree_with_the_vendors_protobuf():
    """Tags as in the public FRI sources of lbr-stack; enumerations as numbers."""
    descriptor = pytest.importorskip("google.protobuf.descriptor_pb2")
    pools = pytest.importorskip("google.protobuf.descriptor_pool")
    factory = pytest.importorskip("google.protobuf.message_factory")
    field = descriptor.FieldDescriptorProto
    file = descriptor.FileDescriptorProto(
        name="fri.proto", package="fri", syntax="proto2"
    )
    kinds = {"double": field.TYPE_DOUBLE, "uint32": field.TYPE_UINT32}
    layout = {
        "Joints": [(1, "value", "double")],
        "Time": [(1, "sec", "uint32"), (2, "nanosec", "uint32")],
        "Header": [(1, "kind", "uint32"), (2, "seq", "uint32"), (3, "seen", "uint32")],
        "Connection": [
            (1, "session", "uint32"),
            (2, "quality", "uint32"),
            (3, "period_ms", "uint32"),
            (4, "answer_cycles", "uint32"),
        ],
        "Robot": [(1, "joints", "uint32"), (2, "safety_stop", "uint32")],
        "Measured": [
            (1, "position", "Joints"),
            (2, "torque", "Joints"),
            (4, "commanded_torque", "Joints"),
            (5, "external", "Joints"),
            (15, "time", "Time"),
        ],
        "Program": [(1, "position", "Joints"), (10, "mode", "uint32")],
        "Monitoring": [
            (1, "header", "Header"),
            (2, "robot", "Robot"),
            (3, "measured", "Measured"),
            (4, "connection", "Connection"),
            (5, "program", "Program"),
        ],
        "Wanted": [(1, "position", "Joints")],
        "Command": [(1, "header", "Header"), (2, "wanted", "Wanted")],
    }
    for name, fields in layout.items():
        message = file.message_type.add(name=name)
        for number, field_name, kind in fields:
            is_list = kind == "double"
            label = field.LABEL_REPEATED if is_list else field.LABEL_OPTIONAL
            entry = message.field.add(name=field_name, number=number, label=label)
            entry.type = kinds.get(kind, field.TYPE_MESSAGE)
            if kind not in kinds:
                entry.type_name = f".fri.{kind}"
    pool = pools.DescriptorPool()
    pool.Add(file)
    written, command = (
        factory.GetMessageClass(pool.FindMessageTypeByName(f"fri.{name}"))
        for name in ("Monitoring", "Command")
    )

    for golden in (GOLDEN_1, GOLDEN_2):
        theirs = written.FromString(golden)
        ours = read_monitoring(golden)

        assert theirs.header.kind == ours.header.kind == 0x245142
        assert list(theirs.measured.torque.value) == ours.torque_Nm.tolist()
        assert theirs.connection.session == ours.session
        assert theirs.program.mode == ours.command_mode
        assert len(theirs.SerializeToString()) == len(golden)

    rng = np.random.default_rng(1000)
    for _ in range(300):
        rows = rng.normal(size=(4, 7))
        message = written()
        message.header.kind = 0x245142
        message.header.seq, message.header.seen = map(int, rng.integers(2**32, size=2))
        message.robot.joints = 7
        message.robot.safety_stop = int(rng.integers(3))
        message.measured.position.value.extend(rows[0])
        message.measured.torque.value.extend(rows[1])
        message.measured.external.value.extend(rows[2])
        message.measured.time.sec = 1_700_000_000
        message.measured.time.nanosec = int(rng.integers(1_000_000_000))
        message.connection.session = 4
        message.connection.quality = 3
        message.connection.period_ms = int(rng.integers(1, 10))
        message.program.position.value.extend(rows[3])
        message.program.mode = 1
        ours = read_monitoring(message.SerializeToString())

        assert ours.header.number == message.header.seq
        assert ours.position_rad.tolist() == rows[0].tolist()
        assert ours.torque_Nm.tolist() == rows[1].tolist()
        assert ours.external_Nm.tolist() == rows[2].tolist()
        assert ours.interpolated_rad.tolist() == rows[3].tolist()
        assert ours.safety_stop == message.robot.safety_stop
        assert ours.period_s == pytest.approx(1e-3 * message.connection.period_ms)

        data = write_command(PositionCommand(Header(COMMAND_KIND, 5, 7), rows[0]))
        answer = command.FromString(data)

        assert (answer.header.seq, answer.header.seen) == (5, 7)
        assert list(answer.wanted.position.value) == rows[0].tolist()
