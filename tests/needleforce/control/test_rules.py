"""The manager's table of rules, and its log: what it holds, what of it is refused."""

import json
import resource

import numpy as np
import pytest

from groundtruth.rig_arm import ArmSample
from needleforce import InsertionSession
from needleforce.control import (
    Manager,
    SafetyLimits,
    SettingError,
    State,
    read_events,
    replay,
    write_mcap,
)
from needleforce.control.state_machine import EVENTS, REFUSALS, TABLE, transition
from urdf import load_lwr

ROBOT = load_lwr()
ALL = set(REFUSALS)
SAMPLE = ArmSample(1e-3, np.zeros(7), np.zeros(7), np.zeros(7))


def new_manager(log):
    manager = Manager(InsertionSession(ROBOT), SafetyLimits(axial_N=2.0), log=log)
    manager.update(SAMPLE)
    manager.heartbeat()
    return manager


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("event", EVENTS)
def test_every_state_and_event_is_defined_once(state, event):
    rules = [r for r in TABLE if r.event == event and state in r.sources.split()]

    assert len(rules) <= 1

    target, refused = transition(state, event, ALL)

    assert bool(refused) == (not rules)
    assert refused == "" or (target is state and event in refused)

    nothing, why = transition(state, event, ())
    guards = rules[0].guards.split() if rules else []

    assert set(guards) <= ALL
    assert bool(why) == (not rules or bool(guards))
    assert nothing is (state if why else target)


def test_an_unknown_event_is_an_error():
    with pytest.raises(
        SettingError, match=r"unknown event 'jump', expected one of guide"
    ):
        transition(State.IDLE, "jump", ALL)


@pytest.mark.parametrize(
    "state", [state for state in State if state is not State.FAULTED]
)
def test_stop_and_fault_are_possible_everywhere(state):
    assert transition(state, "stop", ()) == (State.STOPPED, "")
    assert transition(state, "fault", ()) == (State.FAULTED, "")


def test_a_log_holds_the_named_fields_and_refusals(tmp_path):
    path = tmp_path / "events.jsonl"
    manager = Manager(InsertionSession(ROBOT), log=path)
    manager.update(SAMPLE)
    refused = manager.request("approach", by="someone")

    assert "SafetyLimits" in refused

    (row,) = [json.loads(line) for line in path.read_text().splitlines()]

    assert list(row) == ["seq", "t_s", "from", "event", "to", "refused", "data"]
    assert (row["from"], row["to"], row["refused"]) == ("idle", "idle", refused)
    assert row["data"]["by"] == "someone"
    assert manager.update(SAMPLE).reason == refused


@pytest.mark.parametrize("line", ["{", "[]", '{"seq": 0}', '{"seq": 3}'])
def test_a_damaged_log_is_refused(tmp_path, line):
    path = tmp_path / "events.jsonl"
    path.write_text(line + "\n")

    with pytest.raises(SettingError, match="line 1 is no event"):
        read_events(path)


def test_a_log_out_of_order_is_refused(tmp_path):
    path = tmp_path / "events.jsonl"
    manager = new_manager(path)
    manager.request("stop")
    path.write_text(path.read_text().replace('"seq":0', '"seq":2'))

    with pytest.raises(SettingError, match="event 2 is out of order"):
        read_events(path)


def test_a_log_of_two_sessions_begins_idle_twice(tmp_path):
    for event in ("stop", "release"):
        manager = new_manager(tmp_path / "two.jsonl")
        assert manager.request("approach") == ""
        manager.request(event)

    events = read_events(tmp_path / "two.jsonl")

    assert replay(events) == [event.target for event in events]

    write_mcap(events, tmp_path / "two.mcap")

    assert read_events(tmp_path / "two.mcap") == events

    whole = (tmp_path / "two.mcap").read_bytes()
    for damaged in (
        b"",
        b"no MCAP",
        whole[:-60],
        whole[:100] + b"\xff" * 40 + whole[140:],
    ):
        (tmp_path / "two.mcap").write_bytes(damaged)
        with pytest.raises(SettingError, match="no MCAP file, or a damaged one"):
            read_events(tmp_path / "two.mcap")


def test_half_a_line_spoils_no_other(tmp_path):
    """A line that a full disk cut short spoils no later one."""
    manager = new_manager(tmp_path / "log.jsonl")
    manager.request("approach")
    sizes = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        size = (tmp_path / "log.jsonl").stat().st_size
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 50, sizes[1]))
        manager.request("stop")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, sizes)

    assert "cannot be written" in manager.update(SAMPLE).reason
    assert read_events(tmp_path / "log.jsonl") == manager.events[:1]

    manager.request("release")

    assert read_events(tmp_path / "log.jsonl") == manager.events


def test_an_unwritable_log_is_refused_or_reported(tmp_path):
    """A log that cannot be opened is refused, one that fails later is reported."""
    with pytest.raises(OSError, match="No such file"):
        new_manager(tmp_path / "missing" / "log.jsonl")

    log = tmp_path / "log.jsonl"
    manager = new_manager(log)

    assert manager.request("approach") == ""

    written = log.read_bytes()
    log.unlink()
    log.mkdir()  # as a disk that is full

    assert manager.request("stop") == ""

    situation = manager.update(SAMPLE)

    assert situation.state is State.STOPPED
    assert "cannot be written" in situation.reason

    log.rmdir()
    log.write_bytes(written)
    manager.request("release")

    assert read_events(log) == manager.events
