"""The needle against the plan: needles aside are found, none on the plan is accused."""

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from needleforce import InsertionSession, PlannedPath, session_events
from needleforce.anatomy import Layer, PlanMatch, Registration
from needleforce.control import SafetyLimits, State
from tests.insertion_run import following, insert, short_run, stopped_after, tare_index
from tests.needleforce.control.managed_session import DEVICE, inserting, play, run

ENTRY_m = np.array([0.6, 0.1, 0.2])
AXIS = np.array([0.0, 0.6, -0.8])
TARGET_m = ENTRY_m + 0.08 * AXIS
SIDE = np.array([1.0, 0.0, 0.0])


def exact(std_m=0.0):
    return PlannedPath.of_std(ENTRY_m, TARGET_m, std_m)


def test_distances_and_the_angle_are_those_of_the_two_lines():
    turned = Rotation.from_rotvec(math.radians(5.0) * SIDE).apply(AXIS)
    tip_m = ENTRY_m + 0.003 * SIDE + 0.05 * turned
    found = exact(0.2e-3).deviation(tip_m, turned)
    lengths_m = found.entry_m, found.tip_m, found.depth_m

    assert (*lengths_m, found.angle_rad) == pytest.approx(
        (
            *(3e-3, math.hypot(3e-3, 0.05 * math.sin(0.0872665))),
            *(0.05 * math.cos(math.radians(5.0)), math.radians(5.0)),
        )
    )
    assert found.is_off_plan


def test_deviations_are_those_of_the_registration_across_the_path():
    covariance = np.diag([4e-6, 0.0, 0.0, 1e-6, 0.0, 9e-6])
    registration = Registration(
        np.eye(3), np.zeros(3), covariance, ENTRY_m, np.inf, 0.0
    )
    path = PlannedPath.of_registration(registration, ENTRY_m, TARGET_m)
    at_entry = path.deviation(ENTRY_m, AXIS)
    at_target = path.deviation(TARGET_m, AXIS)

    # Across the path: 1 mm along x, and 0.6 of the 3 mm along z; 2 mrad about x, at
    # 80 mm.
    assert (
        *(at_entry.tip_std_m, at_target.entry_std_m),
        *(at_target.tip_std_m, at_target.angle_std_rad),
    ) == pytest.approx(
        (1.8e-3, 1.8e-3, math.hypot(1.8e-3, 0.16e-3), math.hypot(2e-3, 1e-3)), rel=0.01
    )


def draws(count, std_m, aside_m=0.0, turn_rad=0.0, seed=1000):
    """How many of so many insertions are off a plan that is registered with errors."""
    rng = np.random.default_rng(seed)
    found = 0
    covariance = std_m**2 * np.diag([100.0, 100.0, 100.0, 1.0, 1.0, 1.0])
    for _ in range(count):
        pivot_m = ENTRY_m + 0.05 * rng.normal(size=3)
        turn = std_m / 0.1 * rng.normal(size=3)
        shift_m = std_m * rng.normal(size=3)
        entry_m, target_m = (
            point_m + np.cross(turn, point_m - pivot_m) + shift_m
            for point_m in (ENTRY_m, TARGET_m)
        )
        path = PlannedPath(entry_m, target_m, covariance, pivot_m)
        angle = rng.uniform(0.0, 2.0 * np.pi)
        across = np.cos(angle) * SIDE + np.sin(angle) * np.cross(AXIS, SIDE)
        axis = Rotation.from_rotvec(turn_rad * across).apply(AXIS)
        tips_m = [ENTRY_m + aside_m * across + d * axis for d in (-0.01, 0.03, 0.08)]
        found += any(path.deviation(tip_m, axis).is_off_plan for tip_m in tips_m)
    return found


STD_m = 0.3e-3 / math.sqrt(3.0)
"""Along each axis, of a registration that is known to 0.3 mm."""


def test_no_needle_on_the_plan_is_accused():
    assert draws(1000, STD_m) <= 1


@pytest.mark.parametrize(
    ("aside_m", "turn_deg"), [(2e-3, 0), (5e-3, 0), (50e-3, 0), (0.0, 2), (0.0, 10)]
)
def test_needles_aside_or_turned_are_found(aside_m, turn_deg):
    assert draws(100, STD_m, aside_m, math.radians(turn_deg)) == 100


