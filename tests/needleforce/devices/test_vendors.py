"""Franka and UR arms through the vendors' own clients, against emulated arms."""

import fcntl
import os
import re
import signal
import sys
import time
from itertools import islice
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.devices import (
    DeviceSettingError,
    Emulator,
    Fr3Arm,
    FrankaArm,
    LinkError,
    MissingClientError,
    UrArm,
    connect_arm,
    ur,
)
from needleforce.recordings import read_log
from tests.needleforce.devices.franka_sim_process import HOST, emulate_fr3
from tests.needleforce.devices.scripted_arms import Ur

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


class ReadUr(Ur):
    """One that is only read."""

    settings = MappingProxyType(
        {"torque_constant_Nm_A": np.arange(1.0, 7.0), "give_up_s": 20.0}
    )

    def getActualCurrent(self):
        return [1.0, -2.0, 3.0, 4.0, 5.0, 6.0]


def test_a_ur_reads_currents_and_known_torques():
    readings = {}
    for kind in (Ur, ReadUr):
        scripted = kind()
        scripted.send()
        readings[kind] = next(scripted.readings)
        scripted.close()

    assert readings[Ur].tau_Nm is None
    assert readings[ReadUr].current_A.tolist() == [1.0, -2.0, 3.0, 4.0, 5.0, 6.0]
    assert readings[ReadUr].tau_Nm.tolist() == [1.0, -4.0, 9.0, 16.0, 25.0, 36.0]


def test_a_ur_that_was_lost_is_connected_to_again(monkeypatch):
    scripted = ReadUr()
    monkeypatch.setattr(ur, "import_client", lambda *_: scripted.library)
    scripted.run_freely()
    list(islice(scripted.readings, 50))
    scripted.is_connected = False
    lost_s = time.monotonic()
    back = next(reading for reading in scripted.readings if reading.dt_s > 0.3)

    assert back.dt_s <= time.monotonic() - lost_s + 0.1
    assert scripted.arm.report.outages >= 1
    scripted.close()


def test_a_closed_ur_has_stopped_and_ended_its_program():
    scripted = Ur()
    scripted.close()

    assert not scripted.isProgramRunning()


@pytest.mark.parametrize("module", ["rtde_control", "rtde_receive"])
def test_the_client_of_a_ur_has_what_the_driver_calls(module):
    interface, prefix = {
        "rtde_control": ("RTDEControlInterface", "control"),
        "rtde_receive": ("RTDEReceiveInterface", "receiver"),
    }[module]
    source = Path(ur.__file__).read_text(encoding="utf-8")
    calls = set(re.findall(rf"{prefix}\.(\w+)\(", source))

    assert len(calls) >= 5
    assert calls <= set(dir(getattr(pytest.importorskip(module), interface)))


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
