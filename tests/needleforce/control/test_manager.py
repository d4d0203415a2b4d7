"""The manager: every state and event is defined, nothing moves unguarded, logs
replay."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth.rig_arm import ArmSample
from needleforce import InsertionSession
from needleforce.control.errors import SettingError
from needleforce.control.event_log import read_events, replay, write_mcap
from needleforce.control.manager import Manager
from needleforce.control.monitors import Beside
from needleforce.control.state_machine import (
    EVENTS,
    MOVING,
    REFUSALS,
    TABLE,
    State,
    transition,
)
from residual import SensorConfig, Status
from tests.needleforce.control.managed_session import (
    ROBOT,
    Sensor,
    inserting,
    new_manager,
    run,
)

ALL = set(REFUSALS)


def test_faulted_is_left_by_reset_when_healthy_only():
    for event in EVENTS:
        assert transition(State.FAULTED, event, ALL - {"healthy"})[0] is State.FAULTED
        target, _ = transition(State.FAULTED, event, ALL)
        assert target is (State.IDLE if event == "reset" else State.FAULTED)


@given(
    st.lists(
        st.tuples(st.sampled_from(EVENTS), st.sets(st.sampled_from(sorted(REFUSALS))))
    )
)
def test_nothing_moves_without_limit_heartbeat_and_tare(steps):
    state = State.IDLE
    for event, facts in steps:
        origin = state
        state, refused = transition(origin, event, facts)
        assert not refused or state is origin
        if state in MOVING and state is not origin:
            assert {"limit", "heartbeat"} <= facts
            assert "tared" in facts or state in (State.APPROACH, State.TARE)
            assert "outside" in facts or state not in (
                State.GUIDANCE,
                State.APPROACH,
                State.TARE,
            )


ACTIONS = st.one_of(
    st.sampled_from(EVENTS),
    st.sampled_from(
        ("wait", "bad", "force", "tissue", "air", "silent", "device", "late")
    ),
)


def act(manager, sensor, action):
    """One random thing that happens to a manager."""
    if action in EVENTS:
        manager.request(action)
        return

    wrench = {"axial": 3.0 if action == "force" else 0.0}
    status = Status.REJECTED if action == "bad" else Status.OK
    inside = action == "tissue"
    sensor.reads(status, depth_m=0.01 if inside else -0.01, in_contact=inside, **wrench)
    sample = ArmSample(0.05 if action == "late" else 1e-3, *[np.zeros(7)] * 3)
    for _ in range(30):
        if action != "silent":
            manager.heartbeat()
        manager.update(sample, Beside(has_device=action == "device"))


@given(st.lists(ACTIONS, max_size=30))
def test_a_log_replays_to_the_same_states(tmp_path_factory, actions):
    path = tmp_path_factory.mktemp("log") / "events.jsonl"
    manager, sensor = new_manager(log=path)
    for action in actions:
        act(manager, sensor, action)
        situation = run(manager)
        untared = situation.state in (
            State.TELEOP,
            State.INSERTION,
            State.WITHDRAW,
            State.GUIDANCE,
        )
        assert sensor.tared or not untared

    events = read_events(path) if actions and path.exists() else manager.events

    assert events == manager.events

    write_mcap(events, path.with_suffix(".mcap"))

    assert read_events(path.with_suffix(".mcap")) == events
    assert replay(events) == [event.target for event in events]
    assert [event.seq for event in events] == list(range(len(events)))
    assert all(a.target == b.origin for a, b in pairwise(events))


def test_a_new_zero_of_depth_stops_motions():
    """A new zero of depth moves the entry with it, and stops a motion."""
    manager, sensor = inserting()
    for depth_m, in_contact in ((0.039, False), (0.041, True), (0.045, True)):
        sensor.reads(depth_m=depth_m, in_contact=in_contact)
        run(manager)

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

    sensor.reads(depth_m=-0.006)
    run(manager)

    assert manager.request("guide") == ""


def test_at_another_place_nobody_knows_where_tissue_begins():
    manager, sensor = inserting()
    for depth_m, in_contact in ((0.041, True), (-0.02, False)):
        sensor.reads(depth_m=depth_m, in_contact=in_contact)
        run(manager)

    sensor.zero = "above another place"
    for depth_m, in_contact in ((0.0, False), (0.011, True), (0.05, True)):
        sensor.reads(depth_m=depth_m, in_contact=in_contact)
        run(manager)

    manager.request("stop")
    manager.request("release")

    assert "in tissue" in manager.request("guide")


@pytest.mark.parametrize("is_restored", [True, False])
def test_inside_at_a_new_zero_entry_is_unknown(is_restored):
    """Inside tissue at a new zero, the entry is unknown until the tip is out."""
    manager, sensor = new_manager()
    sensor.tared = True
    sensor.reads(depth_m=0.03, in_contact=not is_restored)
    run(manager)
    sensor.zero = "elsewhere"
    for depth_m in (0.03, 0.028):
        sensor.reads(depth_m=depth_m, in_contact=is_restored)
        run(manager)

    for depth_m, in_contact in ((0.02, True), (0.003, False), (0.001, False)):
        assert "in tissue" in manager.request("guide")
        sensor.reads(depth_m=depth_m, in_contact=in_contact)
        run(manager)

    assert manager.request("guide") == ""  # it has come out


def test_a_foreign_needle_axis_is_refused():
    """A missing sample is tolerated, an axis that is not the tool's z is refused."""
    manager, sensor = new_manager()

    assert manager.update(None).time_s > 0.0

    sensor.sensor_config = SensorConfig(insertion_axis=(1.0, 0.0, 0.0))

    with pytest.raises(SettingError, match="along z"):
        Manager(sensor)


