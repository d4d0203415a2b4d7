"""The program of an insertion: what counts as a rupture, how a stretched arm stops
behind it."""

from types import SimpleNamespace

import numpy as np
import pytest

from identification.estimate import RuptureState
from needleforce.control import (
    InsertionPlan,
    InsertionProfile,
    SettingError,
    State,
)
from needleforce.control.rupture_counter import RuptureCounter
from needleforce.control.state_machine import MOVING

DT = 1e-3
SPEED_M_S = 5e-3
TARGETS = {"approach": State.APPROACH, "tare": State.TARE, "insert": State.INSERTION}


def identified(
    in_contact=True,
    state=RuptureState.NO_RUPTURE,
    alarm_N=None,
    alarm_m=1.0,
    provisional_N=None,
):
    rupture, provisional = (
        None if force_N is None else SimpleNamespace(force_N=force_N, depth_m=alarm_m)
        for force_N in (alarm_N, provisional_N)
    )
    return SimpleNamespace(
        in_contact=in_contact,
        rupture_state=state,
        rupture=rupture,
        provisional=provisional,
    )


def counted(before_N, fall_N, steady=True, alarm_N=None, beat_N=0.0, **how):
    """Layers left after a force that has grown for three seconds falls within 20 ms."""
    ruptures = RuptureCounter()
    rng = np.random.default_rng(0)
    for k in range(3100):
        force_N = before_N * min(k / 3000.0, 1.0) - fall_N * min(
            max(k - 3000, 0) / 20.0, 1.0
        )
        noisy_N = (
            force_N + 0.005 * rng.standard_normal() + beat_N * np.sin(8.0 * k * DT)
        )
        identification = identified(alarm_N=alarm_N if k == 3030 else None, **how)
        ruptures.update(identification, noisy_N, 5e-6 * k, DT, is_steady=steady)

    return ruptures.count


@pytest.mark.parametrize(
    ("before_N", "fall_N", "how", "count"),
    [
        (2.0, 1.0, {}, 1),
        (2.0, 1.0, {"steady": False}, 0),  # a needle that brakes
        (2.0, 1.0, {"steady": False, "alarm_N": 2.0}, 1),
        (2.0, 0.07, {}, 0),
        (4.0, 0.10, {}, 0),  # less than 3 % of the force
        (4.0, 0.17, {}, 1),
        (2.0, 0.07, {"state": RuptureState.EXPECTED}, 1),
        (2.0, 0.0, {"beat_N": 0.2}, 0),  # heartbeats
        (2.0, 0.1, {"beat_N": 0.2, "state": RuptureState.EXPECTED}, 0),
        (2.0, 1.0, {"beat_N": 0.2}, 1),
        (0.2, 0.07, {}, 0),  # an error of the force
        (0.2, 0.2, {"in_contact": False}, 0),  # the start of the motion
    ],
)
def test_unexplained_falls_of_force_are_ruptures(before_N, fall_N, how, count):
    """A fall of the force is a rupture where nothing else explains it."""
    assert counted(before_N, fall_N, **how) == count


@pytest.mark.parametrize(("times", "count"), [(1.7, 0), (2.3, 1)])
def test_a_rupture_falls_twice_as_far_as_ordinary(times, count):
    """Falls of 0.1 N four times a second are ordinary; the last is larger."""
    ruptures = RuptureCounter()
    state = RuptureState.EXPECTED
    for k in range(3100):
        fall_N = 0.1 * (times if k >= 3000 else 1.0)
        phase = k % 250
        fallen = phase / 20.0 if phase < 20 else (250 - phase) / 230.0
        force_N = 2.0 - fall_N * fallen
        ruptures.update(identified(state=state), force_N, 5e-6 * k, DT, is_steady=True)

    assert ruptures.count == count


@pytest.mark.parametrize(("uses_provisional", "count"), [(False, 0), (True, 1)])
def test_provisional_alarms_count_where_the_caller_asks(uses_provisional, count):
    """Without them only the confirmed alarm of a needle that may brake counts."""
    ruptures = RuptureCounter(uses_provisional=uses_provisional)
    for k in range(3031):
        force_N = 2.0 * min(k / 3000.0, 1.0) - max(k - 3000, 0) / 30.0
        identification = identified(provisional_N=2.0 if k == 3020 else None)
        ruptures.update(identification, force_N, 5e-6 * k, DT, is_steady=False)
    assert ruptures.count == count

    ruptures.update(
        identified(alarm_N=2.0, alarm_m=0.015), 1.0, 0.0152, DT, is_steady=False
    )
    assert ruptures.count == 1


