"""`needleforce live --tare-stroke` on the simulated arm and an emulated KUKA."""

import pytest

from needleforce.cli import main

WATCH = "needleforce.cli.arms.arm_watch"


@pytest.mark.slow
def test_live_moves_the_simulated_arm_and_is_tared(capsys, monkeypatch):
    monkeypatch.setattr(f"{WATCH}.MIN_LEG_S", 2.0)
    monkeypatch.setattr(f"{WATCH}.MEAN_SPEED_m_s", 0.02)
    assert main(["live", "sim", "--yes", "--tare-stroke", "20", "--seconds", "1"]) == 0

    output = capsys.readouterr()
    assert "draw the needle back by 20 mm" in output.err
    assert " mm from the tare" in output.out
    assert "not tared" not in output.out


@pytest.mark.parametrize(
    ("command", "word"),
    [
        ("lag sim", "--yes"),
        ("live sim --tare-stroke 20", "give --yes"),
        ("live sim --yes --tare-stroke 0", "--tare-stroke"),
        # It has motor currents, no torques.
        ("live ur:arm.example --robot ur10e --yes --tare-stroke 20", "motor currents"),
    ],
)
def test_an_arm_does_not_move_unasked_or_for_nothing(command, word, capsys):
    assert main(command.split()) != 0
    assert word in capsys.readouterr().err
