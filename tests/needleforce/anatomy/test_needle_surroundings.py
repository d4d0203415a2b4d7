"""Where the needle comes too near: one event, said alike everywhere, autonomy stops."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.cli.arms.arm_watch import describe_values
from needleforce.cli.logs.plan_found import add_place_on_plan
from needleforce.cli.logs.result import Result
from needleforce.control.monitors import Monitors, SafetyLimits
from needleforce.control.state_machine import State
from needleforce.needle_on_plan import (
    PlannedPath,
    describe_clearances,
    describe_deviation,
    state_values,
)
from needleforce.plan_follower import PlanFollower
from needleforce.ros2.reports import plan_reports
from needleforce.scene.insertion_card import card_html
from needleforce.scene.nodes import PlanScene
from needleforce.scene.words import find_banner
from tests.needleforce.anatomy.test_path import (
    TURN,
    PLANNED_m,
    surroundings,
    to_robot,
)

AXIS = np.array([0.0, 0.0, 1.0])
ENTRY_m, TARGET_m = PLANNED_m


def test_too_near_is_one_event_stops_autonomy_and_is_said_everywhere():
    around = surroundings()
    path = PlannedPath.of_std(to_robot(ENTRY_m), to_robot(TARGET_m), 0.1e-3)
    follower = PlanFollower(None, path, around)
    events = []
    for aside_mm in (0.0, 13.0, 14.0, 14.2, 13.0):
        pose = np.eye(4)
        pose[:3, 3] = to_robot(np.array([0.04 + 1e-3 * aside_mm, 0.04, 0.045]))
        pose[:3, :3] = TURN.as_matrix()
        follower.compare_with(SimpleNamespace(pose=pose, axis_in_tool=AXIS))
        events.append([event.kind for event in follower.take_events()])

    assert events == [[], [], ["too_near"], [], []]


def estimate_of(deviation, clearances):
    """What a session says of a needle that is where it is."""
    identification = SimpleNamespace(
        rupture=None,
        retracted=None,
        hard_contact=None,
        identified_layer=None,
        tip_force_N=0.5,
        tip_force_std_N=0.1,
        shaft_friction_N=0.1,
        enhanced_force_N=0.7,
        layer=1,
    )
    return SimpleNamespace(
        time_s=1.0,
        depth_m=0.04,
        depth_in_tissue_m=None,
        speed_m_s=0.0,
        status=SimpleNamespace(value="ok"),
        wrench=SimpleNamespace(axial=1.0, axial_std=0.1, message=""),
        identification=identification,
        plan=None,
        plan_events=(),
        deviation=deviation,
        clearances=clearances,
    )


@pytest.mark.parametrize(
    ("aside_mm", "std_mm", "depth_mm", "verdict", "too_near"),
    [
        (0.0, 0.1, 45.0, "on plan", ""),
        # The plan passes the vessel at 3.5 mm, so it may be 2.5 mm near; the rib,
        # further away, may be 6 mm near, and is 5.8 mm.
        (-0.7, 0.3, 45.0, "too near", "the needle passes rib_left_7 at 5.8 ± 0.5 mm"),
        (-0.7, 0.3, 10.0, "too near", "the way ahead passes rib_left_7 at 5.8 ± 0.5"),
        (0.0, 4.0, 45.0, "cannot tell", ""),
        (0.0, 0.1, 75.0, "past target", ""),
        (3.0, 0.1, 45.0, "off plan", "the needle passes portal_vein at 0.5 ± 0.5 mm"),
    ],
)
def test_live_scene_report_json_and_ros_say_the_same(
    aside_mm, std_mm, depth_mm, verdict, too_near
):
    around = surroundings(gap_mm=4, rib_mm=7)
    path = PlannedPath.of_std(to_robot(ENTRY_m), to_robot(TARGET_m), 1e-3 * std_mm)
    tip_m = to_robot(ENTRY_m + 1e-3 * np.array([aside_mm, 0.0, depth_mm]))
    axis = TURN.apply(AXIS)
    deviation = path.deviation(tip_m, axis)
    clearances = around.clearances(tip_m, axis)
    estimate = estimate_of(deviation, clearances)

    json = state_values(deviation, clearances)
    assert json["verdict"] == verdict
    assert set(json["clearances"]) == {"portal_vein", "rib_left_7"}

    live = " ".join(describe_values(estimate, None))
    for text in (
        describe_deviation(deviation),
        describe_clearances(clearances),
        too_near,
    ):
        assert text in live
    assert ("TOO NEAR" in live) is bool(too_near)

    (ros,) = plan_reports("needle", estimate)
    assert ros.values["verdict"] == verdict
    assert too_near in ros.message
    assert (ros.level == 0) is (verdict == "on plan")
    for name, one in json["clearances"].items():
        for key in one.keys() - {"is_too_near"}:
            assert float(ros.values[f"clearance/{name}/{key}"]) == pytest.approx(
                one[key], rel=1e-3
            )

    assert find_banner(estimate) == ("" if verdict == "on plan" else verdict)
    plan = PlanScene(
        (), (), to_robot(ENTRY_m), to_robot(TARGET_m), watched=around.names
    )
    card = card_html(estimate, None, plan)
    part = "its way ahead" if clearances[0].is_ahead else "the needle"
    for text in (f"{1e3 * clearances[0].distance_m:.1f} ± 0.5 mm", f"from {part}"):
        assert text in card
    assert ("TOO NEAR: " in card) is bool(too_near)

    found = Result(log="log", title="Plan")
    doubts = add_place_on_plan(found, deviation, clearances, 0.0)
    assert any(too_near in text for text in ["", *doubts])
    assert any(describe_deviation(deviation) in text for text in found.sentences)
    assert f'"verdict": "{verdict}"'.encode() in found.files["needle_on_plan.json"]

    monitors = Monitors.__new__(Monitors)
    monitors._limits = SafetyLimits(axial_N=100.0)
    for state in (State.INSERTION, State.TELEOP):
        monitors._state = state
        is_stopped = bool(monitors._check_plan(estimate))
        is_wrong = bool(too_near) or verdict == "past target"
        assert is_stopped is (is_wrong and state is State.INSERTION)
