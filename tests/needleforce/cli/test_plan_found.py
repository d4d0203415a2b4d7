"""`report --plan`: where the needle went against the plan, and which layers ruptures
led into."""

import json

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.recordings import write_table
from residual import SensorConfig, ToolKinematics
from tests.insertion_run import cut, short_run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    """The short run at 500 Hz, and the axis of its needle."""
    run = short_run()
    path = tmp_path_factory.mktemp("log") / "log.npz"
    signals = cut(run.signals, slice(None, None, 2))
    names = ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
    write_table(path, {name: getattr(signals, name) for name in names})
    return path


def report(log, capsys, *, aside_m=0.0, length_m=0.1):
    """Report the log against a plan whose entry is the gel's surface, but moved aside;
    return what is printed, the warnings, and the state as JSON."""
    run = short_run()
    config = SensorConfig()
    tool = ToolKinematics(run.robot, config.frame, config.insertion_axis)
    surface = int(np.searchsorted(run.signals.t_s, run.truth.contact_s))
    tool.update(run.signals.q_rad[surface])
    axis = tool.axis_in_base
    aside = np.cross(axis, [1.0, 0.0, 0.0])
    entry_m = tool.pose[:3, 3] + aside_m * aside / np.linalg.norm(aside)
    plan = {
        "entry_m": entry_m.tolist(),
        "target_m": (entry_m + length_m * axis).tolist(),
        "offset_std_m": 0.3e-3,
        "layers": [{"name": "fat", "exit_m": 0.027}, {"name": "liver", "exit_m": 0.1}],
    }
    file = log.parent / "plan.json"
    file.write_text(json.dumps(plan))
    page = log.parent / "page"
    argv = ["report", str(log), str(page), "--tare", "0:13", "--plan", str(file)]
    assert main(argv) == 0
    return *capsys.readouterr(), json.loads((page / "needle_on_plan.json").read_bytes())


def test_a_rupture_is_named_by_the_plan(log, capsys):
    out, err, state = report(log, capsys)
    (line,) = [line for line in out.splitlines() if "liver" in line]
    at_mm, name, _, _, planned_mm, deeper_mm = line.split()

    assert (name, planned_mm) == ("liver", "27.0")
    assert float(at_mm) == pytest.approx(28.2, abs=1.5)
    assert float(deeper_mm) == pytest.approx(float(at_mm) - 27.0, abs=0.11)
    assert "on plan" in out
    assert "PLAN" not in err
    assert (state["verdict"], state["off_plan_fraction"]) == ("on plan", 0.0)


def test_off_plan_comes_first_and_names_no_layer(log, capsys):
    out, err, state = report(log, capsys, aside_m=8e-3)

    assert "OFF PLAN for 100 %" in err
    assert "OFF PLAN: 8.0" in out
    assert "liver" not in out
    assert state["off_plan_fraction"] == 1.0


def test_a_needle_beyond_the_target_is_not_on_plan(log, capsys):
    out, err, state = report(log, capsys, length_m=0.02)

    assert "PAST THE TARGET" in err
    assert "on plan" not in out
    assert state["verdict"] == "past target"
