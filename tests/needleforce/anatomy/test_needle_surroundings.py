"""Where the needle comes too near: one event, said alike everywhere, autonomy stops."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleforce import PlannedPath
from needleforce.cli.logs.plan_found import add_place_on_plan
from needleforce.cli.logs.result import Result
from needleforce.control import SafetyLimits, State
from needleforce.control.monitors import Monitors
from needleforce.needle_on_plan import (
    describe_clearances,
    describe_deviation,
    state_values,
)
from needleforce.plan_follower import PlanFollower
from needleforce.ros2.reports import plan_reports
from needleforce.scene import PlanScene
from needleforce.scene.insertion_card import card_html
from needleforce.scene.words import describe_state, find_banner
from tests.needleforce.anatomy.test_path import (
    TURN,
    PLANNED_m,
    surroundings,
    to_robot,
)
from tests.needleforce.scene.insertions import tick

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
    estimate = tick(1.0, 0.04, deviation=deviation, clearances=clearances)
    live = " ".join(describe_state(estimate))
    json = state_values(deviation, clearances)
    (ros,) = plan_reports("needle", estimate)
    scene = PlanScene((), (), path.entry_m, path.target_m, watched=around.names)
    card = card_html(estimate, None, scene)
    report = Result(log="log", title="Plan")
    doubts = add_place_on_plan(report, deviation, clearances, 0.0)

    watched = {"portal_vein", "rib_left_7"}
    assert (json["verdict"], {*json["clearances"]}) == (verdict, watched)
    numbers = {
        f"clearance/{name}/{key}": one[key]
        for name, one in json["clearances"].items()
        for key in one.keys() - {"is_too_near"}
    }
    assert {key: float(ros.values[key]) for key in numbers} == pytest.approx(
        numbers, rel=1e-3
    )
    is_right = verdict == "on plan"
    said = (ros.values["verdict"], ros.level == 0, find_banner(estimate))
    assert said == (verdict, is_right, "" if is_right else verdict)
    place = describe_deviation(deviation)
    part = "its way ahead" if clearances[0].is_ahead else "the needle"
    for text, words in (
        *((text, live) for text in (place, describe_clearances(clearances), too_near)),
        (f"{1e3 * clearances[0].distance_m:.1f} ± 0.5 mm", card),
        (f"from {part}", card),
        (too_near, ros.message),
        (too_near, "".join(doubts)),
        (place, "".join(report.sentences)),
        (f'"verdict": "{verdict}"', report.files["needle_on_plan.json"].decode()),
    ):
        assert text in words
    assert ["TOO NEAR" in live, "TOO NEAR: " in card] == [bool(too_near)] * 2

    monitors = Monitors.__new__(Monitors)
    monitors._limits = SafetyLimits(axial_N=100.0)
    for state in (State.INSERTION, State.TELEOP):
        monitors._state = state
        is_wrong = bool(too_near) or verdict == "past target"
        is_stopped = is_wrong and state is State.INSERTION
        assert bool(monitors._check_plan(estimate)) is is_stopped
