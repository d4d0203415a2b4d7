"""Faults of the haptic device: the needle stands, the hand is not hurt, and why is
said."""

from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from groundtruth.rig_operator import HapticMaster, Operator
from needleforce.control import Beside, State, Teleoperation
from needleforce.control.handle_watch import HandleWatch
from residual import Status
from tests.needleforce.control.managed_session import inserting, run

DT = 1e-3
FAULT_S = 1.0
END_S = 2.5


def changed(sample, position_m=None, velocity_m_s=None, clutch=None):
    """Return a device's sample with something changed."""
    return SimpleNamespace(
        t_s=sample.t_s,
        position_m=sample.position_m if position_m is None else position_m,
        velocity_m_s=sample.velocity_m_s if velocity_m_s is None else velocity_m_s,
        clutch=sample.clutch if clutch is None else clutch,
    )


def jumping(offset_m, seconds=np.inf):
    def fault(t_s, sample):
        is_there = FAULT_S <= t_s < FAULT_S + seconds
        return changed(sample, sample.position_m + is_there * np.array(offset_m))

    return fault


def replaced(**parts):
    def fault(t_s, sample):
        return changed(sample, **parts) if t_s >= FAULT_S else sample

    return fault


def frozen(*, has_stamp):
    kept = []

    def fault(t_s, sample):
        if t_s < FAULT_S:
            return sample
        kept.append(sample)
        first = kept[0]
        if has_stamp:
            return first
        return SimpleNamespace(
            position_m=first.position_m,
            velocity_m_s=first.velocity_m_s,
            clutch=first.clutch,
        )

    return fault


FAULTS = {
    "jumps and stays": (jumping((0.0, 0.0, 0.1)), "the handle jumped by 100 mm"),
    "jumps back": (jumping((0.0, 0.0, -0.1)), "the handle jumped by 100 mm"),
    "jumps by 8 mm": (jumping((0.0, 0.0, 8e-3)), "the handle jumped by 8 mm"),
    "jumps across": (jumping((0.0, 0.2, 0.0)), "the handle jumped by 200 mm"),
    "jumps for a sample": (jumping((0.0, 0.0, 0.1), DT), "the handle jumped by"),
    "nan position": (replaced(position_m=np.full(3, np.nan)), "no three finite"),
    "nan velocity": (replaced(velocity_m_s=np.full(3, np.nan)), "no three finite"),
    "two numbers": (replaced(position_m=np.zeros(2)), "no three finite"),
    "frozen": (frozen(has_stamp=True), "repeated one sample"),
    "frozen, no stamp": (frozen(has_stamp=False), "repeated one sample"),
    "gone": (lambda t_s, sample: sample if t_s < FAULT_S else None, "been silent"),
    "quick": (replaced(velocity_m_s=np.array([0.0, 0.0, 1.0])), "contradicts"),
    "quick back": (replaced(velocity_m_s=np.array([0.0, 0.0, -1.0])), "contradicts"),
    "askew": (replaced(velocity_m_s=np.array([0.3, 0.0, 0.1])), "contradicts"),
}
SEEN_BY_MANAGER = ("nan", "two", "frozen", "gone")


def estimate(force_N, depth_m, speed_m_s):
    return SimpleNamespace(
        wrench=SimpleNamespace(axial_unsmoothed=force_N),
        identification=SimpleNamespace(
            tip_force_N=force_N,
            enhanced_force_N=force_N,
            rupture=None,
            provisional=None,
            stiffness_N_per_m=0.0,
        ),
        depth_m=depth_m,
        speed_m_s=speed_m_s,
        status=Status.OK,
    )


class Drive(NamedTuple):
    """What a needle and its hand did, one entry a tick."""

    t_s: np.ndarray
    depth_m: np.ndarray
    force_N: np.ndarray
    hand_m: np.ndarray
    reasons: list[str]


def drive(fault, hand_m_s, *, stiffness=500.0, end_s=END_S, **tele_settings):
    """Drive a needle, 5 ms behind its command, into a spring 2 mm away."""
    wish = Operator(wish_m=lambda t_s: (0.0, 0.0, hand_m_s * t_s))
    device = HapticMaster(wish)
    tele = Teleoperation(**tele_settings)
    depth_m = 0.0
    speed_m_s = 0.0
    rows = []
    for k in range(round(end_s / DT)):
        sample = fault(k * DT, device.read())
        spring_N = stiffness * max(depth_m - 2e-3, 0.0)
        move = tele.update(sample, estimate(spring_N, depth_m, speed_m_s), DT)
        device.render(move.force_N)
        speed_m_s += (move.speed_m_s - speed_m_s) / 6.0
        depth_m += speed_m_s * DT
        row = (k * DT, depth_m, move.force_N[2], device.position_m[2], move.reason)
        rows.append(row)
    *numbers, reasons = zip(*rows, strict=True)
    return Drive(*map(np.array, numbers), reasons=reasons)


@pytest.mark.parametrize("hand_m_s", [0.01, 0.1, -0.03])
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_the_handle_neither_drives_the_needle_nor_hurts(name, hand_m_s):
    fault, reason = FAULTS[name]
    driven = drive(fault, hand_m_s)
    after = driven.t_s >= FAULT_S
    travel_m = driven.depth_m[after] - driven.depth_m[np.argmax(after) - 1]

    assert np.abs(travel_m).max() <= 1e-3
    assert np.abs(driven.force_N).max() <= 5.0

    growth_N = np.diff(np.abs(driven.force_N), prepend=0.0)

    assert growth_N.max() <= 0.5 + 1e-9
    assert not any(driven.reasons[: np.argmax(after)])

    within = driven.t_s >= FAULT_S + 0.05

    assert reason in driven.reasons[np.argmax(within)]
    assert reason in driven.reasons[-1]


