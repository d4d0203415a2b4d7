"""`needleforce lag` on the simulated arm and on an emulated KUKA in another process."""

import json
import socket
from functools import partial

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.control import measure_lag
from needleforce.devices import Emulator, FriSettings, emulate_fri


@pytest.fixture
def _quick(monkeypatch):
    """Half of the usual motion."""
    quick = partial(measure_lag, duration_s=1.5)
    monkeypatch.setattr("needleforce.cli.arms.arm_lag.measure_lag", quick)


@pytest.mark.usefixtures("_quick")
def test_the_simulated_arm_is_as_late_as_its_line(capsys):
    assert main(["lag", "sim", "--yes", "--json"]) == 0

    result = json.loads(capsys.readouterr().out)
    assert len(result["joints"]) == 7
    for joint in result["joints"]:  # 2 ms, and half a tick to reach a velocity
        assert joint["delay_ms"] == pytest.approx(2.5, abs=0.5)
    assert 100.0 < result["safe_gain_per_s"] < result["unstable_gain_per_s"]


@pytest.mark.slow
@pytest.mark.usefixtures("_quick")
def test_an_emulated_kuka_is_as_late_as_it_was_made(capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = FriSettings(
        port=port,
        q_rad=np.array([[0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]]),
        tau_Nm=np.zeros((1, 7)),
        period_s=2e-3,
        extra_wait_s=3.0,
        delay_cycles=5,
        command_from_s=0.1,
    )
    with Emulator(emulate_fri, settings):
        assert main(["lag", f"fri:{port}", "--yes", "--json"]) == 0

    result = json.loads(capsys.readouterr().out)
    # A command is in the answer to the next packet, and in the one after that.
    for joint in result["joints"]:
        assert joint["delay_ms"] == pytest.approx(2.0 * (5 + 1), abs=1.0)
    assert result["cycle_ms"] == pytest.approx(2.0)
