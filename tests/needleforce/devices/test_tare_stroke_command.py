"""`needleforce live --tare-stroke` on the simulated arm and an emulated KUKA."""

import re
from itertools import cycle

import numpy as np
import pytest

from needleforce.cli import main

WATCH = "needleforce.cli.arms.arm_watch"


class NoisySensor:
    """A force sensor that reads the tool's weight of 3 N, and noise of 1 N."""

    def __init__(self, host):
        self.report = host
        self.faults = 0
        self._noise_N = cycle((1.0, -1.0))

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def read(self):
        return np.array([0.0, 0.0, 3.0 + next(self._noise_N), 0.0, 0.0, 0.0])


@pytest.mark.slow
def test_live_moves_the_simulated_arm_and_is_tared(capsys, monkeypatch):
    monkeypatch.setattr(f"{WATCH}.MIN_LEG_S", 2.0)
    monkeypatch.setattr(f"{WATCH}.MEAN_SPEED_m_s", 0.02)
    monkeypatch.setattr(f"{WATCH}.NetFT", NoisySensor)
    options = ["--tare-stroke", "20", "--seconds", "1"]
    assert main(["live", "sim", "--yes", "--reference", "ft", *options]) == 0

    output = capsys.readouterr()
    assert "draw the needle back by 20 mm" in output.err
    assert " mm from the tare" in output.out
    assert "not tared" not in output.out
    # The sensor's zero is the mean of many readings: its noise of 1 N is left.
    rms_N, ticks = re.search(
        r"rms difference (.*) N of (\d+) ticks", output.err
    ).groups()
    assert float(rms_N) == pytest.approx(1.0, abs=0.1)
    assert 400 < int(ticks) < 600


def test_an_arm_does_not_move_unasked(capsys):
    assert main(["live", "sim", "--tare-stroke", "20"]) != 0
    assert "give --yes" in capsys.readouterr().err


def test_a_stroke_that_cannot_be_is_refused(capsys):
    assert main(["live", "sim", "--yes", "--tare-stroke", "0"]) != 0
    assert "--tare-stroke" in capsys.readouterr().err


def test_a_ur_without_torques_is_refused_before_it_moves(capsys):
    arguments = ["live", "ur:arm.example", "--robot", "ur10e", "--yes"]
    assert main([*arguments, "--tare-stroke", "20"]) != 0
    assert "motor currents" in capsys.readouterr().err