@pytest.mark.parametrize("name", [n for n in FAULTS if n.startswith(SEEN_BY_MANAGER)])
def test_the_manager_stops_without_a_usable_handle(name):
    manager, _ = inserting()
    manager.request("arrived")
    device = HapticMaster(Operator(wish_m=lambda t_s: (0.0, 0.0, 0.02 * t_s)))
    fault, reason = FAULTS[name]
    for k in range(round(FAULT_S / DT) + 50):
        handle = fault(k * DT, device.read())
        situation = run(manager, DT, Beside(handle=handle))
        if k == 10:
            assert manager.request("teleoperate") == ""
        if 10 < k < FAULT_S / DT:
            assert situation.state is not State.STOPPED

    assert situation.state is State.STOPPED
    assert reason in situation.reason
    assert "no haptic device" in manager.request("release") + manager.request(
        "teleoperate"
    )


def test_the_needle_follows_again_once_the_clutch_was_opened():
    """A jump is no way: the needle goes on from where both are."""
    jump = jumping((0.0, 0.0, 0.1))

    def fault(t_s, sample):
        return changed(jump(t_s, sample), clutch=not 1.4 <= t_s < 1.5)

    driven = drive(fault, 0.01, stiffness=0.0)
    stands = driven.depth_m[1400] - driven.depth_m[1010]
    follows = driven.depth_m[-1] - driven.depth_m[1500]

    assert stands == pytest.approx(0.0, abs=1e-5)
    assert follows == pytest.approx(0.4 * 0.01 * 1.0, abs=2e-4)
    assert driven.reasons[1399]
    assert not driven.reasons[1400]


def test_an_open_clutch_feels_free():
    """A quick hand with the clutch open is not held back by more than 0.5 N."""

    def waving(t_s, sample):
        return changed(sample, clutch=t_s < 1.0)

    driven = drive(waving, 0.03, stiffness=2000.0)

    assert np.abs(driven.force_N[:1000]).max() > 2.0
    assert np.abs(driven.force_N[1000:]).max() <= 0.5


def test_the_largest_force_is_a_setting():
    driven = drive(lambda t_s, sample: sample, 0.05, stiffness=2000.0, max_force_N=1.5)

    assert np.abs(driven.force_N).max() == pytest.approx(1.5)


def test_a_device_without_velocity_drives_the_needle_too():
    """Velocities that are always zero are none: those of the positions count."""

    def still(t_s, sample):
        return changed(sample, velocity_m_s=np.zeros(3))

    driven = drive(still, 0.02, stiffness=0.0)

    assert driven.depth_m[-1] == pytest.approx(0.4 * driven.hand_m[-1], abs=1e-3)
    assert not any(driven.reasons)


def test_a_resting_handle_is_not_frozen():
    """A device whose clock goes on may report the same place for long."""
    watch = HandleWatch()
    for k in range(500):
        sample = SimpleNamespace(
            t_s=k * DT, position_m=np.ones(3), velocity_m_s=np.zeros(3), clutch=True
        )
        report = watch.update(sample, DT)

    assert report.reading is not None
    assert (report.fault, report.doubt) == ("", "")


@pytest.mark.parametrize("every", [1, 3, 10])
@pytest.mark.parametrize("lag_s", [0.0, 5e-3])
def test_a_swinging_hand_is_believed(every, lag_s):
    """4 Hz with an amplitude of 10 mm, the velocity late, samples now and then
    double."""
    watch = HandleWatch()
    rng = np.random.default_rng(3)
    for k in range(3000):
        t_s = k * DT
        phase = 2.0 * np.pi * 4.0
        position_m = np.round(1e-2 * np.sin(phase * t_s), 5)
        velocity_m_s = 1e-2 * phase * np.cos(phase * (t_s - lag_s))
        sample = SimpleNamespace(
            t_s=t_s,
            position_m=np.array([0.0, position_m, 0.0]),
            velocity_m_s=np.array([0.0, velocity_m_s, 0.0]),
            clutch=True,
        )
        is_sent = k % every == 0 and rng.random() > 0.02
        report = watch.update(sample if is_sent else None, DT)

        assert (report.fault, report.doubt) == ("", "")


def watch_handle(*samples):
    """What is said of the last of such positions and velocities along z, every 1 ms."""
    watch = HandleWatch()
    for k, (position_m, velocity_m_s) in enumerate(samples):
        sample = SimpleNamespace(
            t_s=k * DT,
            position_m=np.array([0.0, 0.0, position_m]),
            velocity_m_s=np.array([0.0, 0.0, velocity_m_s]),
            clutch=True,
        )
        report = watch.update(sample, DT)
    return report


@pytest.mark.parametrize(("repeats", "is_frozen"), [(29, False), (31, True)])
def test_a_moving_handle_that_repeats_itself_for_30_ms_is_frozen(repeats, is_frozen):
    report = watch_handle(*[(0.0, 0.01)] * (repeats + 1))

    assert ("frozen" in report.fault) == is_frozen


@pytest.mark.parametrize(("step_m", "is_jump"), [(4.8e-3, False), (5.2e-3, True)])
def test_a_handle_jumps_by_more_than_5_mm(step_m, is_jump):
    assert watch_handle((0.0, 0.0), (step_m, 0.0)).has_jumped == is_jump


def test_a_velocity_that_is_wrong_now_and_then_is_late():
    """Wrong for 20 ms, right for 0.1 s, again and again; 40 ms in a row are a fault."""
    wrong = [(1e-6 * k, 0.1) for k in range(20)]
    right = [(1e-6 * k, 1e-3) for k in range(20, 120)]

    assert watch_handle(*(wrong + right) * 3, *wrong).doubt == ""
    assert "contradicts" in watch_handle(*right, *wrong * 4).doubt
