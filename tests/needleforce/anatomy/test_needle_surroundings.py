"""Where the needle comes too near: one event, said alike everywhere, autonomy stops."""

from types import SimpleNamespace

import numpy as np

from needleforce.control.monitors import Monitors, SafetyLimits
from needleforce.control.state_machine import State
from needleforce.needle_on_plan import (
    PlannedPath,
)
from needleforce.plan_follower import PlanFollower
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
        tool = SimpleNamespace(pose=pose, axis_in_tool=AXIS)
        follower.compare_with(tool)
        events.append([event.kind for event in follower.take_events()])
        if aside_mm == 14.2:
            clearances = follower.clearances

    assert events == [[], [], ["too_near"], [], []]

    on_plan = path.deviation(to_robot(TARGET_m), TURN.apply(AXIS))
    estimate = SimpleNamespace(deviation=on_plan, clearances=clearances)
    for state, is_stopped in ((State.INSERTION, True), (State.TELEOP, False)):
        monitors = Monitors.__new__(Monitors)
        monitors._limits = SafetyLimits(axial_N=100.0)
        monitors._state = state
        assert bool(monitors._check_plan(estimate)) is is_stopped
