"""What stops a motion: forces, bad and late samples, silence, commands that are not
followed."""

import numpy as np
import pytest

from identification import HardContact, SampleStatus
from needleforce.control import Beside, SafetyLimits, SettingError, State
from residual import SensorWarning, Status
from tests.needleforce.control.managed_session import (
    DEVICE,
    inserting,
    new_manager,
    play,
    run,
)

BONE = HardContact(alarm_s=4.0, depth_m=32.1e-3, force_N=1.2, growth_N_per_m=9000.0)
ONE_JOINT = np.eye(7)[0]


@pytest.mark.parametrize(
    ("change", "state", "reason"),
    [
        ({"axial": 2.5}, State.STOPPED, "2.50 N"),
        ({"lateral": 1.5}, State.STOPPED, "side force 1.50 N"),
        ({"hard_contact": BONE}, State.STOPPED, "32.1 mm"),
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
        (
            {"warnings": SensorWarning.VELOCITY, "message": "wrong"},
            State.FAULTED,
            "wrong",
        ),
        ({"status": Status.REJECTED, "message": "NaN"}, State.FAULTED, "NaN"),
        (
            {"sample_status": SampleStatus.NEEDLE_PULLED, "axial": -1.6},
            State.FAULTED,
            "-1.60 N",
        ),
        (
            {"warnings": SensorWarning.TORQUE_JUMP, "message": "jumped"},
            State.STOPPED,
            "jumped",
        ),
        (
            {"warnings": SensorWarning.TOO_FAST, "message": "outrun"},
            State.STOPPED,
            "outrun",
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


PULLED = {"sample_status": SampleStatus.NEEDLE_PULLED}
EXPIRED = {"warnings": SensorWarning.TARE_EXPIRED, "message": "expired"}
BY_HAND = ("arrived", DEVICE, 0.01, "teleoperate", 0.01)


@pytest.mark.parametrize(
    "steps",
    [
        # a dwell after a fall that pulls
        ("rupture", State.DWELL, PULLED, State.FAULTED),
        # The session's own pull, and a needle that outruns its force, count no more
        # where there is an F/T sensor.
        (
            Beside(axial_N=0.3),
            PULLED | {"warnings": SensorWarning.TOO_FAST},
            State.INSERTION,
            Beside(axial_N=-1.0, sample_status=SampleStatus.NEEDLE_PULLED),
            State.FAULTED,
        ),
        (Beside(axial_N=3.0), 5e-3, State.STOPPED),
        # only force against the motion stops it
        ({"axial": -2.5}, 0.1, State.INSERTION),
        ("arrived", "withdraw", 0.01, {"axial": 2.5}, 0.1, State.WITHDRAW),
        ("arrived", "withdraw", 0.01, {"axial": -2.5}, 0.1, State.STOPPED),
        (*BY_HAND, {"axial": 2.5}, 0.1, State.STOPPED),
        (*BY_HAND, {"axial": -2.5}, 0.1, State.STOPPED),
        # A withdrawal bears the side force that has stopped the needle, and stops where
        # it grows by the limit.
        (
            *({"lateral": 1.5}, 0.02, State.STOPPED, "withdraw"),
            *({"lateral": 1.9}, 0.1, State.WITHDRAW, {"lateral": 2.1}, 0.1),
            State.STOPPED,
        ),
        # A doubtful force stops an insertion, but neither a dwell nor a withdrawal.
        (
            *("arrived", EXPIRED, 0.01, State.DWELL, "insert", 0.01, State.STOPPED),
            *("withdraw", 0.1, State.WITHDRAW),
        ),
        # A late sample is a fault until it is reset.
        (
            *({"dt_s": 0.029}, State.INSERTION, {"dt_s": 0.05}, State.FAULTED),
            *(0.09, "!reset persists", 0.03, "reset", "insert"),
        ),
        # A tare is fitted beside the updates: the arm is watched meanwhile.
        (
            *("stop", "release", {"is_slow": True}, "tare", "arrived", "arrived"),
            *(5e-3, State.TARE, {"dt_s": 2e-3}, State.TARE, {"dt_s": 0.5}),
            State.FAULTED,
        ),
    ],
)
def test_what_stops_a_motion_depends_on_its_state(steps):
    play(*inserting(), *steps)


@pytest.mark.parametrize(
    ("event", "status", "change_N", "is_stopped"),
    [
        ("approach", Status.OK, 2.5, True),  # once tared the axial limit counts
        ("approach", Status.OK, 1.5, False),
        ("approach", Status.NOT_TARED, 2.5, False),
        ("approach", Status.NOT_TARED, 16.0, True),
        ("tare", Status.NOT_TARED, -16.0, True),
        ("guide", Status.OK, 14.0, False),  # the hand's
        ("guide", Status.OK, 16.0, True),
    ],
)
def test_in_free_air_the_force_may_change_by_so_much(
    event, status, change_N, is_stopped
):
    bias = {"tared": event == "guide", "status": status, "axial": 5.0}
    changed = {"status": status, "axial": 5.0 + change_N}
    situation = play(*new_manager(), bias, event, 0.01, changed, 0.01)

    assert (situation.state is State.STOPPED) == is_stopped


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


def stop_by_rise(rate_N_per_s, **limits):
    """Return the force at which an insertion stops that grows at a rate."""
    manager, sensor = inserting(limits=SafetyLimits(axial_N=2.0, **limits))
    for k in range(3000):
        sensor.reads(axial=1e-3 * rate_N_per_s * k)
        if run(manager).state is State.STOPPED:
            break
    return 1e-3 * rate_N_per_s * k


def test_a_rising_force_stops_before_it_is_there():
    """By its rate, a mean over 10 ms, over the lag of 14 ms and the 15 ms to rest."""
    assert stop_by_rise(1.0) == pytest.approx(2.0 - 0.029, abs=0.01)
    assert stop_by_rise(30.0) == pytest.approx(2.0 - 30.0 * 0.029, abs=0.06)
    assert stop_by_rise(30.0, reaction_s=0.04) == pytest.approx(0.6, abs=0.05)


@pytest.mark.parametrize(
    ("beside", "after_s", "reason"),
    [
        (Beside(accepted=False), 6e-3, "refused commands"),
        (Beside(axial_N=np.nan), 7e-3, "nan"),  # a few are skipped
        (Beside(command_rad_s=np.full(7, np.nan)), 1e-3, "7 finite numbers"),
        (Beside(command_rad_s=np.zeros(6)), 1e-3, "7 finite numbers"),
        (Beside(command_rad_s=["x"] * 7), 1e-3, "7 finite numbers"),
    ],
)
def test_what_comes_beside_a_sample_is_watched(beside, after_s, reason):
    manager, _ = inserting()

    situation = run(manager)
    for _ in range(round(after_s / 1e-3)):
        assert situation.state is State.INSERTION
        situation = run(manager, beside=beside)

    assert situation.state is State.FAULTED
    assert reason in situation.reason


@pytest.mark.parametrize(
    ("often_s", "change", "beside"),
    [
        (20e-3, {"lateral": 0.6}, None),
        (4e-3, {}, Beside(accepted=False)),
        (1e-3, {"status": Status.REJECTED}, None),
    ],
)
def test_what_comes_now_and_then_does_not_add_up(often_s, change, beside):
    """A side force, refused commands, bad samples."""
    manager, sensor = inserting()
    for _ in range(50):
        sensor.reads(**change)
        assert run(manager, often_s, beside).state is State.INSERTION
        sensor.reads()
        assert run(manager, 2e-3).state is State.INSERTION


@pytest.mark.parametrize(
    ("followed", "is_followed"),
    [(1.0, True), (0.48, True), (0.36, False), (0.0, False)],
)
def test_an_arm_may_be_behind_by_half_of_what_it_was_commanded(followed, is_followed):
    """And by 2 mrad and 30 ms more: over two seconds at 0.05 rad/s by 0.6 of it."""
    manager, _ = inserting()
    beside = Beside(command_rad_s=0.05 * ONE_JOINT)
    for k in range(2000):
        q_rad = followed * 0.05 * 1e-3 * k * ONE_JOINT
        situation = run(manager, beside=beside, q_rad=q_rad)
        if followed == 0.0 and k == 200:
            assert situation.state is State.FAULTED

    assert (situation.state is State.INSERTION) == is_followed
    assert ("follow" in situation.reason) != is_followed


@pytest.mark.parametrize(("drift_rad", "is_fault"), [(0.04, False), (0.06, True)])
def test_a_joint_may_not_move_by_itself(drift_rad, is_fault):
    """An arm that nobody commands may: others lead it."""
    for beside, is_watched in (
        (Beside(command_rad_s=np.zeros(7)), True),
        (None, False),
    ):
        manager, _ = inserting()
        for k in range(50):
            q_rad = drift_rad * k / 49.0 * ONE_JOINT
            situation = run(manager, beside=beside, q_rad=q_rad)
        assert (situation.state is State.FAULTED) == (is_fault and is_watched)


def test_what_an_arm_did_uncommanded_does_not_count_later():
    manager, _ = inserting()
    run(manager, beside=Beside(command_rad_s=np.zeros(7)))
    run(manager, q_rad=np.ones(7))
    commanded = Beside(command_rad_s=np.zeros(7))

    assert run(manager, 0.1, commanded, q_rad=np.ones(7)).state is State.INSERTION


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf, "2", None, True, [2.0]])
def test_limits_are_positive_numbers(value):
    assert SafetyLimits(axial_N=np.float32(2.0)).axial_N == np.int64(2)
    with pytest.raises(SettingError, match="axial_N"):
        SafetyLimits(axial_N=value)
    with pytest.raises(SettingError, match="free_N"):
        SafetyLimits(axial_N=1.0, free_N=value)


def test_one_bad_reading_hides_no_later_force():
    """After a single bad reading a rising force still stops the motion in time."""
    stops = []
    for bad in (False, True):
        manager, _ = inserting()
        for k in range(400):
            axial_N = np.nan if bad and k == 50 else 0.01 * k
            situation = run(manager, beside=Beside(axial_N=axial_N))
            if situation.state is not State.INSERTION:
                break
        stops.append(k)

    assert stops[0] < 200
    assert abs(stops[0] - stops[1]) <= 1