def test_before_a_valid_sample_position_is_unknown():
    """Until a valid sample has come, the needle may be anywhere: no approach."""
    manager, sensor = new_manager()
    sensor.reads(Status.REJECTED)
    run(manager, 3e-3)

    assert "nobody knows" in manager.request("approach")

    sensor.reads(depth_m=0.1)
    run(manager, 0.2)

    assert manager.request("approach") == ""
    assert run(manager, 0.1).state is State.APPROACH


def test_a_refused_tare_stops():
    manager, sensor = new_manager()
    run(manager)
    manager.request("tare")
    sensor.refuses = True
    manager.request("arrived")
    situation = run(manager)

    assert situation.state is State.STOPPED
    assert situation.reason == "the tare is refused: contact"


def test_guidance_and_tare_are_refused_in_tissue():
    manager, sensor = inserting()
    sensor.reads(depth_m=0.005, in_contact=True)
    run(manager)
    sensor.reads(depth_m=0.02, in_contact=True)
    run(manager)
    for event in ("stop", "release"):
        assert manager.request(event) == ""

    for event in ("guide", "tare", "approach"):
        assert "in tissue" in manager.request(event)

    sensor.reads(depth_m=0.0, in_contact=True)
    run(manager)

    assert manager.request("guide") == ""


def test_teleoperation_needs_its_device_and_stops_without():
    manager, _ = inserting()

    assert manager.request("arrived") == ""
    assert "no haptic device" in manager.request("teleoperate")

    run(manager, 0.01, Beside(has_device=True))

    assert manager.request("teleoperate") == ""

    situation = run(manager, 0.1)

    assert situation.state is State.STOPPED
    assert "haptic device has been silent" in situation.reason


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


def test_guidance_is_refused_with_an_unknown_entry():
    """Guidance is refused as long as the place of the entry is unknown."""
    manager, sensor = new_manager()
    sensor.tared = True
    manager.heartbeat()

    assert "nobody knows" in manager.request("guide")

    sensor.reads(depth_m=0.02, in_contact=True)  # a session that goes on inside tissue
    run(manager)
    sensor.reads(depth_m=0.005, in_contact=True)
    run(manager)

    assert "in tissue" in manager.request("guide")

    sensor.reads(depth_m=0.003)
    run(manager)
    sensor.reads(depth_m=0.001)
    run(manager)

    assert manager.request("guide") == ""


def test_unloggable_data_change_nothing():
    """Data that cannot be written as JSON are refused and change nothing."""
    manager = inserting()[0]
    circle = []
    circle.append(circle)
    for data in ("\ud800", circle):
        with pytest.raises(SettingError, match="data of stop cannot be written"):
            manager.request("stop", data=data)

    assert run(manager).state is State.INSERTION


def test_a_manager_needs_a_session_and_limits():
    for arguments in ((None,), (Sensor(), 5.0)):
        with pytest.raises(
            SettingError, match="expected an InsertionSession and SafetyLimits"
        ):
            Manager(*arguments)
