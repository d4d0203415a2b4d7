"""`needleforce live --tare-stroke` on the simulated arm and an emulated KUKA."""

import pytest

from needleforce.cli import main
from needleforce.cli.arms import arm_stroke


def test_live_moves_the_simulated_arm_and_is_tared(capsys, monkeypatch):
    monkeypatch.setattr(arm_stroke, "MIN_LEG_S", 2.0)
    monkeypatch.setattr(arm_stroke, "MEAN_SPEED_m_s", 0.02)
    options = ["--tare-stroke", "20", "--tare-swivel", "10", "--seconds", "0.5"]
    assert main(["live", "sim", "--yes", *options]) == 0

    output = capsys.readouterr()
    assert "draw the needle back by 20 mm" in output.err
    assert "5 times by 10 degrees" in output.err
    assert "  ok  force" in output.out
    assert "not tared" not in output.out


def test_an_arm_does_not_move_unasked(capsys):
    assert main(["live", "sim", "--tare-stroke", "20"]) != 0
    assert "give --yes" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "match"),
    [
        (["--tare-stroke", "0"], "--tare-stroke 0"),
        (["--tare-stroke", "20", "--tare-swivel", "-5"], "--tare-swivel -5"),
    ],
)
def test_a_motion_that_cannot_be_is_refused(options, match, capsys):
    assert main(["live", "sim", "--yes", *options]) != 0
    assert match in capsys.readouterr().err


def test_a_ur_without_torques_is_refused_before_it_moves(capsys):
    arguments = ["live", "ur:arm.example", "--robot", "ur10e", "--yes"]
    assert main([*arguments, "--tare-stroke", "20"]) != 0
    assert "motor currents" in capsys.readouterr().err
