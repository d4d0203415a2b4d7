"""The manager: every state and event is defined, nothing moves unguarded, logs replay."""

from itertools import pairwise
from pathlib import Path
from time import sleep

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth.rig_arm import ArmSample
from needleforce import InsertionSession
from needleforce.control.errors import SettingError
from needleforce.control.manager import (
    EVENTS,
    MOVING,
    REFUSALS,
    TABLE,
    Manager,
    State,
    read_events,
    replay,
    transition,
    write_mcap,
)
from needleforce.control.monitors import Beside, SafetyLimits
from residual import SensorConfig, SensorWarning, Status, TareError
from urdf import load_lwr

ROBOT = load_lwr()
NOTHING = Beside()
LIMITS = SafetyLimits(axial_N=2.0)
FIRST = InsertionSession(ROBOT).update(np.zeros(7), np.zeros(7), np.zeros(7), 1e-3)
ALL = set(REFUSALS)


class Sensor:
    """Stands in for a session: what it reports is set by the test."""

    lag_s, sensor_config = 0.014, SensorConfig()

    def __init__(self):
        self.tared, self.estimate, self.refuses, self.zero = False, FIRST, False, 0

    def update(self, q, dq, tau, dt_s):
        return self.estimate

    def tare(self):
        if self.refuses:
            raise TareError("contact")
        self.tared = True

    def start_tare_recording(self):
        self.tared = False

    def reads(self, status=Status.OK, *, depth_m=0.0, in_contact=False, **wrench):
        now, wrench = self.estimate, {"warnings": SensorWarning.NONE, "message": ""} | wrench
        self.estimate = now._replace(
            wrench=now.wrench._replace(status=status, **wrench),
            status=status,
            depth_m=depth_m,
            identification=now.identification._replace(
                in_contact=in_contact, layer=int(in_contact)
            ),
        )


def new_manager(limits=LIMITS, log=None):
    sensor = Sensor()
    sensor.reads()
    return Manager(sensor, limits, log=log), sensor


def run(manager, seconds=1e-3, beside=NOTHING, dt_s=1e-3):
    for _ in range(round(seconds / 1e-3)):
        manager.heartbeat()
        now = manager.update(ArmSample(dt_s, np.zeros(7), np.zeros(7), np.zeros(7)), beside)
    return now


def inserting(**kwargs):
    manager, sensor = new_manager(**kwargs)
    run(manager, 0.2)
    for event in ("tare", "arrived", "insert"):
        assert manager.request(event) == ""
    return manager, sensor


def test_faulted_is_left_by_reset_when_healthy_only():
    for event in EVENTS:
        assert transition(State.FAULTED, event, ALL - {"healthy"})[0] is State.FAULTED
        target, _ = transition(State.FAULTED, event, ALL)
        assert target is (State.IDLE if event == "reset" else State.FAULTED)


@given(st.lists(st.tuples(st.sampled_from(EVENTS), st.sets(st.sampled_from(sorted(REFUSALS))))))
def test_nothing_moves_without_limit_heartbeat_and_where_needed_tare(steps):
    state = State.IDLE
    for event, facts in steps:
        before = state
        state, refused = transition(before, event, facts)
        assert not refused or state is before
        if state in MOVING and state is not before:
            assert {"limit", "heartbeat"} <= facts
            assert "tared" in facts or state in (State.APPROACH, State.TARE)
            assert "outside" in facts or state not in (State.GUIDANCE, State.APPROACH, State.TARE)


