"""The manager: every state and event is defined, nothing moves unguarded, events are
logged."""

import json
import resource
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needleforce import InsertionSession
from needleforce.control import Beside, Manager, SettingError, State
from needleforce.control.state_machine import (
    EVENTS,
    MOVING,
    REFUSALS,
    TABLE,
    transition,
)
from residual import SensorConfig, Status
from tests.needleforce.control.managed_session import (
    DEVICE,
    ROBOT,
    Sensor,
    at,
    inserting,
    new_manager,
    play,
    run,
)

ALL = set(REFUSALS)


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("event", EVENTS)
def test_every_state_and_event_is_defined_once(state, event):
    rules = [r for r in TABLE if r.event == event and state in r.sources.split()]
    target, refused = transition(state, event, ALL)
    nothing, why = transition(state, event, ())

    assert len(rules) <= 1
    assert bool(refused) == (not rules)
    assert target is state or not refused
    assert bool(why) == (not rules or bool(rules[0].guards))
    assert nothing is (state if why else target)


@pytest.mark.parametrize("state", State)
def test_stop_and_fault_are_possible_everywhere_and_faulted_is_left_healthy_only(state):
    is_faulted = state is State.FAULTED

    assert transition(state, "fault", ()) == (State.FAULTED, "")
    assert transition(state, "stop", ())[0] is (state if is_faulted else State.STOPPED)
    for event in EVENTS if is_faulted else ():
        assert transition(state, event, ALL - {"healthy"})[0] is state
        is_reset = event == "reset"
        assert transition(state, event, ALL)[0] is (State.IDLE if is_reset else state)


@pytest.mark.parametrize("state", sorted(MOVING))
@pytest.mark.parametrize("event", EVENTS)
@pytest.mark.parametrize("missing", ["limit", "heartbeat", "tared", "outside"])
def test_nothing_begins_to_move_without_limit_heartbeat_and_tare(state, event, missing):
    in_air = (State.GUIDANCE, State.APPROACH, State.TARE)
    is_needed = {
        "tared": state not in (State.APPROACH, State.TARE),
        "outside": state in in_air,
    }
    begun = [
        origin
        for origin in State
        if origin is not state
        and transition(origin, event, ALL - {missing}) == (state, "")
        # An insertion that has come to its end holds the tip.
        and (origin, state) != (State.INSERTION, State.DWELL)
    ]

    assert not (begun and is_needed.get(missing, True))


ACTIONS = st.sampled_from(
    (*EVENTS, "wait", "bad", "force", "tissue", "silent", "device", "late")
)


def act(manager, sensor, action):
    """One random thing that happens to a manager."""
    if action in EVENTS:
        manager.request(action)
        return

    inside = action == "tissue"
    sensor.reads(
        Status.REJECTED if action == "bad" else Status.OK,
        depth_m=0.01 if inside else -0.01,
        in_contact=inside,
        axial=3.0 if action == "force" else 0.0,
    )
    run(
        manager,
        0.03,
        DEVICE if action == "device" else Beside(),
        0.05 if action == "late" else 1e-3,
        is_alive=action != "silent",
    )


@settings(max_examples=50)
@given(st.lists(ACTIONS, max_size=30))
def test_whatever_happens_is_in_the_log_and_follows_from_it(tmp_path_factory, actions):
    path = tmp_path_factory.mktemp("log") / "events.jsonl"
    manager, sensor = new_manager(log=path)
    for action in actions:
        act(manager, sensor, action)
        situation = run(manager)
        assert sensor.tared or situation.state not in (
            State.TELEOP,
            State.INSERTION,
            State.WITHDRAW,
            State.GUIDANCE,
        )

    rows = [json.loads(line) for line in path.read_text().splitlines()]

    assert [row["to"] for row in rows] == [event.target for event in manager.events]
    assert [row["seq"] for row in rows] == list(range(len(rows)))
    assert all(first["to"] == then["from"] for first, then in pairwise(rows))
    assert all(first["t_s"] <= then["t_s"] for first, then in pairwise(rows))
    for row in rows:
        origin = State(row["from"])
        expected = transition(origin, row["event"], row["data"]["facts"])
        assert (row["to"], row["refused"]) == expected


def test_a_log_holds_the_named_fields_and_refusals(tmp_path):
    path = tmp_path / "events.jsonl"
    manager, _ = new_manager(limits=None, log=path)
    run(manager)
    with pytest.raises(SettingError, match="jump"):
        manager.request("jump")
    refused = manager.request("approach", by="someone", where=np.float64)

    assert "SafetyLimits" in refused

    (row,) = [json.loads(line) for line in path.read_text().splitlines()]

    assert list(row) == ["seq", "t_s", "from", "event", "to", "refused", "data"]
    assert (row["from"], row["to"], row["refused"]) == ("idle", "idle", refused)
    assert row["data"]["by"] == "someone"
    assert run(manager).reason == refused


def test_a_full_disk_is_reported_and_ends_the_log(tmp_path):
    with pytest.raises(OSError, match="No such file"):
        new_manager(log=tmp_path / "missing" / "log.jsonl")

    log = tmp_path / "log.jsonl"
    manager, _ = new_manager(log=log)
    run(manager)
    manager.request("approach")
    sizes = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        size = log.stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 50, sizes[1]))
        manager.request("stop")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, sizes)
    situation = run(manager)

    assert situation.state is State.STOPPED
    assert "cannot be written" in situation.reason

    manager.request("release")
    assert log.stat().st_size == size + 50
    assert [event.event for event in manager.events] == ["approach", "stop", "release"]


