"""What stops a motion: forces, bad and late samples, silence, commands that are not
followed."""

import numpy as np
import pytest

from groundtruth.rig_arm import ArmSample
from identification import HardContact, SampleStatus
from needleforce.control.errors import SettingError
from needleforce.control.monitors import Beside, SafetyLimits
from needleforce.control.state_machine import State
from residual import SensorWarning, Status
from tests.needleforce.control.managed_session import inserting, new_manager, run

BONE = HardContact(alarm_s=4.0, depth_m=32.1e-3, force_N=1.2, growth_N_per_m=9000.0)


@pytest.mark.parametrize(
    ("change", "state", "reason"),
    [
        ({"axial": 2.5}, State.STOPPED, "axial force 2.50 N"),
        ({"lateral": 1.5}, State.STOPPED, "side force 1.50 N"),
        ({"hard_contact": BONE}, State.STOPPED, "hard contact at 32.1 mm"),
        (
            {"warnings": SensorWarning.MODEL_MISMATCH, "message": "no fit"},
            State.STOPPED,
            "no fit",
        ),
        (
            {"warnings": SensorWarning.FROZEN, "message": "repeats"},
            State.FAULTED,
            "repeats",
        ),
        ({"status": Status.REJECTED, "message": "NaN"}, State.FAULTED, "bad samples"),
        (
            {"sample_status": SampleStatus.NEEDLE_PULLED, "axial": -1.6},
            State.FAULTED,
            "axial force -1.60 N: no tissue exerts this force",
        ),
        (
            {"warnings": SensorWarning.TORQUE_JUMP, "message": "a torque has jumped"},
            State.STOPPED,
            "a torque has jumped",
        ),
        (
            {"warnings": SensorWarning.TOO_FAST, "message": "has outrun the force"},
            State.STOPPED,
            "has outrun the force",
        ),
    ],
)
def test_monitors_stop_an_insertion_and_say_why(change, state, reason):
    manager, sensor = inserting()
    sensor.reads(**change)
    situation = run(manager, 0.02)

    assert situation.state is state
    assert reason in situation.reason
    assert not situation.is_moving


def test_a_dwell_after_a_fall_that_pulls_is_a_fault():
    manager, sensor = inserting()

    assert manager.request("rupture") == ""
    assert run(manager).state is State.DWELL

    sensor.reads(sample_status=SampleStatus.NEEDLE_PULLED)
    situation = run(manager)

    assert situation.state is State.FAULTED
    assert "a push at the hub" in situation.reason


def test_an_identifier_of_a_force_sensor_reports_its_own_pull():
    manager, sensor = inserting()
    sensor.reads(sample_status=SampleStatus.NEEDLE_PULLED)
    other = Beside(axial_N=0.3)

    assert run(manager, beside=other).state is State.INSERTION

    pulled = Beside(axial_N=-2.0, sample_status=SampleStatus.NEEDLE_PULLED)

    assert run(manager, beside=pulled).state is State.FAULTED


@pytest.mark.parametrize(
    ("lateral", "step_s", "least_s", "most_s"),
    [
        (0.6, 1e-3, 0.025, 0.035),
        (2.0, 1e-3, 0.006, 0.012),  # the larger the sooner
        (2.0, 12e-3, 0.04, 0.06),  # a gap may have made it
        (0.45, 1e-3, 1.0, 1.1),
    ],
)
def test_a_side_force_must_last(lateral, step_s, least_s, most_s):
    """A side force must last before it stops a motion, and longer after a gap."""
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


def test_only_force_against_the_withdrawal_stops_it():
    """During a withdrawal only a force against it stops the motion."""
    manager, sensor = inserting()
    sensor.reads(axial=2.5, lateral=1.5)

    assert run(manager, 0.01).state is State.STOPPED
    assert manager.request("withdraw") == ""
    assert run(manager, 0.1).state is State.WITHDRAW

    sensor.reads(axial=-2.5)

    assert run(manager, 0.1).state is State.STOPPED


def test_an_unusable_force_stops_only_advancing():
    """A doubtful force stops an insertion, but neither a dwell nor a withdrawal."""
    manager, sensor = inserting()
    manager.request("arrived")
    sensor.reads(warnings=SensorWarning.TARE_EXPIRED, message="the tare has expired")

    assert run(manager, 0.01).state is State.DWELL
    assert manager.request("insert") == ""
    assert run(manager, 0.01).state is State.STOPPED
    assert manager.request("withdraw") == ""
    assert run(manager, 0.1).state is State.WITHDRAW


def test_a_tared_approach_stops_at_the_axial_limit():
    """An approach stops at the axial limit once the force is tared."""
    for status, state in (
        (Status.OK, State.STOPPED),
        (Status.NOT_TARED, State.APPROACH),
    ):
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
    situation = run(manager, 0.1, beside)

    assert not situation.is_moving
    assert reason in situation.reason