@pytest.mark.parametrize(("fall_N", "count"), [(0.10, 0), (0.19, 1)])
def test_in_the_first_second_a_rupture_falls_by_more_than_15_pct(fall_N, count):
    """No heartbeat is known yet; the force is 0.9 N after 0.7 s."""
    ruptures = RuptureCounter()
    for k in range(800):
        force_N = 0.9 * min(k / 600.0, 1.0) - fall_N * min(max(k - 700, 0) / 20.0, 1.0)
        ruptures.update(identified(), force_N, 5e-6 * k, DT, is_steady=True)

    assert ruptures.count == count


@pytest.mark.parametrize(("after_s", "count"), [(0.9, 1), (1.4, 2)])
def test_for_a_second_after_a_rupture_a_small_fall_is_none(after_s, count):
    """A fall by a tenth of 2 N counts once heartbeats can be told again."""
    ruptures = RuptureCounter()
    for k in range(3100 + round(1e3 * after_s)):
        fallen_N = 2.0 * min(max(k - 3000, 0) / 20.0, 1.0)
        again_N = 0.2 * min(max(k - 3000 - 1e3 * after_s, 0.0) / 20.0, 1.0)
        force_N = 4.0 * min(k / 2800.0, 1.0) - fallen_N - again_N
        ruptures.update(identified(), force_N, 5e-6 * k, DT, is_steady=True)

    assert ruptures.count == count


@pytest.mark.parametrize(("apart_m", "count"), [(2.5e-3, 1), (3.5e-3, 2)])
def test_ruptures_less_than_3_mm_apart_are_one(apart_m, count):
    ruptures = RuptureCounter()
    for depth_m in (0.02, 0.02 + apart_m):
        for k in range(1000):
            identification = identified(
                alarm_N=None if k < 999 else 2.0, alarm_m=depth_m
            )
            ruptures.update(identification, 1.0, depth_m, DT, is_steady=False)

    assert ruptures.count == count


def test_a_late_alarm_is_no_second_rupture():
    """A late alarm of a rupture that was counted does not count again."""
    ruptures = RuptureCounter()
    is_counted = []
    for k in range(5000):
        force_N = 2.0 * min(k / 3000.0, 1.0) - (k > 3000)
        identification = (
            identified(alarm_N=2.0, alarm_m=0.015) if k == 4000 else identified()
        )
        is_counted.append(
            ruptures.update(identification, force_N, 5e-6 * k, DT, is_steady=True)
        )

    assert np.flatnonzero(is_counted) == pytest.approx([3001], abs=5)


def test_a_fall_after_a_gap_is_no_rupture():
    """A force that falls directly after a gap in the samples is no rupture."""
    for gap_s, event in ((0.0, "rupture"), (3e-3, "")):
        profile = InsertionProfile(InsertionPlan(speed_m_s=5e-3, depth_m=0.1, layer=1))
        events = []
        for k in range(3050):
            axial_N = 2.0 * min(k / 3000.0, 1.0) - (k > 3000)
            situation = make_situation(
                State.INSERTION, 5e-6 * k, k, 5.0 + k * DT, axial_N
            )
            situation.time_s += gap_s * (k > 3000)
            events.append(profile.update(situation).event)
        assert max(events) == event


def test_a_reading_that_is_no_number_is_skipped():
    ruptures = RuptureCounter()
    for k in range(3100):
        fallen = k > 3030
        force_N = np.nan if k == 100 else 2.0 * min(k / 3000.0, 1.0) - fallen
        is_counted = ruptures.update(
            identified(), force_N, 5e-6 * k, DT, is_steady=True
        )
        assert k > 3000 or not is_counted

    assert ruptures.count == 1


@pytest.mark.parametrize("approach_m", [0.0, 3e-3])
def test_a_stroke_begins_where_its_state_begins(approach_m):
    plan = InsertionPlan(speed_m_s=5e-3, depth_m=0.01, approach_m=approach_m)
    profile = InsertionProfile(plan)
    depth_m = -0.03
    state_s = 0.0
    state = State.IDLE
    entered = {}
    for k in range(1, 9500):
        state_s += DT
        situation = make_situation(state, depth_m, k, state_s)
        situation.is_moving = state in MOVING
        step = profile.update(situation)
        depth_m += DT * step.speed_m_s
        assert abs(step.speed_m_s) < 0.05
        if step.event:  # as the manager answers
            state = State.IDLE if step.event == "arrived" else TARGETS[step.event]
            entered[state] = depth_m
            state_s = 0.0

    assert entered[State.TARE] == pytest.approx(-0.03 + approach_m, abs=1e-4)
    assert entered[State.INSERTION] == pytest.approx(-0.03 + approach_m, abs=1e-4)


@pytest.mark.parametrize("wrong", [{"layer": 1.5}, {"layer": 0}, {"depth_m": np.nan}])
def test_a_plan_that_never_ends_is_refused(wrong):
    with pytest.raises(SettingError, match=next(iter(wrong))):
        InsertionPlan(**{"speed_m_s": 5e-3, "depth_m": 0.01} | wrong)