@pytest.mark.parametrize(("aside_mm", "is_off"), [(1.6, False), (2.4, True)])
def test_a_deep_tip_is_off_the_plan_beyond_3_7_of_its_own_deviations(aside_mm, is_off):
    """It is known to 1.3 mm at 80 mm, the entry to 1.0 mm."""
    turned = Rotation.from_rotvec(0.033 * np.cross(AXIS, SIDE)).apply(AXIS)
    tip_m = ENTRY_m + 1e-3 * aside_mm * SIDE + 0.08 * turned
    found = exact(1e-3).deviation(tip_m, turned)

    assert (found.tip_m, 3.7 * found.tip_std_m, found.is_off_plan) == (
        pytest.approx(1e-3 * aside_mm + 2.64e-3, abs=2e-5),
        pytest.approx(4.75e-3, abs=5e-5),
        is_off,
    )


@pytest.mark.parametrize(
    ("past_mm", "std_mm", "is_past"),
    [
        (-20.0, 0.2, False),
        (0.9, 0.2, False),
        (1.1, 0.2, True),
        (10.1, 0.2, True),
        (1.9, 1.0, False),
        (2.2, 1.0, True),
        (10.1, 6.0, False),
    ],
)
def test_past_the_target_is_said_beyond_1_mm_and_two_deviations(
    past_mm, std_mm, is_past
):
    tip_m = TARGET_m + 1e-3 * past_mm * AXIS
    found = exact(1e-3 * std_mm).deviation(tip_m, AXIS)

    assert (found.to_target_m, found.to_target_std_m) == pytest.approx(
        (-1e-3 * past_mm, 1e-3 * math.hypot(std_mm, 0.1)), rel=1e-6
    )
    assert (found.is_past_target, found.verdict == "past target") == (is_past, is_past)
    assert found.is_off_plan is False


def test_the_deviation_to_the_target_is_that_of_the_registration_along_the_path():
    # 2 mm along z, of which the axis sees 0.8, and a turn of 10 mrad about x, which
    # moves the line, 50 mm beside its pivot, by 0.5 mm along itself.
    covariance = np.diag([1e-4, 0.0, 0.0, 0.0, 0.0, 4e-6])
    pivot_m = ENTRY_m + 0.05 * np.cross(AXIS, SIDE)
    path = PlannedPath(ENTRY_m, TARGET_m, covariance, pivot_m)
    found = [path.deviation(tip_m, AXIS) for tip_m in (ENTRY_m, TARGET_m)]

    assert [each.to_target_std_m for each in found] == pytest.approx(
        [math.hypot(1.6e-3, 0.5e-3)] * 2, rel=0.01
    )


RUN = short_run()
TARE = tare_index(RUN)
SURFACE_m = float(-RUN.truth.depth_m[TARE])
MATCH = PlanMatch(
    [
        Layer("gel", 0.0, 0.026, 0.5e-3, 0.5e-3, False),
        Layer("behind", 0.026, 0.08, 0.5e-3, 0.5e-3, False),
    ],
    3e-3,
)


def along(path):
    session = InsertionSession(RUN.robot)
    session.follow(MATCH, path=path)
    return session


def estimates_along(path, count=400):
    session = along(path)
    return session, insert(session, TARE + count)


def next_estimates(session, path):
    """Of a session after 400 samples, and of another one that it is restored in."""
    again = along(path)
    again.restore(session.snapshot())
    (row,) = following(TARE + 400, 1)
    return session.update(*row), again.update(*row)


@pytest.fixture(scope="module")
def zero():
    return stopped_after(TARE).course.zero


@pytest.mark.slow
def test_off_the_plan_no_layer_is_named(zero):
    start_m, axis = zero
    across = np.cross(axis, [0.0, 1.0, 0.0])
    side = across / np.linalg.norm(across)
    entry_m = start_m + SURFACE_m * axis
    right = PlannedPath.of_std(entry_m, entry_m + 0.05 * axis, 0.2e-3)
    wrong = PlannedPath.of_std(
        entry_m + 0.05 * side, entry_m + 0.05 * (axis + side), 0.2e-3
    )
    _, on_plan = estimates_along(right)
    session, off_plan = estimates_along(wrong)

    place = off_plan[-1].plan
    one, resumed = next_estimates(session, wrong)

    assert on_plan[-1].plan.name in ("outside", "gel")
    assert not on_plan[-1].deviation.is_off_plan
    assert on_plan[-1].deviation.tip_m < 0.2e-3
    assert (place.name, place.layer, place.next_name, place.matched_name) == (
        *("off plan", -2, "", ""),
    )
    assert off_plan[-1].deviation.entry_m == pytest.approx(0.05, abs=1e-3)
    assert resumed.deviation == one.deviation


def test_before_the_tare_depth_counts_from_the_planned_entry_too(zero):
    start_m, axis = zero
    entry_m = start_m + SURFACE_m * axis
    path = PlannedPath.of_std(entry_m, entry_m + 0.05 * axis, 0.2e-3)
    session = along(path)
    estimate = insert(session, 200)[-1]

    assert not session.tared
    assert estimate.depth_in_tissue_m == pytest.approx(
        estimate.deviation.depth_m, abs=2e-3
    )


