"""An LWR over UDP: against an emulated controller, and datagram by datagram."""

import socket
import struct
import time
from itertools import islice

import numpy as np
import pytest

from needleforce.devices import (
    DeviceSettingError,
    Emulator,
    FriArm,
    FriSettings,
    LinkError,
    ReplayArm,
    emulate_fri,
    pace,
)
from tests.needleforce.devices.scripted_arms import lwr_measurement

ROWS = np.linspace(0.0, 1.0, 700).reshape(100, 7).astype(np.float32).astype(float)
PATIENCE_S = 20.0
"""On a busy machine things take longer; nothing here is a measurement of speed."""

POSITION = (0.5, -0.25, 0.125, -1.5, 0.75, 1.0, -2.0)
COMMANDED = (1.5, 1.25, 1.125, 1.0, 0.875, 0.75, 0.625)
ADDED = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75)
TORQUE = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0)
EXTERNAL = (-1.0, -2.0, -3.0, -4.0, -5.0, -6.0, -7.0)


@pytest.fixture
def arm():
    with FriArm(port=0) as arm:
        yield arm


def controller(arm, cycles, **settings):
    """A patient emulated controller of so many cycles."""
    return Emulator(
        emulate_fri,
        FriSettings(
            port=arm.address.port,
            q_rad=ROWS,
            tau_Nm=2.0 * ROWS,
            cycles=cycles,
            extra_wait_s=PATIENCE_S,
            **settings,
        ),
    )


def taken(arm, readings):
    """The readings until the arm is lost."""
    with pytest.raises(LinkError):
        readings.extend(arm)
    return readings


def test_a_measurement_is_read_and_answered_byte_for_byte(box, arm):
    signals = {216: POSITION, 292: COMMANDED, 320: ADDED, 444: TORQUE, 472: EXTERNAL}
    box.sendto(lwr_measurement(0x1234, joints=signals), arm.address)
    reading = next(iter(arm))
    answer = box.recv(2048)

    assert reading.q_rad.tolist() == list(POSITION)
    assert reading.tau_Nm.tolist() == list(TORQUE)
    assert reading.external_Nm.tolist() == list(EXTERNAL)
    assert (reading.dq_rad_s, reading.dt_s) == (None, 0.002)
    assert not reading.accepts_commands
    assert len(answer) == 376
    # Count 1, reflected 0x1234, 376 bytes, command of version 1.0.
    assert answer[0:8] == bytes([1, 0, 0x34, 0x12, 0x78, 0x01, 0x05, 0x10])
    assert answer[140:144] == bytes([1, 0, 0, 0])  # joint positions are commanded
    mirrored = np.add(COMMANDED, ADDED).tolist()
    assert list(struct.unpack_from("<7f", answer, 144)) == mirrored
    assert not any(answer[172:])


@pytest.mark.slow
def test_every_cycle_is_answered_and_a_lost_arm_comes_back_with_the_true_gap():
    with FriArm(port=0, give_up_s=0.4) as arm:
        with controller(arm, 500) as emulator:
            readings = taken(arm, [])
            counts = emulator.counts()
        lost_s = time.monotonic()

        assert len(readings) == 500 == arm.report.used == counts["same_cycle"]
        assert [reading.dt_s for reading in readings[:3]] == [1e-3] * 3
        assert np.array_equal(readings[42].q_rad, ROWS[42])
        assert np.array_equal(readings[42].tau_Nm, 2.0 * ROWS[42])
        assert 0.4 <= arm.report.longest_gap_s < 0.4 + PATIENCE_S
        with pytest.raises(LinkError, match="silent"):
            next(iter(arm))  # nobody there yet
        # It counts anew, from another port.
        with controller(arm, None):
            back = list(islice(arm, 3))
        passed_s = time.monotonic() - lost_s

    assert 0.4 <= back[0].dt_s <= passed_s + 0.5
    assert [reading.dt_s for reading in back[1:]] == [1e-3] * 2


