"""Arms of vendors through the vendors' own clients, against emulators in other
processes."""

import fcntl
import sys
import time
from contextlib import suppress
from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.devices import (
    DeviceSettingError,
    FrankaArm,
    LinkError,
    MissingClientError,
    UrArm,
    connect_arm,
    ur,
)
from needleforce.devices.emulators import Emulator
from tests.needleforce.devices.ur_emulator import emulate_ur
from tests.needleforce.devices.vendor_emulators import ArmSettings, emulate_franka


def rows(joints, rate_hz, **settings):
    rng = np.random.default_rng(0)
    q, dq, effort = rng.normal(size=(3, 1000, joints))
    return ArmSettings(q_rad=q, dq_rad_s=dq, effort=effort, rate_hz=rate_hz, **settings)


def take_readings(arm, count):
    readings = []
    for reading in arm:
        readings.append(reading)
        if len(readings) == count:
            return readings

    return readings


@pytest.fixture(autouse=True)
def _alone(tmp_path_factory):
    """The vendors' ports are fixed: one of these tests at a time, whatever the
    workers."""
    with (tmp_path_factory.getbasetemp().parent / "vendors.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@pytest.mark.slow
def test_a_franka_arm_is_read_bit_for_bit():
    pytest.importorskip("panda_py")
    settings = rows(7, 1000.0)
    with Emulator(emulate_franka, settings) as emulator, FrankaArm() as arm:
        readings = take_readings(arm, 1000)
        assert emulator.stop()["sent"] >= 1000

    assert len(readings) == 1000

    first = next(
        k for k in range(1000) if np.array_equal(settings.q_rad[k], readings[0].q_rad)
    )
    at = (
        first
        + np.cumsum([sample.missed + 1 for sample in readings])
        - readings[0].missed
        - 1
    )
    for name, signal in (
        ("q_rad", settings.q_rad),
        ("dq_rad_s", settings.dq_rad_s),
        ("tau_Nm", settings.effort),
    ):
        assert np.array_equal(
            [getattr(sample, name) for sample in readings], signal[at % 1000]
        )

    assert not arm.send(np.zeros(7))


@pytest.mark.slow
def test_a_franka_arm_is_driven_also_while_its_program_is_busy():
    pytest.importorskip("panda_py")
    still = np.zeros((1, 7))
    settings = ArmSettings(q_rad=still, dq_rad_s=still, effort=still, rate_hz=1000.0)
    wish_rad_s = np.array([0.1, 0.0, -0.2, 0.0, 0.0, 0.0, 0.3])
    with Emulator(emulate_franka, settings) as emulator:
        with connect_arm("franka:127.0.0.1", takes_commands=True) as arm:
            for number, reading in enumerate(arm):
                assert reading.accepts_commands
                assert arm.send(min(number / 200.0, 1.0) * wish_rad_s)
                if number == 500:
                    break

            time.sleep(0.5)  # the arm is braked meanwhile, not lost
            take_readings(arm, 20)

        counts = emulator.stop()

    driven_rad = 0.4 * wish_rad_s  # 0.2 s of start, 0.3 s on
    assert counts["moved_rad"] == pytest.approx(driven_rad, abs=0.05)
    assert counts["speed_rad_s"] < 1e-6  # the client filters what it is given
    assert not arm.send(wish_rad_s)


@pytest.mark.slow
def test_currents_of_a_ur_arm_become_torques():
    pytest.importorskip("rtde_receive")
    settings = rows(6, 500.0)
    constants = np.arange(1.0, 7.0)
    with Emulator(emulate_ur, settings) as emulator:
        with UrArm(torque_constant_Nm_A=constants) as arm:
            readings = take_readings(arm, 500)

        assert emulator.stop()["sent"] >= 500

    assert len(readings) == 500

    for reading in readings[::50]:
        row = np.flatnonzero((settings.q_rad == reading.q_rad).all(axis=1))
        assert row.size == 1
        assert np.array_equal(reading.tau_Nm, constants * settings.effort[row[0]])

    assert sum(reading.missed for reading in readings) == arm.report.missed


STILL = np.zeros((1, 6))
UR_WISH_rad_s = np.array([0.1, 0.0, -0.2, 0.0, 0.0, 0.3])


def still_ur():
    return ArmSettings(q_rad=STILL, dq_rad_s=STILL, effort=STILL, rate_hz=500.0)


@pytest.mark.slow
@pytest.mark.parametrize("ends", ["error", "silence"])
def test_a_ur_arm_is_driven_and_stopped_on_every_way_out(ends):
    pytest.importorskip("rtde_control")
    with Emulator(emulate_ur, still_ur()) as emulator:
        with (
            suppress(ZeroDivisionError),
            connect_arm("ur:127.0.0.1", takes_commands=True) as arm,
        ):
            for number, reading in enumerate(arm):
                assert reading.accepts_commands
                if number < 200 or ends != "silence":
                    assert arm.send(UR_WISH_rad_s)
                    assert not arm.send([np.nan] * 6)
                if number == 200 and ends == "error":
                    raise ZeroDivisionError
                if number == 300:
                    rest_rad_s = reading.dq_rad_s
                    break

        assert not arm.send(UR_WISH_rad_s)
        counts = emulator.stop()

    moved = counts["moved_rad"]

    assert moved[5] > 0.03
    assert moved == pytest.approx(UR_WISH_rad_s / 0.3 * moved[5], abs=1e-2)
    assert counts["stops"] == 1
    assert not counts["is_running"]
    assert not counts["watchdog_ended"]

    if ends == "silence":
        assert np.abs(rest_rad_s).max() == 0.0


@pytest.mark.slow
def test_a_ur_arm_stops_by_itself_when_its_program_hangs():
    pytest.importorskip("rtde_control")
    with (
        Emulator(emulate_ur, still_ur()) as emulator,
        connect_arm("ur:127.0.0.1", takes_commands=True) as arm,
    ):
        readings = iter(arm)
        for _ in range(100):
            next(readings)
            arm.send(UR_WISH_rad_s)

        time.sleep(0.5)  # five times what the watchdog bears
        with pytest.raises(LinkError, match="its program has ended") as caught:
            list(readings)

        assert not arm.send(UR_WISH_rad_s)
        assert emulator.stop()["watchdog_ended"]

    assert "Release it at its own panel" in caught.value.advice


@pytest.mark.slow
def test_a_ur_controller_that_does_not_fit_names_its_software(monkeypatch):
    pytest.importorskip("rtde_receive")

    def refuse(*_):
        raise RuntimeError("no such output")

    library = SimpleNamespace(RTDEReceiveInterface=refuse)
    monkeypatch.setattr(ur, "import_client", lambda *_: library)
    with (
        Emulator(emulate_ur, still_ur()),
        pytest.raises(LinkError, match="it runs URSoftware 5") as caught,
    ):
        UrArm()

    assert "ur_rtde 1.6" in str(caught.value)


@pytest.mark.slow
@pytest.mark.parametrize("has_constants", [True, False])
def test_a_ur_recording_has_currents_and_known_torques(has_constants, tmp_path, capsys):
    pytest.importorskip("rtde_receive")
    settings = rows(6, 500.0)
    constants = np.arange(1.0, 7.0)
    path = tmp_path / "ur.npz"
    constant_options = (
        ["--motor-constants", *map(str, constants)] if has_constants else []
    )
    with Emulator(emulate_ur, settings):
        ur = ["ur:127.0.0.1", "--seconds", "0.4", *constant_options]
        assert main(["record", *ur, "-o", str(path)]) == 0
        assert has_constants or main(["live", *ur]) == 2

    said = capsys.readouterr().err
    table = np.load(path)

    assert "'ur10e'; --robot or --urdf names another" in said
    assert len(table["current_A"]) > 50
    assert ("give --motor-constants" in said) != has_constants

    if has_constants:
        assert np.array_equal(table["tau_Nm"], constants * table["current_A"])


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (["sim:gel-25-constant", "--robot", "panda"], "simulates an LWR 4+"),
        (["fri", "--motor-constants", *"123456"], "describes a ur:ADDRESS, not fri"),
    ],
)
def test_options_unknown_to_an_arm_are_refused(options, why, capsys):
    assert main(["live", *options]) == 2
    assert why in capsys.readouterr().err


