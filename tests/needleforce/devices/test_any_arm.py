"""The program of `examples/any_arm.py` on emulated arms of every kind."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from needleforce.control import Controller, Limits, Posture, SettingError
from needleforce.devices import Emulator, FriArm, FriSettings, LinkError, emulate_fri
from tests.needleforce.devices.scripted_arms import KINDS
from urdf import NeedleTool, load_lwr

ROOT = Path(__file__).parents[3]
POSTURE = np.array([[0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]])


@pytest.mark.slow
def test_the_program_strokes_an_lwr_until_it_is_lost(monkeypatch):
    text = (ROOT / "examples" / "any_arm.py").read_text(encoding="utf-8")
    program = re.sub(r"(?m)^arm = SimulatedArm\(.*\)$", "arm = given_arm", text)
    assert program != text
    monkeypatch.setattr(plt, "show", plt.close)
    robot = load_lwr(payload=NeedleTool())
    arm = FriArm(port=0, robot=robot, give_up_s=1.0)
    settings = FriSettings(
        port=arm.address.port,
        q_rad=POSTURE,
        tau_Nm=np.zeros((1, 7)),
        period_s=2e-3,
        cycles=400,
        extra_wait_s=20.0,
        command_from_s=0.1,
    )
    with Emulator(emulate_fri, settings) as controller:
        with pytest.raises(LinkError):
            exec(compile(program, "any_arm.py", "exec"), {"given_arm": arm})
        counts = controller.counts()

    assert counts["same_cycle"] == 400
    assert 1e-3 < np.abs(counts["commanded_rad"] - POSTURE[0]).max() < 0.1


@pytest.mark.parametrize("name", sorted({*KINDS} - {"ur5e"}))  # of seven joints
def test_an_arm_without_a_limit_of_the_jerk_is_refused(name):
    """Before anything has moved; by name it is allowed."""
    robot = load_lwr(payload=NeedleTool())
    scripted = KINDS[name](place_rad=POSTURE[0])
    scripted.run_freely()
    reading = next(scripted.readings)
    scripted.close()
    tasks = [Posture(reading.q_rad)]
    refused = Controller(robot, Limits(robot))

    with pytest.raises(SettingError, match="of_arm"):
        refused.update(reading, tasks)

    assert not refused.last_rad_s.any()
    for allowed in (
        Controller(robot, Limits(robot, jerk_rad_s3=2000.0)),
        Controller(robot, Limits.of_arm(robot, scripted.arm.preset)),
    ):
        assert allowed.update(reading, tasks).reason == ""
