"""The program of `examples/any_arm.py` on emulated arms of every kind."""

import re
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from groundtruth.rig_arm import SimulatedArm
from needleforce.control import Controller, Limits, Posture, SettingError
from needleforce.devices import (
    Fr3Arm,
    FrankaArm,
    FriArm,
    IiwaArm,
    UrArm,
    connect_arm,
)
from needleforce.devices.arm_limits import ARM_LIMITS
from needleforce.devices.emulators import (
    Emulator,
    FriSettings,
    SunriseSettings,
    emulate_fri,
    emulate_sunrise,
)
from tests.needleforce.devices.franka_sim_process import emulate_fr3
from urdf import NeedleTool, load_lwr, load_urdf

pytestmark = pytest.mark.slow


PROGRAM = (Path(__file__).parents[3] / "examples" / "any_arm.py").read_text(
    encoding="utf-8"
)
ARM_LINE = re.compile(r"^arm = SimulatedArm\(.*\)$", re.MULTILINE)
HOST = "127.0.0.5"


def run_program(arm, monkeypatch, **times_s):
    """Run the program on an arm; return its names."""
    code, lines = ARM_LINE.subn("arm = given_arm", PROGRAM)
    assert lines == 1

    for name, value in times_s.items():
        code, lines = re.subn(
            rf"^{name} = [\d.]+", f"{name} = {value}", code, flags=re.M
        )
        assert lines == 1

    monkeypatch.setattr(plt, "show", plt.close)
    names = {"given_arm": arm}
    exec(compile(code, "any_arm.py", "exec"), names)
    return names


def test_the_program_tares_an_fr3_and_strokes(monkeypatch, tmp_path, capsys):
    pytest.importorskip("pylibfranka")
    pytest.importorskip("franky_sim")
    with Emulator(emulate_fr3, HOST):
        path = tmp_path / "fr3.urdf"
        path.write_text(Fr3Arm.read_urdf(HOST), encoding="utf-8")
        robot = load_urdf(path, tool_frame="link8", payload=NeedleTool())
        arm = connect_arm(f"fr3:{HOST}", robot=robot, takes_commands=True)
        names = run_program(arm, monkeypatch, STROKE_s=0.8, REST_s=0.1)

    assert names["session"].tared
    assert len(names["rows"]) > 300
    assert re.search(r"at most \d\.\d\d N", capsys.readouterr().out)


@pytest.mark.parametrize("kind", ["fri", "iiwa"])
def test_the_program_strokes_an_arm_that_sends_to_this_machine(kind, monkeypatch):
    robot = load_lwr(payload=NeedleTool())
    posture = np.array([[0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]])
    torque_Nm = np.zeros((1, 7))
    arm_type = {"fri": FriArm, "iiwa": IiwaArm}[kind]
    arm = arm_type(port=0, robot=robot, give_up_s=1.0)
    settings_type = {"fri": FriSettings, "iiwa": SunriseSettings}[kind]
    settings = settings_type(
        port=arm.address.port,
        q_rad=posture,
        tau_Nm=torque_Nm,
        period_s=2e-3,
        cycles=400,
        extra_wait_s=20.0,
        command_from_s=0.1,
    )
    work = {"fri": emulate_fri, "iiwa": emulate_sunrise}[kind]
    with Emulator(work, settings) as controller:
        # It ends before the tare, without a row to draw.
        with pytest.raises(ValueError, match="empty"):
            run_program(arm, monkeypatch)

        counts = controller.counts()

    assert counts["same_cycle"] == 400
    moved_rad = counts.get("moved_rad")
    if moved_rad is None:
        moved_rad = counts["commanded_rad"] - posture[0]

    assert 1e-3 < np.abs(moved_rad).max() < 0.1


EXAMPLES = sorted((Path(__file__).parents[3] / "examples").glob("*.py"))
DEMOS = sorted((Path(__file__).parents[3] / "needleforce" / "cli").rglob("*.py"))
PAGES = sorted((Path(__file__).parents[3] / "docs").rglob("*.md"))


def test_every_program_that_moves_an_arm_limits_the_jerk():
    """Whoever copies a loop copies its limits; lists of tasks alone name none."""
    named = 0
    for path in (*EXAMPLES, *DEMOS, *PAGES):
        text = path.read_text(encoding="utf-8")
        unlimited = re.findall(r"Controller\([\w.]+, (?:control\.)?Limits\(", text)
        named += len(re.findall(r"Limits\.of_arm\(|arm\.limits", text))

        assert not unlimited, path

    assert named >= 12


@pytest.mark.parametrize("arm", [Fr3Arm, FrankaArm, FriArm, IiwaArm, UrArm])
def test_every_arm_names_its_limits(arm):
    names = {
        Fr3Arm: "fr3",
        FrankaArm: "fer",
        FriArm: "lwr",
        IiwaArm: "iiwa14",
        UrArm: "ur5e",
    }

    assert arm.preset == names[arm]
    assert arm.preset in ARM_LIMITS


@pytest.mark.parametrize("kind", ["fri", "iiwa"])
def test_an_arm_without_a_limit_of_the_jerk_is_refused(kind):
    """Before anything has moved, with what to do; by name it is allowed."""
    robot = load_lwr(payload=NeedleTool())
    arm_type = {"fri": FriArm, "iiwa": IiwaArm}[kind]
    arm = arm_type(port=0, robot=robot, give_up_s=1.0)
    settings_type = {"fri": FriSettings, "iiwa": SunriseSettings}[kind]
    settings = settings_type(
        port=arm.address.port,
        q_rad=np.array([[0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]]),
        tau_Nm=np.zeros((1, 7)),
        extra_wait_s=20.0,
    )
    work = {"fri": emulate_fri, "iiwa": emulate_sunrise}[kind]
    with Emulator(work, settings), arm:
        reading = next(iter(arm))
    tasks = [Posture(reading.q_rad)]
    refused = Controller(robot, Limits(robot))

    with pytest.raises(SettingError, match=r"Limits\.of_arm\(robot, arm\.preset\)"):
        refused.update(reading, tasks)

    assert not refused.last_rad_s.any()

    for allowed in (
        Controller(robot, Limits(robot), allow_unlimited_jerk=True),
        Controller(robot, Limits(robot, jerk_rad_s3=2000.0)),
        Controller(robot, Limits.of_arm(robot, "lwr")),
    ):
        assert allowed.update(reading, tasks).status == "ok"


def test_a_simulated_arm_needs_no_limit_of_the_jerk():
    arm = SimulatedArm(plant="clean", duration_s=0.1)
    controller = Controller(arm.robot, Limits(arm.robot))

    assert controller.update(next(arm), [Posture(arm.home_rad)]).reason == ""
