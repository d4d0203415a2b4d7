"""A plan against what was found in a log: which layers ruptures led into, off plan."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleforce import NeedleTool, load_lwr
from needleforce.anatomy import Layer, PlanMatch
from needleforce.cli import main
from needleforce.cli.logs.plan_found import PlanWatch
from needleforce.needle_on_plan import PlannedPath
from needleforce.plan_file import LoadedPlan
from needleforce.scene import PlanScene
from residual import SensorConfig
from residual.tool_kinematics import ToolKinematics

HOME = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0])
LAYERS = [
    Layer("fat", 0.0, 0.01, 0.0, 0.5e-3, False),
    Layer("muscle", 0.01, 0.03, 0.5e-3, 0.5e-3, False),
    Layer("liver", 0.03, 0.06, 0.5e-3, 0.0, False),
]


def found(aside_m=0.0, ruptures_mm=(11.5, 31.5), length_m=0.1):
    """A needle that stands 45 mm below the planned entry, after two ruptures; its
    travel counts from where it stands."""
    robot = load_lwr(payload=NeedleTool())
    config = SensorConfig()
    replay = SimpleNamespace(robot=robot, config=config)
    tool = ToolKinematics(robot, config.frame, config.insertion_axis)
    tool.update(HOME)
    tip_m = tool.pose[:3, 3].copy()
    axis = tool.pose[:3, :3] @ tool.axis_in_tool
    aside = np.cross(axis, [1.0, 0.0, 0.0])
    depth_m = 0.045
    entry_m = tip_m - depth_m * axis + aside_m * aside / np.linalg.norm(aside)
    path = PlannedPath.of_std(entry_m, entry_m + length_m * axis, 0.3e-3)
    match = PlanMatch(LAYERS, 2e-3)
    plan = LoadedPlan(PlanScene(), match, entry_m, ("not checked",), path)
    watch = PlanWatch(plan, replay)
    watch.add(HOME[None], np.array([0.0]))
    layers = [
        SimpleNamespace(
            rupture=SimpleNamespace(depth_m=1e-3 * mm - depth_m),
            start_depth_m=-depth_m + 1.5e-3,
        )
        for mm in ruptures_mm
    ]
    return watch.compare(layers)


def test_ruptures_are_named_by_the_plan():
    answer = found().answer()
    (table,) = answer.tables

    assert [row[1:3] + row[4:] for row in table.rows] == [
        ("11.5", "muscle", "10.0", "+1.5"),
        ("31.5", "liver", "30.0", "+1.5"),
    ]
    assert "all lies +1." in answer.sentences[0]
    assert "45.0 mm below the planned entry: on plan" in answer.sentences[1]
    assert answer.warnings == ("not checked",)


def test_off_plan_comes_first_and_names_no_layer():
    comparison = found(aside_m=8e-3)
    answer = comparison.answer()

    assert answer.warnings[0].startswith("OFF PLAN for 100 % of the rows")
    assert answer.tables == ()
    assert "muscle" not in comparison.text()
    assert "OFF PLAN: 8.0" in comparison.text()


def test_a_needle_beyond_the_target_is_not_on_plan():
    # 45 mm deep, with the target at 34.9 mm: as deep as in the tutorial, 10.1 mm past.
    comparison = found(length_m=0.0349)
    answer = comparison.answer()

    assert answer.warnings[0] == (
        "PAST THE TARGET: at its deepest the tip was 10.1 ± 0.3 mm past the target"
    )
    assert "45.0 mm below the planned entry: PAST THE TARGET: " in answer.sentences[1]
    assert "on plan" not in comparison.text()
    assert answer.tables != ()


def test_ruptures_that_go_back_are_reported():
    assert (
        "ruptures not matched with the plan" in found(ruptures_mm=(31.0, 11.0)).text()
    )


def test_a_log_without_joints_is_refused(tmp_path, capsys):
    log = tmp_path / "a.csv"
    log.write_text("t_s,depth_m,force_N\n0,0,0\n1,0.001,1\n")

    assert main(["report", str(log), str(tmp_path / "b"), "--plan", "p.json"]) == 2
    assert "has no joint positions and torques" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize("contents", ["{", "{}"])
def test_an_unreadable_plan_is_refused_before_the_work(tmp_path, capsys, contents):
    from needleforce.recordings import write_table
    from needleforce.simulation import signal_table
    from tests.insertion_run import short_run

    table = signal_table(short_run())
    names = ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
    write_table(tmp_path / "a.npz", {name: table[name][:500] for name in names})
    (tmp_path / "plan.json").write_text(contents)
    argv = ["report", str(tmp_path / "a.npz"), str(tmp_path / "b")]

    assert main([*argv, "--plan", str(tmp_path)]) == 2
    assert "error: " in capsys.readouterr().err
    assert not (tmp_path / "b").exists()