ACTIONS = st.one_of(
    st.sampled_from(EVENTS),
    st.sampled_from(("wait", "bad", "force", "tissue", "air", "silent", "device", "late")),
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
        now = run(manager)
        untared = now.state in (State.TELEOP, State.INSERTION, State.WITHDRAW, State.GUIDANCE)
        assert sensor.tared or not untared
    events = read_events(path) if actions and path.exists() else manager.events
    assert events == manager.events
    write_mcap(events, path.with_suffix(".mcap"))
    assert read_events(path.with_suffix(".mcap")) == events
    assert replay(events) == [event.target for event in events]
    assert [event.seq for event in events] == list(range(len(events)))
    assert all(a.target == b.origin for a, b in pairwise(events))


@pytest.mark.parametrize(
    ("change", "state", "reason"),
    [
        ({"axial": 2.5}, State.STOPPED, "axial force 2.50 N"),
        ({"lateral": 1.5}, State.STOPPED, "side force 1.50 N"),
        (
            {"warnings": SensorWarning.MODEL_MISMATCH, "message": "no fit"},
            State.STOPPED,
            "no fit",
        ),
        ({"warnings": SensorWarning.FROZEN, "message": "repeats"}, State.FAULTED, "repeats"),
        ({"status": Status.REJECTED, "message": "NaN"}, State.FAULTED, "bad samples"),
    ],
)
def test_monitors_stop_an_insertion_and_say_why(change, state, reason):
    manager, sensor = inserting()
    sensor.reads(**change)
    now = run(manager, 0.02)
    assert now.state is state
    assert reason in now.reason
    assert not now.is_moving


@pytest.mark.parametrize(
    ("lateral", "step_s", "least_s", "most_s"),
    [
        (0.6, 1e-3, 0.025, 0.035),
        (2.0, 1e-3, 0.006, 0.012),  # the larger the sooner
        (2.0, 12e-3, 0.04, 0.06),  # a gap may have made it
        (0.45, 1e-3, 1.0, 1.1),
    ],
)
def test_a_side_force_must_last_and_longer_behind_a_gap(lateral, step_s, least_s, most_s):
    manager, sensor = inserting()
    run(manager, 0.1)
    sensor.reads(lateral=lateral)
    run(manager, dt_s=step_s)
    lasted_s = 1e-3
    while lasted_s < 1.05 and run(manager).state is State.INSERTION:
        lasted_s += 1e-3
    assert least_s <= lasted_s <= most_s


def test_a_rising_force_stops_before_it_is_there():
    manager, sensor = inserting()
    for k in range(100):
        sensor.reads(axial=0.03 * k)
        if run(manager).state is State.STOPPED:
            break
    assert 0.8 < 0.03 * k < 1.5


def test_a_force_against_the_withdrawal_counts_there_and_the_other_does_not():
    manager, sensor = inserting()
    sensor.reads(axial=2.5, lateral=1.5)
    assert run(manager, 0.01).state is State.STOPPED
    assert manager.request("withdraw") == ""
    assert run(manager, 0.1).state is State.WITHDRAW
    sensor.reads(axial=-2.5)
    assert run(manager, 0.1).state is State.STOPPED


def test_what_spoils_the_force_stops_an_insertion_but_no_dwell_and_no_withdrawal():
    manager, sensor = inserting()
    manager.request("arrived")
    sensor.reads(warnings=SensorWarning.TARE_EXPIRED, message="the tare has expired")
    assert run(manager, 0.01).state is State.DWELL
    assert manager.request("insert") == ""
    assert run(manager, 0.01).state is State.STOPPED
    assert manager.request("withdraw") == ""
    assert run(manager, 0.1).state is State.WITHDRAW


def test_a_new_zero_of_depth_moves_the_entry_along_and_stops_a_motion():
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
def test_who_is_inside_behind_a_new_zero_knows_no_entry(is_restored):
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


def test_a_sample_that_is_none_and_an_axis_that_is_not_the_tools_are_reported():
    manager, sensor = new_manager()
    assert manager.update(None).time_s > 0.0
    sensor.sensor_config = SensorConfig(insertion_axis=(1.0, 0.0, 0.0))
    with pytest.raises(SettingError, match="along z"):
        Manager(sensor)


def test_an_approach_stops_at_the_axial_limit_once_the_force_is_tared():
    for status, state in ((Status.OK, State.STOPPED), (Status.NOT_TARED, State.APPROACH)):
        manager, sensor = new_manager()
        run(manager)
        assert manager.request("approach") == ""
        run(manager)
        sensor.reads(status, axial=2.5)
        assert run(manager, 0.01).state is state


def test_single_bad_samples_do_not_stop():
    manager, sensor = inserting()
    for _ in range(50):
        sensor.reads(Status.REJECTED)
        run(manager)
        sensor.reads()
        assert run(manager, 2e-3).state is State.INSERTION


@pytest.mark.parametrize(
    ("beside", "reason"),
    [
        (Beside(accepted=False), "refused commands"),
        (Beside(command_rad_s=np.full(7, 0.05)), "does not follow its commands"),
        (Beside(axial_N=3.0), "axial force 3.00 N"),
    ],
)
def test_commands_and_a_sensor_beside_are_watched(beside, reason):
    manager, _ = inserting()
    now = run(manager, 0.1, beside)
    assert not now.is_moving
    assert reason in now.reason


def test_a_late_sample_and_a_silent_program_stop():
    manager, _ = inserting()
    now = run(manager, 1e-3, dt_s=0.05)
    assert now.state is State.FAULTED
    assert "no sample for 50 ms" in now.reason
    assert "fault persists" in manager.request("reset")
    run(manager, 0.2)
    assert manager.request("reset") == ""
    assert manager.request("insert") == ""
    for _ in range(150):
        now = manager.update(ArmSample(1e-3, *[np.zeros(7)] * 3))
    assert now.state is State.STOPPED
    assert "no heartbeat" in now.reason
    assert "sign of life" in manager.request("withdraw")


def test_the_time_that_a_tare_takes_is_no_lost_arm():
    for late_s, state in ((0.05, State.IDLE), (0.5, State.FAULTED)):
        manager, sensor = new_manager()
        run(manager, 0.2)
        assert manager.request("tare") == ""
        sensor.tare = lambda sensor=sensor: (sleep(0.05), setattr(sensor, "tared", True))
        assert manager.request("arrived") == ""
        assert run(manager, 5e-3).state is State.IDLE  # what the arm has sent meanwhile
        now = run(manager, dt_s=late_s)
        assert (now.state, "no sample" in now.reason) == (state, state is State.FAULTED)
        assert run(manager, dt_s=0.06).state is State.FAULTED  # that time has passed once


def test_a_program_that_falls_silent_in_a_dwell_stops():
    manager, _ = inserting()
    assert manager.request("arrived") == ""
    assert run(manager, 0.2).is_moving  # a stopped tip is held
    for _ in range(150):
        now = manager.update(ArmSample(1e-3, *[np.zeros(7)] * 3))
    assert (now.state, "no heartbeat" in now.reason) == (State.STOPPED, True)


def test_before_the_first_valid_sample_nobody_knows_where_the_needle_is():
    manager, sensor = new_manager()
    sensor.reads(Status.REJECTED)
    run(manager, 3e-3)
    assert "nobody knows" in manager.request("approach")
    sensor.reads(depth_m=0.1)
    run(manager, 0.2)
    assert manager.request("approach") == ""
    assert run(manager, 0.1).state is State.APPROACH


def test_a_clock_that_is_set_moves_no_time():
    manager, _ = new_manager()
    for dt_s in (-3600.0, np.nan, 0.0, 1e9, None, "x", np.ones(2), 10**400):
        assert run(manager, dt_s=dt_s).time_s < 0.01


def test_a_refused_tare_stops():
    manager, sensor = new_manager()
    run(manager)
    manager.request("tare")
    sensor.refuses = True
    manager.request("arrived")
    now = run(manager)
    assert now.state is State.STOPPED
    assert now.reason == "the tare is refused: contact"


def test_guidance_and_a_new_tare_are_refused_in_tissue():
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
    now = run(manager, 0.1)
    assert now.state is State.STOPPED
    assert "haptic device has been silent" in now.reason


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "2", None])
def test_limits_are_positive_numbers(value):
    with pytest.raises(SettingError, match="axial_N is"):
        SafetyLimits(axial_N=value)


