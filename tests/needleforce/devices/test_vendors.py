"""Franka and UR arms through the vendors' own clients, against emulated arms."""

import fcntl
import os
import signal
import sys
import time
from itertools import islice

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.devices import (
    DeviceSettingError,
    Fr3Arm,
    FrankaArm,
    LinkError,
    MissingClientError,
    UrArm,
    connect_arm,
)
from needleforce.devices.emulators import Emulator
from needleforce.recordings import read_log
from tests.needleforce.devices.franka_sim_process import HOST, emulate_fr3
from tests.needleforce.devices.ur_emulator import emulate_ur

ROWS = np.random.default_rng(0).normal(size=(3, 1000, 6))
STILL = np.zeros((3, 1, 6))
UR_WISH_rad_s = np.array([0.1, 0.0, -0.2, 0.0, 0.0, 0.3])
FR3_WISH_rad_s = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3])


@pytest.fixture(autouse=True)
def _alone(tmp_path_factory):
    """The vendors' ports are fixed: one of these tests at a time, whatever the
    workers."""
    with (tmp_path_factory.getbasetemp().parent / "vendors.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.fixture
def fr3():
    pytest.importorskip("franky")
    pytest.importorskip("franky_sim")
    with Emulator(emulate_fr3) as simulator:
        yield simulator


def ur(rows=STILL):
    pytest.importorskip("rtde_control")
    return Emulator(emulate_ur, rows)


def drive(arm, velocity_rad_s):
    """Command a velocity; after a pause of this machine one from rest."""
    if not arm.send(velocity_rad_s):
        arm.send(0.1 * velocity_rad_s)


@pytest.mark.slow
def test_an_fr3_is_read_without_being_commanded(fr3, tmp_path, capsys):
    path = tmp_path / "fr3.csv"
    with connect_arm(f"fr3:{HOST}") as arm:
        readings = list(islice(arm, 200))
        assert not arm.send(np.zeros(7))
    last = readings[-1]

    assert last.q_rad == pytest.approx([0, 0, 0, -1.57, 0, 1.57, 0.785], abs=0.01)
    assert last.tau_Nm.shape == last.external_Nm.shape == (7,)
    assert not last.accepts_commands
    assert np.abs(last.q_rad - readings[0].q_rad).max() < 1e-3
    assert sum(reading.missed for reading in readings) == arm.report.missed
    # It describes itself to the command line.
    assert main(["record", f"fr3:{HOST}", "-o", str(path), "--seconds", "1"]) == 0
    assert "link8" in capsys.readouterr().err
    assert len(read_log(path)) > 100


@pytest.mark.slow
@pytest.mark.parametrize("end", ["close", "hang"])
def test_an_fr3_is_driven_and_rests_when_its_program_ends_or_hangs(fr3, end):
    with connect_arm(f"fr3:{HOST}", takes_commands=True) as arm:
        readings = iter(arm)
        begin_rad = next(readings).q_rad
        for number in range(500):
            drive(arm, min(number / 200.0, 1.0) * FR3_WISH_rad_s)
            reading = next(readings)
            assert not arm.send(np.full(7, np.nan))
        assert reading.accepts_commands
        if end == "hang":
            time.sleep(0.5)
    with Fr3Arm(HOST) as arm:
        places_rad = [reading.q_rad for reading in islice(arm, 100)]
    moved_rad = places_rad[-1] - begin_rad

    assert moved_rad[6] > 0.02
    assert np.abs(moved_rad[:6]).max() < 0.01
    assert np.ptp(places_rad, axis=0).max() < 2e-3


@pytest.mark.slow
@pytest.mark.parametrize("is_commanded", [False, True])
def test_an_fr3_that_falls_silent_is_reported_and_lost(fr3, is_commanded):
    silences_s = []
    with Fr3Arm(HOST, takes_commands=is_commanded, give_up_s=4.0) as arm:
        readings = iter(arm)
        for _ in range(200):
            next(readings)
            assert arm.send(0.1 * FR3_WISH_rad_s) is is_commanded
        arm.on_silence = silences_s.append
        os.kill(fr3._process.pid, signal.SIGSTOP)
        with pytest.raises(LinkError, match="stopped" if is_commanded else "silent"):
            list(readings)
        os.kill(fr3._process.pid, signal.SIGCONT)

        assert 0.1 <= silences_s[0] < 0.4
        assert arm.report.longest_gap_s > 0.5
        assert not (is_commanded and arm.send(np.zeros(7)))


@pytest.mark.slow
@pytest.mark.parametrize("ends", ["error", "silence", "hang"])
def test_a_ur_is_driven_and_stopped_on_every_way_out(ends):
    with ur() as emulator:
        arm = connect_arm("ur:127.0.0.1", takes_commands=True)
        readings = iter(arm)
        try:
            with arm:
                for number in range(300):
                    reading = next(readings)
                    if number < 200 or ends != "silence":
                        drive(arm, UR_WISH_rad_s)
                if ends == "error":
                    raise ZeroDivisionError
                if ends == "hang":
                    time.sleep(4.0)  # the emulator's watchdog bears 3 s
                    with pytest.raises(LinkError, match="stopped"):
                        list(readings)
        except ZeroDivisionError:
            assert ends == "error"
        assert not arm.send(UR_WISH_rad_s)
        counts = emulator.stop()
    moved_rad = counts["moved_rad"]

    assert moved_rad[5] > 0.03
    assert moved_rad == pytest.approx(UR_WISH_rad_s / 0.3 * moved_rad[5], abs=1e-2)
    assert counts["watchdog_ended"] is (ends == "hang")
    assert not counts["is_running"]
    assert counts["stops"] == (ends != "hang")
    assert counts["watchdog_Hz"] == 10.0
    assert ends != "silence" or not reading.dq_rad_s.any()


@pytest.mark.slow
def test_a_ur_that_was_lost_is_connected_to_again():
    with ur() as first, UrArm(give_up_s=20.0) as arm:
        readings = iter(arm)
        list(islice(readings, 50))
        lost_s = time.monotonic()
        first.__exit__()
        with ur():
            back = next(reading for reading in readings if reading.dt_s > 0.5)
            passed_s = time.monotonic() - lost_s
            assert next(readings).dt_s < 0.5

    assert back.dt_s <= passed_s + 0.1
    assert arm.report.outages >= 1


@pytest.mark.slow
@pytest.mark.parametrize("has_constants", [True, False])
def test_a_ur_recording_has_currents_and_known_torques(has_constants, tmp_path, capsys):
    constants = np.arange(1.0, 7.0)
    path = tmp_path / "ur.npz"
    options = ["--motor-constants", *map(str, constants)] if has_constants else []
    with ur(ROWS):
        name = ["ur:127.0.0.1", "--seconds", "0.4", *options]
        assert main(["record", *name, "-o", str(path)]) == 0
        assert has_constants or main(["live", *name]) == 2
    table = np.load(path)
    [row] = np.flatnonzero((ROWS[0] == table["q_rad"][-1]).all(axis=1))

    assert len(table["current_A"]) > 50
    assert np.array_equal(table["dq_rad_s"][-1], ROWS[1, row])
    assert np.array_equal(table["current_A"][-1], ROWS[2, row])
    assert ("--motor-constants" in capsys.readouterr().err) != has_constants
    if has_constants:
        assert np.array_equal(table["tau_Nm"], constants * table["current_A"])
    else:
        assert "tau_Nm" not in table


@pytest.mark.parametrize(
    ("arm_type", "settings", "error", "word"),
    [
        (Fr3Arm, {"host": "127.0.0.8"}, LinkError, "127.0.0.8"),
        (UrArm, {"host": "127.0.0.8"}, LinkError, "127.0.0.8"),
        (UrArm, {"torque_constant_Nm_A": [1.0]}, DeviceSettingError, "six"),
        (UrArm, {"torque_constant_Nm_A": [-1.0] * 6}, DeviceSettingError, "six"),
        (UrArm, {"rate_hz": 0.0}, DeviceSettingError, "rate_hz=0.0"),
        (UrArm, {"rate_hz": np.nan}, DeviceSettingError, "rate_hz=nan"),
        (UrArm, {"give_up_s": np.nan}, DeviceSettingError, "give_up_s"),
    ],
)
def test_an_arm_that_cannot_be_is_refused(arm_type, settings, error, word):
    with pytest.raises(error, match=word):
        arm_type(**settings)


@pytest.mark.parametrize(
    ("arm_type", "module", "package"),
    [
        (FrankaArm, "franky", "franky-control"),
        (UrArm, "rtde_receive", "ur_rtde"),
    ],
)
def test_a_client_that_is_not_installed_is_named(
    arm_type, module, package, monkeypatch
):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingClientError, match=package):
        arm_type()
