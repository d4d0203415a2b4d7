"""An iiwa through FRI for Sunrise: messages of its controller, and the answers."""

import numpy as np
import pytest

from needleforce.devices import IiwaArm
from needleforce.devices.sunrise_messages import Session, message_type
from tests.needleforce.devices.scripted_arms import Iiwa, iiwa_message

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

ANSWER_HEAD = "0a090881800d100018ac021241"
ANSWER_JOINTS = (
    "0a3f09000000000000f83f09000000000000f43f09000000000000f03f0900000000000"
    "0e83f09000000000000e03f09000000000000d03f090000000000000000"
)
GOLDEN_ANSWER = bytes.fromhex(ANSWER_HEAD + ANSWER_JOINTS)
"""The first answer to either: reflects 300, commands 1.5, 1.25, ..."""


@pytest.fixture
def arm():
    with IiwaArm(port=0) as arm:
        yield arm


@pytest.mark.parametrize("data", [GOLDEN_1, GOLDEN_2])
def test_a_golden_message_is_read_and_answered(data, box, arm):
    arm.session = Session.COMMANDING_WAIT  # of a message before
    box.sendto(data, arm.address)
    reading = next(iter(arm))

    assert box.recv(2048) == GOLDEN_ANSWER

    assert reading.q_rad.tolist() == [0.5, 0.625, 0.75, 0.875, 1.0, 1.125, 1.25]
    assert reading.tau_Nm.tolist() == [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0]
    assert reading.external_Nm.tolist() == [-3.0, -2.5, -2.0, -1.5, -1.0, -0.5, 0.0]
    assert (reading.dq_rad_s, reading.dt_s) == (None, 0.002)
    assert reading.accepts_commands


@pytest.mark.parametrize("version", [1, 2])
def test_while_it_monitors_version_1_has_its_own_position_back(version, box, arm):
    data = (GOLDEN_1, GOLDEN_2)[version - 1]
    message = message_type("Monitoring").FromString(data)
    message.connection.session = Session.MONITORING_READY
    message.connection.answer_cycles = 2
    readings = iter(arm)
    for number in (300, 301):
        message.header.number = number
        box.sendto(message.SerializeToString(), arm.address)
        assert not next(readings).accepts_commands
    answer = message_type("Command").FromString(box.recv(2048))

    assert answer.header.reflected == 301  # only every second one is answered
    told = list(answer.wanted.position_rad.value)
    assert told == ([-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5] if version == 1 else [])


def broken(place, value):
    data = bytearray(GOLDEN_1)
    data[place] = value
    return bytes(data)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        GOLDEN_ANSWER,
        GOLDEN_1[:-20],
        b"\xff" * 20,
        broken(5, 0x90),  # kind
        iiwa_message(session=5),
        iiwa_message(quality=4),
        iiwa_message(period_ms=101),
        iiwa_message(place_rad=[np.nan] * 7),
        iiwa_message(place_rad=[0.0] * 6),
        iiwa_message(program_rad=[0.0] * 8),
    ],
)
def test_what_is_no_message_is_refused(data, box, arm):
    box.sendto(data, arm.address)
    box.sendto(iiwa_message(), arm.address)

    assert next(iter(arm)).dt_s == 0.002
    assert arm.report.malformed == 1


@pytest.fixture
def iiwa():
    arm = Iiwa(place_rad=np.full(7, 0.25))
    yield arm
    arm.close()


def test_a_session_that_is_found_running_begins_where_the_arm_is(iiwa):
    """The place that an earlier program has added to is not given up at once."""
    iiwa.begun_rad = np.zeros(7)
    iiwa.cycle()

    assert iiwa.told_rad.tolist() == [0.25] * 7


def test_after_a_new_session_commands_start_from_rest(iiwa):
    for _ in range(100):
        assert iiwa.cycle(0.3)
    iiwa.begun_rad = iiwa.place_rad
    iiwa.fault = {"session": Session.COMMANDING_WAIT}
    iiwa.is_good = False
    iiwa.cycle()
    iiwa.is_good = True

    assert not any([iiwa.cycle(0.3) for _ in range(50)])
    assert not np.any(iiwa.sent_rad_s[-50:])
    assert all([iiwa.cycle(0.02) for _ in range(50)])


def test_a_period_that_is_not_told_is_found_from_the_stamps(iiwa):
    """The first message only starts the clock: velocities need the true period."""
    iiwa.fault = {"session": Session.COMMANDING_WAIT, "period_ms": 0}
    iiwa.is_good = False
    iiwa.send()
    iiwa.send()

    assert next(iiwa.readings).dt_s == 2e-3

    iiwa.hear()
    iiwa.fault = {"period_ms": 0}
    for _ in range(101):
        iiwa.cycle(0.3)
    assert iiwa.sent_rad_s[-1][0] == pytest.approx(0.3, abs=1e-6)
    assert iiwa.arm.report.malformed == 0