def test_a_stand_in_has_what_a_session_has():
    names = [name for name in (*vars(Sensor), "tared") if name[0] != "_" and name != "reads"]
    assert [name for name in names if not hasattr(InsertionSession(ROBOT), name)] == []


def test_the_page_shows_the_table_as_it_is():
    page = Path(__file__).resolve().parents[1] / "docs" / "control.md"
    rows = [line.strip("| ").split(" | ") for line in page.read_text().splitlines()]
    for rule in TABLE:
        assert [rule.event, rule.sources, rule.target, rule.guards or "–"] in rows


def test_what_came_beside_a_sample_stops_or_is_reported_where_it_is_no_number():
    manager, _ = inserting()
    now = run(manager, 0.005, Beside(axial_N=np.nan))  # a few are skipped
    assert now.state is State.INSERTION
    now = run(manager, 0.01, Beside(axial_N=np.nan))
    assert (now.state, "axial force of the sensor nan" in now.reason) == (State.FAULTED, True)
    for command in (np.full(7, np.nan), np.zeros(6), "x", [[]] * 7, [(0.0,), 0.0], ["x"] * 7):
        manager, _ = inserting()
        reason = run(manager, beside=Beside(command_rad_s=command)).reason
        assert "expected 7 finite numbers" in reason
    assert run(inserting()[0], beside=Beside(command_rad_s=[0.0] * 7)).state is State.INSERTION


def test_a_single_bad_reading_does_not_hide_the_force_that_follows():
    stops = []
    for bad in (False, True):
        manager, _ = inserting()
        for k in range(400):
            axial_N = np.nan if bad and k == 50 else 0.01 * k
            if run(manager, beside=Beside(axial_N=axial_N)).state is not State.INSERTION:
                break
        stops.append(k)
    assert stops[0] < 200
    assert abs(stops[0] - stops[1]) <= 1


def test_who_does_not_know_where_the_needle_is_refuses_guidance():
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


def test_data_that_no_log_can_hold_are_refused_and_change_nothing():
    manager, circle = inserting()[0], []
    circle.append(circle)
    for data in ("\ud800", circle):
        with pytest.raises(SettingError, match="data of stop cannot be written"):
            manager.request("stop", data=data)
    assert run(manager).state is State.INSERTION


def test_a_manager_needs_a_session_and_limits():
    for arguments in ((None,), (Sensor(), 5.0)):
        with pytest.raises(SettingError, match="expected an InsertionSession and SafetyLimits"):
            Manager(*arguments)