@pytest.mark.slow
def test_a_silence_is_reported_while_it_lasts_and_is_in_the_next_reading():
    silences_s = []
    with FriArm(port=0, give_up_s=4.0) as arm:
        arm.on_silence = silences_s.append
        with controller(arm, 2500, silent_s=(0.3, 2.0)):
            readings = list(islice(arm, 700))
    gap = max(readings, key=lambda reading: reading.dt_s)

    assert np.median(np.diff(silences_s)) == pytest.approx(0.1, abs=0.05)
    assert 0.1 <= min(silences_s) < 0.2
    assert max(silences_s) > 1.4
    assert 1.69 < gap.dt_s < 3.9  # longer only on a busy machine
    assert gap.missed == round(gap.dt_s / 1e-3) - 1
    assert arm.report.missed == sum(reading.missed for reading in readings)
    assert 1 <= arm.report.outages < 5
    assert arm.report.longest_gap_s == gap.dt_s


@pytest.mark.parametrize(
    ("state", "quality", "error", "accepts"),
    [
        (2, 2, 0, True),
        (2, 3, 0, True),
        (2, 1, 0, False),
        (2, 3, 9, False),
        (1, 3, 0, 0),
    ],
)
def test_an_error_or_a_bad_connection_refuses_commands(
    state, quality, error, accepts, box, arm
):
    readings = iter(arm)
    for count in (1, 2):
        data = bytearray(lwr_measurement(count, state, quality))
        struct.pack_into("<H", data, 184, error)
        box.sendto(data, arm.address)
        assert next(readings).accepts_commands == accepts
        assert arm.send(np.zeros(7)) == accepts


def test_invalid_datagrams_count_as_silence(box):
    with FriArm(port=0, give_up_s=0.6) as arm:
        box.sendto(lwr_measurement(5), arm.address)
        samples = iter(arm)
        next(samples)

        def flood(_silent_s):
            for data in (bytes(900), lwr_measurement(5)):
                box.sendto(data, arm.address)

        arm.on_silence = flood
        with pytest.raises(LinkError):
            next(samples)

    assert min(arm.report.malformed, arm.report.stale) >= 2


def test_lost_cycles_are_in_the_next_step(box, arm):
    counts = [65530, 65533, 65534, 5]  # it goes round
    for count in counts:
        box.sendto(lwr_measurement(count), arm.address)
    steps_s = [reading.dt_s for reading in islice(arm, len(counts))]

    assert steps_s == pytest.approx([2e-3, 6e-3, 2e-3, 14e-3])
    assert (arm.report.used, arm.report.missed) == (4, 8)


def test_after_a_long_pause_of_the_program_its_own_clock_counts(box, arm):
    """The counter may have gone round; what has waited tells of the past."""
    readings = iter(arm)
    box.sendto(lwr_measurement(5), arm.address)
    next(readings)
    paused_s = time.monotonic()
    for count in range(6, 60):
        box.sendto(lwr_measurement(count), arm.address)
    time.sleep(1.1)
    now = lwr_measurement(40, joints={216: POSITION})
    arm.on_silence = lambda _: box.sendto(now, arm.address)
    reading = next(readings)
    passed_s = time.monotonic() - paused_s

    assert 1.1 <= reading.dt_s <= passed_s + 0.1
    assert reading.q_rad.tolist() == list(POSITION)


def test_a_controller_that_counts_anew_is_heard_after_a_silence(box, arm):
    readings = iter(arm)
    box.sendto(lwr_measurement(40_000), arm.address)
    next(readings)
    begin_s = time.monotonic()
    for count in (39_999, 40_000, 50_000, 3):  # late, repeated, too far ahead
        box.sendto(lwr_measurement(count), arm.address)
    counts = iter(range(4, 100))
    arm.on_silence = lambda _: box.sendto(lwr_measurement(next(counts)), arm.address)
    step_s = next(readings).dt_s
    passed_s = time.monotonic() - begin_s

    assert 0.1 <= step_s <= passed_s + 0.01
    assert arm.report.stale == 4


