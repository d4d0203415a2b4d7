"""The manager: every state and event is defined, nothing moves unguarded, events are
logged."""

import json
import resource
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
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
    go_to,
    inserting,
    new_manager,
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


def test_a_new_zero_of_depth_stops_motions():
    """A new zero of depth moves the entry with it, and stops a motion."""
    manager, sensor = inserting()
    for depth_m, in_contact in ((0.039, False), (0.041, True), (0.045, True)):
        go_to(manager, sensor, depth_m, in_contact)

    manager.request("stop")
    manager.request("release")
    sensor.zero = "4 mm deep"
    sensor.reads(depth_m=0.0)

    assert manager.request("insert") == ""
    assert run(manager).state is State.INSERTION  # begun at the new zero

    sensor.zero = "moved in the insertion"

    assert run(manager).state is State.STOPPED
    assert manager.request("withdraw") == ""
    assert run(manager).state is State.STOPPED  # its zero is not the insertion's

    manager.request("release")

    assert "in tissue" in manager.request("guide")

    go_to(manager, sensor, -0.006)

    assert manager.request("guide") == ""


def test_at_another_place_nobody_knows_where_tissue_begins():
    manager, sensor = inserting()
    for depth_m, in_contact in ((0.041, True), (-0.02, False)):
        go_to(manager, sensor, depth_m, in_contact)

    sensor.zero = "above another place"
    for depth_m, in_contact in ((0.0, False), (0.011, True), (0.05, True)):
        go_to(manager, sensor, depth_m, in_contact)

    for event in ("stop", "release"):
        manager.request(event)

    assert "in tissue" in manager.request("guide")


@pytest.mark.parametrize("is_restored", [True, False])
def test_inside_at_a_new_zero_entry_is_unknown(is_restored):
    """Inside tissue at a new zero, the entry is unknown until the tip is out."""
    manager, sensor = new_manager()
    sensor.tared = True
    go_to(manager, sensor, 0.03, in_contact=not is_restored)
    sensor.zero = "elsewhere"
    for depth_m in (0.03, 0.028):
        go_to(manager, sensor, depth_m, in_contact=is_restored)

    for depth_m, in_contact in ((0.02, True), (0.003, False), (0.001, False)):
        assert "in tissue" in manager.request("guide")
        go_to(manager, sensor, depth_m, in_contact)

    assert manager.request("guide") == ""  # it has come out


def test_before_a_valid_sample_position_is_unknown():
    """Until a valid sample has come, the needle may be anywhere: no approach."""
    manager, sensor = new_manager()
    sensor.tared = True
    sensor.reads(Status.REJECTED)
    run(manager, 3e-3)

    assert "nobody knows" in manager.request("approach")
    assert "nobody knows" in manager.request("guide")

    sensor.reads(depth_m=0.1)
    run(manager, 0.2)

    assert manager.request("approach") == ""
    assert run(manager, 0.1).state is State.APPROACH


def test_the_entry_is_where_contact_was_first_met():
    manager, sensor = inserting()
    for depth_m in (0.005, 0.02):
        go_to(manager, sensor, depth_m, in_contact=True)
    for event in ("stop", "release"):
        assert manager.request(event) == ""
    for event in ("guide", "tare", "approach"):
        assert "in tissue" in manager.request(event)
    for depth_m, is_refused in ((0.0045, True), (0.0, False)):
        go_to(manager, sensor, depth_m, in_contact=True)
        assert bool(manager.request("guide")) == is_refused


def test_the_entry_of_a_session_that_begins_inside_is_where_it_comes_out():
    manager, sensor = new_manager()
    sensor.tared = True
    for depth_m, in_contact in ((0.02, True), (0.003, False), (0.001, False)):
        go_to(manager, sensor, depth_m, in_contact)
        assert bool(manager.request("guide")) == (depth_m > 0.002)


def test_a_tare_forgets_the_entry():
    manager, sensor = inserting()
    go_to(manager, sensor, 0.02, in_contact=True)
    go_to(manager, sensor, 0.0)
    for event in ("stop", "release", "tare", "arrived"):
        assert manager.request(event) == ""
        run(manager)
    go_to(manager, sensor, 0.05)

    assert manager.request("guide") == ""


def test_a_refused_tare_stops():
    manager, sensor = new_manager()
    run(manager)
    manager.request("tare")
    sensor.refuses = True
    manager.request("arrived")
    situation = run(manager)

    assert situation.state is State.STOPPED
    assert "contact" in situation.reason


def test_a_tare_keeps_the_data_of_its_arrival():
    manager, _ = new_manager()
    run(manager)
    manager.request("tare")
    manager.request("arrived", by="program")
    situation = run(manager, 2e-3)

    assert situation.state is State.IDLE
    assert (situation.state_s, situation.time_s) == pytest.approx((1e-3, 3e-3))
    assert manager.events[-1].data["by"] == "program"


def test_teleoperation_needs_its_device_and_stops_without():
    manager, _ = inserting()

    assert manager.request("arrived") == ""
    assert "no haptic device" in manager.request("teleoperate")

    run(manager, 0.01, DEVICE)

    assert manager.request("teleoperate") == ""
    assert run(manager, 0.03, DEVICE).state is State.TELEOP

    situation = run(manager)

    assert situation.state is State.STOPPED
    assert "haptic device" in situation.reason


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


def test_the_page_shows_the_table_as_it_is():
    page = Path(__file__).resolve().parents[3] / "docs" / "reference" / "control.md"
    rows = [line.strip("| ").split(" | ") for line in page.read_text().splitlines()]
    for rule in TABLE:
        assert [rule.event, rule.sources, rule.target, rule.guards or "–"] in rows