def test_unloggable_data_change_nothing():
    manager = inserting()[0]
    with pytest.raises(SettingError, match="stop"):
        manager.request("stop", data="\ud800")

    assert run(manager).state is State.INSERTION


TARED = {"tared": True}
INSIDE = (at(0.005, True), at(0.02, True))
OUT_AGAIN = (
    "!guide tissue",
    at(0.02, True),
    "!guide",
    at(0.003),
    "!guide",
    at(0.001),
    "guide",
)


@pytest.mark.parametrize(
    "steps",
    {
        "the entry is where contact was first met": (
            *(TARED, "insert", *INSIDE, "stop", "release"),
            *("!guide tissue", "!tare tissue", "!approach tissue"),
            *(at(0.0045, True), "!guide", at(0.0, True), "guide"),
        ),
        "of a session that begins inside it is where it comes out": (
            *(at(0.02, True, **TARED), *OUT_AGAIN),
        ),
        "a tare forgets it": (
            *(TARED, "insert", *INSIDE, at(0.0), "stop", "release", "tare", "arrived"),
            *(1e-3, at(0.05), "guide"),
        ),
        "a new zero moves it along, and stops a motion": (
            *(TARED, "insert", at(0.039), at(0.041, True), at(0.045, True)),
            *("stop", "release", at(0.0, zero="4 mm deep"), "insert", State.INSERTION),
            *({"zero": "moved in the insertion"}, State.STOPPED),
            # Its zero is not the insertion's.
            *("withdraw", State.STOPPED, "release", "!guide tissue"),
            *(at(-0.006), "guide"),
        ),
        "at another place nobody knows it": (
            *(TARED, "insert", at(0.041, True), at(-0.02), at(0.0, zero="elsewhere")),
            *(at(0.011, True), at(0.05, True), "stop", "release", "!guide tissue"),
        ),
        "at a new zero inside it is unknown": (
            *(at(0.03, True, **TARED), at(0.03, zero="elsewhere"), at(0.028)),
            *OUT_AGAIN,
        ),
        "of a session restored inside it is unknown": (
            *(at(0.03, **TARED), at(0.03, True, zero="elsewhere"), at(0.028, True)),
            *OUT_AGAIN,
        ),
        "before a valid sample it is unknown": (
            *({"tared": True, "status": Status.REJECTED}, "!approach nobody"),
            *("!guide nobody", at(0.1), 0.2, "approach", State.APPROACH),
        ),
        "a refused tare stops": (
            *(1e-3, "tare", {"refuses": True}, "arrived", State.STOPPED),
        ),
        "teleoperation needs its device, and stops without": (
            *(TARED, "!teleoperate device", DEVICE, 0.01, "teleoperate", 0.03),
            *(State.TELEOP, Beside(), State.STOPPED),
        ),
    }.items(),
    ids=lambda item: item[0],
)
def test_what_may_begin_where(steps):
    play(*new_manager(), *steps[1])


def test_a_tare_keeps_the_data_of_its_arrival():
    manager, sensor = new_manager()
    play(manager, sensor, 1e-3, "tare")
    manager.request("arrived", by="program")
    situation = run(manager, 2e-3)

    assert situation.state is State.IDLE
    assert (situation.state_s, situation.time_s) == pytest.approx((1e-3, 3e-3))
    assert manager.events[-1].data["by"] == "program"


@pytest.mark.parametrize("arrives", [False, True])
def test_a_silent_program_stops(arrives):
    """In a dwell, too: a stopped tip is held."""
    manager, _ = inserting()
    if arrives:
        assert manager.request("arrived") == ""
    run(manager, 0.2)

    assert run(manager, 0.095, is_alive=False).is_moving

    situation = run(manager, 0.01, is_alive=False)

    assert situation.state is State.STOPPED
    assert "heartbeat" in situation.reason
    assert manager.request("withdraw")


def test_a_clock_that_is_set_moves_no_time():
    manager, _ = new_manager()
    for dt_s in (-3600.0, np.nan, 0.0, 1e9, None, "x", np.ones(2), 10**400):
        assert run(manager, dt_s=dt_s).time_s < 0.01

    assert manager.update(None).time_s < 0.01


@pytest.mark.parametrize(
    "config",
    [
        {"insertion_axis": (1.0, 0.0, 0.0)},
        {"insertion_axis": (0.0, 0.0, -1.0)},
        {"frame": "lwr_link_7"},
    ],
)
def test_a_foreign_needle_axis_is_refused(config):
    sensor = Sensor()
    sensor.sensor_config = SensorConfig(**config)
    with pytest.raises(SettingError, match="tool frame"):
        Manager(sensor)


def test_a_stand_in_has_what_a_session_has():
    names = [
        name
        for name in (*vars(Sensor), "tared", "taring", "tare_refusal")
        if name[0] != "_" and name != "reads"
    ]
    assert [name for name in names if not hasattr(InsertionSession(ROBOT), name)] == []