def changed(offset, layout, value):
    data = bytearray(lwr_measurement())
    struct.pack_into(layout, data, offset, value)
    return bytes(data)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        bytes(916),
        changed(4, "<H", 915),  # size
        changed(6, "<H", 0x1005),  # kind
        changed(148, "<f", 0.0),  # period
        changed(148, "<f", 1e-7),
        changed(148, "<f", 0.2),
        changed(144, "<H", 3),  # state
        changed(146, "<H", 4),  # quality
        changed(216, "<f", np.nan),  # position
        changed(292, "<f", np.nan),
        changed(320, "<f", np.inf),
        changed(444, "<f", np.inf),  # torque
        changed(472, "<f", np.nan),
        lwr_measurement()[:-1],
        lwr_measurement(size=917),
        *(np.random.default_rng(seed).bytes(916) for seed in range(5)),
    ],
)
def test_what_is_no_measurement_is_refused(data, box, arm):
    box.sendto(data, arm.address)
    box.sendto(lwr_measurement(), arm.address)

    assert next(iter(arm)).dt_s == 0.002
    assert arm.report.malformed == 1


def test_another_sender_is_not_listened_to(box):
    with (
        FriArm(port=0) as arm,
        socket.socket(type=socket.SOCK_DGRAM) as stranger,
    ):
        box.sendto(lwr_measurement(0), arm.address)
        readings = iter(arm)
        next(readings)
        for count in (1, 2):
            stranger.sendto(lwr_measurement(100 + count), arm.address)
            box.sendto(lwr_measurement(count), arm.address)

        assert [next(readings).dt_s for _ in range(2)] == [0.002] * 2

    for peer, used in (("127.0.0.2", 0), ("127.1", 1)):
        with FriArm(port=0, peer=peer, give_up_s=0.1) as named:
            box.sendto(lwr_measurement(), named.address)
            assert len(taken(named, [])) == used == 1 - named.report.foreign


def test_the_first_controller_is_kept_after_an_outage():
    with FriArm("0.0.0.0", 0, give_up_s=0.2) as arm:
        address = ("127.0.0.1", arm.address.port)

        def send_from(host, count):
            with socket.socket(type=socket.SOCK_DGRAM) as new:
                new.bind((host, 0))
                new.sendto(lwr_measurement(count), address)

        send_from("127.0.0.2", 1)
        assert len(taken(arm, [])) == 1
        send_from("127.0.0.3", 2)
        assert taken(arm, []) == []  # another host counts as silence
        send_from("127.0.0.2", 3)  # the same host, on another port
        assert next(iter(arm)).missed > 0


@pytest.mark.parametrize(
    ("settings", "error", "word"),
    [
        ({"port": 70000}, DeviceSettingError, "70000"),
        ({"port": 0, "give_up_s": 0.0}, DeviceSettingError, "give_up_s=0.0"),
        ({"port": 0, "give_up_s": np.inf}, DeviceSettingError, "give_up_s=inf"),
        ({"port": 0, "peer": "no-such-host.invalid"}, LinkError, "no-such-host"),
        ({"port": 0, "peer": "a" * 70}, LinkError, "aaa"),
    ],
)
def test_an_address_that_cannot_be_is_refused(settings, error, word):
    with pytest.raises(error, match=word):
        FriArm(**settings)


def test_a_port_in_use_is_named():
    with FriArm(port=0) as arm, pytest.raises(LinkError, match=str(arm.address.port)):
        FriArm(port=arm.address.port)


def test_recorded_signals_come_in_real_time_until_the_end():
    arm = ReplayArm(np.full(100, 1e-3), ROWS, None, ROWS)
    begin_s = time.monotonic()
    assert len(list(islice(pace(arm), 50))) == 50
    assert time.monotonic() - begin_s > 0.04
    assert not arm.send(np.zeros(7))
    arm.close()
    assert list(arm) == []
    assert arm.report.used == 50