@pytest.mark.parametrize(
    ("std_mm", "aside_mm", "verdict"),
    [
        (0.2, 0.0, "on plan"),
        (1.2, 0.0, "on plan"),
        (2.6, 0.0, "cannot tell"),
        (1.2, 3.0, "cannot tell"),
        (0.2, 3.0, "off plan"),
    ],
)
def test_on_plan_is_not_said_where_nobody_can_tell(std_mm, aside_mm, verdict):
    # The path may be missed by 5 mm: what is measured and two deviations must stay
    # within.
    found = exact(1e-3 * std_mm).deviation(
        ENTRY_m + 0.02 * AXIS + 1e-3 * aside_mm * SIDE, AXIS
    )

    assert found.verdict == verdict


def test_a_needle_near_the_target_whose_depth_nobody_knows_cannot_be_told():
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = (3e-3) ** 2 * np.outer(AXIS, AXIS)
    path = PlannedPath(ENTRY_m, TARGET_m, covariance, ENTRY_m)

    assert path.deviation(ENTRY_m + 0.02 * AXIS, AXIS).verdict == "on plan"
    assert path.deviation(TARGET_m, AXIS).verdict == "cannot tell"


@pytest.fixture(scope="module")
def past_target_run():
    """A session whose target lies behind where the needle is, from the start."""
    start_m, axis = stopped_after(TARE).course.zero
    path = PlannedPath.of_std(start_m - 0.20 * axis, start_m - 0.15 * axis, 0.2e-3)
    return *estimates_along(path), path


def test_past_the_target_is_one_event_and_is_said_in_the_scene(past_target_run):
    session, estimates, path = past_target_run
    (told,) = [event for one in estimates for event in session_events(one)]
    _, resumed = next_estimates(session, path)

    assert told.kind == "past_target"
    assert told.values["to_target_m"] < -1e-3
    assert not estimates[-1].deviation.is_off_plan
    assert estimates[-1].plan.name != "off plan"
    assert resumed.plan_events == ()


LEFT_PLAN = {
    "OFF PLAN": exact(0.2e-3).deviation(ENTRY_m + 5e-3 * SIDE, AXIS),
    "PAST TARGET": exact(0.2e-3).deviation(TARGET_m + 3e-3 * AXIS, AXIS),
}
WAYS = {
    State.INSERTION: (State.INSERTION,),
    State.TELEOP: ("arrived", DEVICE, 0.01, "teleoperate", 0.01),
    State.WITHDRAW: ("arrived", "withdraw", 0.01),
}


@pytest.mark.parametrize(
    ("verdict", "state", "is_told", "is_stopped"),
    [
        ("OFF PLAN", State.INSERTION, True, True),
        ("OFF PLAN", State.TELEOP, True, True),
        ("OFF PLAN", State.WITHDRAW, True, False),
        ("OFF PLAN", State.INSERTION, False, False),
        ("PAST TARGET", State.INSERTION, False, True),
        ("PAST TARGET", State.TELEOP, False, False),
        ("PAST TARGET", State.TELEOP, True, True),
        ("PAST TARGET", State.WITHDRAW, True, False),
    ],
)
def test_an_advance_that_has_left_the_plan_is_stopped(
    verdict, state, is_told, is_stopped
):
    limits = SafetyLimits(axial_N=2.0, stop_off_plan=is_told)
    manager, sensor = inserting(limits=limits)
    play(manager, sensor, *WAYS[state])
    sensor.estimate = sensor.estimate._replace(deviation=LEFT_PLAN[verdict])
    situation = run(manager, 0.01, DEVICE)

    assert situation.state is (State.STOPPED if is_stopped else state)
    assert (verdict in situation.reason) is is_stopped


def test_what_is_said_of_a_needle_beside_its_plan_is_its_deviation():
    tip_m = ENTRY_m + 5e-3 * SIDE + 0.03 * AXIS
    manager, sensor = inserting(limits=SafetyLimits(axial_N=2.0, stop_off_plan=True))
    deviation = exact(0.2e-3).deviation(tip_m, AXIS)
    sensor.estimate = sensor.estimate._replace(deviation=deviation)
    reason = run(manager, 0.01).reason

    # At the entry, at the tip, the angle, and the way that is left, each ± deviation.
    assert re.findall(r"\d+\.\d", reason) == [
        *("5.0", "0.2", "5.0", "0.2", "0.0", "0.1", "50.0", "0.2"),
    ]
