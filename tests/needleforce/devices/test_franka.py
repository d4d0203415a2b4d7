"""An FR3 of franky-sim, which others wrote."""

import time
from itertools import islice

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.devices import Fr3Arm, FrankaArm, LinkError, connect_arm
from needleforce.devices.emulators import Emulator
from needleforce.devices.franka_versions import FR3_LIBRARY, describe_mismatch
from needleforce.devices.franka_wire import read_server_version
from needleforce.recordings import read_log
from tests.needleforce.devices.franka_sim_process import HOST, emulate_fr3


@pytest.fixture(scope="module")
def fr3():
    pytest.importorskip("pylibfranka")
    pytest.importorskip("franky_sim")
    with Emulator(emulate_fr3):
        yield HOST


@pytest.mark.slow
def test_an_fr3_is_read_without_being_commanded(fr3):
    with connect_arm(f"fr3:{fr3}") as arm:
        readings = list(islice(arm, 200))

        assert not arm.send(np.zeros(7))

    last = readings[-1]

    assert last.q_rad == pytest.approx([0, 0, 0, -1.57, 0, 1.57, 0.785], abs=0.01)
    assert last.tau_Nm.shape == last.external_Nm.shape == (7,)
    assert not last.accepts_commands
    assert np.abs(last.q_rad - readings[0].q_rad).max() < 1e-3


@pytest.mark.slow
def test_an_fr3_is_driven_and_rests_when_its_program_ends(fr3):
    wish_rad_s = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.3])
    with connect_arm(f"fr3:{fr3}", takes_commands=True) as arm:
        for number, reading in enumerate(arm):
            if number == 0:
                begin_rad = reading.q_rad

            assert reading.accepts_commands
            assert arm.send(min(number / 200.0, 1.0) * wish_rad_s)
            assert not arm.send(np.full(7, np.nan))
            if number == 600:
                break

    moved_rad = reading.q_rad - begin_rad
    time.sleep(0.2)
    with Fr3Arm(fr3) as arm:
        places_rad = [reading.q_rad[6] for reading in islice(arm, 100)]

    assert moved_rad[6] == pytest.approx(0.15, abs=0.03)  # 0.5 s at 0.3 rad/s
    assert np.abs(moved_rad[:6]).max() < 0.01
    assert np.ptp(places_rad) < 2e-3


@pytest.mark.slow
def test_an_fr3_describes_itself_to_the_command_line(fr3, tmp_path, capsys):
    path = tmp_path / "fr3.csv"

    assert main(["record", f"fr3:{fr3}", "-o", str(path), "--seconds", "2"]) == 0
    assert "the model is the arm's own, its flange link8" in capsys.readouterr().err

    assert len(read_log(path)) > 100


def test_a_client_of_another_version_names_both_and_what_fits(fr3):
    pytest.importorskip("panda_py")
    with pytest.raises(LinkError, match="speaks version 10 of Franka") as caught:
        FrankaArm(fr3)

    assert "panda-python 1.1 version 5" in str(caught.value)

    assert f"fr3:{fr3} uses pylibfranka" in str(caught.value)


@pytest.mark.parametrize(
    ("version", "words"),
    [
        (None, ""),
        (10, ""),
        (5, "franka:arm uses panda-python"),
        (8, "update the arm's system to one of version 10"),
        (4, "update the arm's system to 4.2"),
        (11, "a system unknown here"),
    ],
)
def test_every_version_has_an_advice(version, words, monkeypatch):
    monkeypatch.setattr(
        "needleforce.devices.franka_versions.read_server_version", lambda _: version
    )
    text = describe_mismatch("arm", FR3_LIBRARY)

    assert words in text
    assert bool(text) == bool(words)


def test_nobody_at_the_address_is_no_version():
    assert read_server_version("127.0.0.8") is None

    pytest.importorskip("pylibfranka")
    with pytest.raises(LinkError, match="FCI activated"):
        Fr3Arm("127.0.0.8")

    with pytest.raises(LinkError, match="gives no model"):
        Fr3Arm.read_urdf("127.0.0.8")


@pytest.mark.slow
def test_an_fr3_that_stops_while_commanded_says_so():
    pytest.importorskip("pylibfranka")
    pytest.importorskip("franky_sim")
    with (
        Emulator(emulate_fr3, "127.0.0.6") as simulator,
        Fr3Arm("127.0.0.6", takes_commands=True) as arm,
    ):
        readings = iter(arm)
        next(readings)
        simulator.stop()
        with pytest.raises(LinkError, match="has stopped") as caught:
            list(readings)

    assert "Release it at its own panel" in caught.value.advice