class DoubtfulUr:
    """Stands in for the vendor's client: its second current is none."""

    def __init__(self, *_):
        self.time_s = 0.0

    def isConnected(self):
        self.time_s += 2e-3
        return self.time_s < 7e-3

    def getTimestamp(self):
        return self.time_s

    def getActualQ(self):
        return [0.1] * 6

    getActualQd = getActualQ

    def getActualCurrent(self):
        return [np.nan if 3e-3 < self.time_s < 5e-3 else 1.0] * 6

    def disconnect(self):
        pass


def test_nan_currents_are_counted_and_dropped(monkeypatch):
    library = SimpleNamespace(RTDEReceiveInterface=DoubtfulUr)
    monkeypatch.setattr(ur, "import_client", lambda *_: library)
    with UrArm() as arm:
        readings = list(arm)
        assert (len(readings), arm.report.malformed, readings[1].missed) == (2, 1, 1)
        assert np.isfinite([sample.current_A for sample in readings]).all()


def test_an_absent_arm_is_reported():
    pytest.importorskip("panda_py")
    pytest.importorskip("rtde_receive")

    with pytest.raises(LinkError, match="no Franka arm"):
        FrankaArm()

    with pytest.raises(LinkError, match="no UR arm"):
        UrArm()

    with pytest.raises(DeviceSettingError, match="six positive"):
        UrArm(torque_constant_Nm_A=[1.0])


def test_a_client_that_is_not_installed_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "panda_py.libfranka", None)
    monkeypatch.setitem(sys.modules, "rtde_receive", None)

    with pytest.raises(MissingClientError, match="panda-python is not installed"):
        FrankaArm()

    with pytest.raises(MissingClientError, match="ur_rtde is not installed"):
        UrArm()