def make_situation(state, depth_m, k, state_s, axial_N=2.0, **kind):
    wrench = SimpleNamespace(axial_unsmoothed=axial_N)
    estimate = SimpleNamespace(
        depth_m=depth_m, wrench=wrench, identification=identified(**kind)
    )
    moving = state in (State.TARE, State.INSERTION)
    return SimpleNamespace(
        state=state, state_s=state_s, time_s=k * DT, is_moving=moving, estimate=estimate
    )


@pytest.mark.parametrize(
    ("states", "offered"),
    [
        ("idle approach approach idle tare tare idle insertion idle", "aatai"),
        ("idle idle idle", "a"),  # refused
        ("idle approach idle idle", "a"),  # released half-way
        ("idle approach stopped idle idle", "a"),
        ("idle stopped idle idle", "a"),  # stopped in the very cycle
        ("stopped idle idle", ""),
        (
            "idle approach approach idle tare tare stopped idle",
            "aata",
        ),  # the tare was refused
        ("guidance idle approach approach idle", "aat"),
    ],
)
def test_a_program_continues_as_planned_or_ends(states, offered):
    """What is refused, released or stopped ends the program."""
    plan = InsertionPlan(speed_m_s=0.01, depth_m=0.1, approach_m=0.02, stroke_s=1.0)
    profile = InsertionProfile(plan)
    events = []
    names = states.split()
    for k, (last_name, name) in enumerate(zip(["", *names], names, strict=False)):
        situation = make_situation(
            State(name), 0.0, k, 5.0 if name == last_name else 0.0
        )
        events.append(profile.update(situation).event)

    assert "".join(event[:1] for event in events if event) == offered


def test_holding_is_no_faster_than_planned():
    """A needle above its zero is withdrawn; holding keeps the planned speed limit."""
    profile = InsertionProfile(
        InsertionPlan(speed_m_s=SPEED_M_S, depth_m=0.05, layer=np.int64(1))
    )

    assert profile.update(make_situation(State.WITHDRAW, -0.035, 1, 1.0)) == (
        0.0,
        "arrived",
    )

    profile.update(make_situation(State.INSERTION, 0.025, 2, 1.0))

    assert (
        profile.update(make_situation(State.DWELL, 0.0, 3, 0.0)).speed_m_s <= SPEED_M_S
    )


def test_the_force_of_starting_is_no_rupture():
    """The force with which an arm accelerates is no rupture."""
    profile = InsertionProfile(InsertionPlan(speed_m_s=0.02, depth_m=0.1, layer=1))
    depth_m = 0.0
    events = {}
    for k in range(1500):
        axial_N = 0.8 * (20 < k < 200 or 1000 < k < 1200)  # it accelerates for 200 ms
        step = profile.update(
            make_situation(State.INSERTION, depth_m, k, k * DT, axial_N)
        )
        depth_m += DT * step.speed_m_s
        if step.event:
            events.setdefault(step.event, k)

    assert events["rupture"] == pytest.approx(1205, abs=10)


def test_a_jerk_of_the_arm_is_no_rupture():
    profile = InsertionProfile(InsertionPlan(speed_m_s=5e-3, depth_m=0.1, layer=1))
    depth_m = 0.0
    for k in range(6000):
        axial_N = 2.9 + 0.5 * (k % 1000 in (998, 999))  # 1.6 m/s² for two samples
        step = profile.update(
            make_situation(State.INSERTION, depth_m, k, k * DT, axial_N)
        )
        depth_m += DT * step.speed_m_s
        assert step.event == ""


def test_after_a_rupture_the_tip_is_held():
    """After a rupture the command returns to the tip, then holds it."""
    profile = InsertionProfile(
        InsertionPlan(speed_m_s=SPEED_M_S, depth_m=0.05, layer=1)
    )
    asked_m = tip_m = 0.0
    for k in range(1000):
        step = profile.update(make_situation(State.INSERTION, tip_m, k, k * DT))
        asked_m += DT * step.speed_m_s
        tip_m = asked_m - min(0.5e-3, 0.2 * asked_m)  # stretched by half a millimetre

    step = profile.update(
        make_situation(State.INSERTION, tip_m, 1000, 1.0, alarm_N=9.0)
    )

    assert step.event == "rupture"

    speeds = [step.speed_m_s]
    for k in range(1001, 1200):
        asked_m += DT * speeds[-1]
        speeds.append(
            profile.update(make_situation(State.DWELL, tip_m, k, 1e-3)).speed_m_s
        )

    assert min(speeds) < -0.01
    assert asked_m == pytest.approx(tip_m, abs=5e-5)
    assert speeds[-1] == 0.0

    back = profile.update(make_situation(State.DWELL, tip_m - 1e-4, 1200, 2e-3))

    assert back.speed_m_s == pytest.approx(5e-4)
    assert (
        profile.update(make_situation(State.STOPPED, tip_m, 1201, 0.0)).speed_m_s == 0.0
    )