def test_a_late_sample_and_a_silent_program_stop():
    manager, _ = inserting()
    situation = run(manager, 1e-3, dt_s=0.05)

    assert situation.state is State.FAULTED
    assert "no sample for 50 ms" in situation.reason
    assert "fault persists" in manager.request("reset")

    run(manager, 0.2)

    assert manager.request("reset") == ""
    assert manager.request("insert") == ""

    for _ in range(150):
        situation = manager.update(ArmSample(1e-3, *[np.zeros(7)] * 3))

    assert situation.state is State.STOPPED
    assert "no heartbeat" in situation.reason
    assert "sign of life" in manager.request("withdraw")


def test_an_arm_that_is_lost_while_taring_is_a_fault():
    """A tare is fitted beside the updates: the arm is watched meanwhile."""
    for late_s, state in ((2e-3, State.TARE), (0.5, State.FAULTED)):
        manager, sensor = new_manager()
        run(manager, 0.2)
        assert manager.request("tare") == ""
        sensor.is_slow = True
        assert manager.request("arrived") == ""
        assert manager.request("arrived") == ""
        assert run(manager, 5e-3).state is State.TARE
        assert run(manager, dt_s=late_s).state is state


@pytest.mark.parametrize(("after_s", "is_refused"), [(0.09, True), (0.12, False)])
def test_a_fault_must_be_gone_for_a_tenth_of_a_second(after_s, is_refused):
    manager, _ = inserting()

    assert run(manager, 1e-3, dt_s=0.05).state is State.FAULTED

    run(manager, after_s)

    assert ("fault persists" in manager.request("reset")) == is_refused


def test_commands_refused_now_and_then_do_not_add_up():
    """Each time for 4 ms: 5 ms in a row are a fault."""
    manager, _ = inserting()
    for _ in range(10):
        situation = run(manager, 4e-3, Beside(accepted=False))
        assert situation.state is State.INSERTION
        run(manager, 1e-3)

    assert run(manager, 7e-3, Beside(accepted=False)).state is State.FAULTED


@pytest.mark.parametrize(
    ("followed", "state"), [(0.48, State.INSERTION), (0.36, State.FAULTED)]
)
def test_an_arm_may_be_behind_by_half_of_what_it_was_commanded(followed, state):
    """And by 2 mrad and 30 ms more: over two seconds at 0.05 rad/s by 0.6 of it."""
    manager, _ = inserting()
    beside = Beside(command_rad_s=0.05 * np.eye(7)[0])
    for k in range(2000):
        manager.heartbeat()
        q_rad = followed * 0.05 * 1e-3 * k * np.eye(7)[0]
        sample = ArmSample(1e-3, q_rad, np.zeros(7), np.zeros(7))
        situation = manager.update(sample, beside)

    assert situation.state is state


def test_a_silent_program_stops_in_a_dwell():
    manager, _ = inserting()

    assert manager.request("arrived") == ""
    assert run(manager, 0.2).is_moving  # a stopped tip is held

    for _ in range(150):
        situation = manager.update(ArmSample(1e-3, *[np.zeros(7)] * 3))

    assert situation.state is State.STOPPED
    assert "no heartbeat" in situation.reason


def test_a_clock_that_is_set_moves_no_time():
    manager, _ = new_manager()
    for dt_s in (-3600.0, np.nan, 0.0, 1e9, None, "x", np.ones(2), 10**400):
        assert run(manager, dt_s=dt_s).time_s < 0.01


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "2", None, True, [2.0]])
def test_limits_are_positive_numbers(value):
    assert SafetyLimits(axial_N=np.float32(2.0)).axial_N == np.int64(2)
    with pytest.raises(SettingError, match="axial_N is"):
        SafetyLimits(axial_N=value)


def test_invalid_force_or_command_stops():
    """A force that is no number stops a motion, an invalid command is reported."""
    manager, _ = inserting()
    situation = run(manager, 0.005, Beside(axial_N=np.nan))  # a few are skipped

    assert situation.state is State.INSERTION

    situation = run(manager, 0.01, Beside(axial_N=np.nan))

    assert situation.state is State.FAULTED
    assert "axial force of the sensor nan" in situation.reason

    for command in (
        np.full(7, np.nan),
        np.zeros(6),
        "x",
        [[]] * 7,
        [(0.0,), 0.0],
        ["x"] * 7,
    ):
        manager, _ = inserting()
        reason = run(manager, beside=Beside(command_rad_s=command)).reason
        assert "expected 7 finite numbers" in reason

    assert (
        run(inserting()[0], beside=Beside(command_rad_s=[0.0] * 7)).state
        is State.INSERTION
    )


def test_one_bad_reading_hides_no_later_force():
    """After a single bad reading a rising force still stops the motion in time."""
    stops = []
    for bad in (False, True):
        manager, _ = inserting()
        for k in range(400):
            axial_N = np.nan if bad and k == 50 else 0.01 * k
            if (
                run(manager, beside=Beside(axial_N=axial_N)).state
                is not State.INSERTION
            ):
                break
        stops.append(k)

    assert stops[0] < 200
    assert abs(stops[0] - stops[1]) <= 1
