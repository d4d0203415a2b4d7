"""Faults of the haptic device: the needle stands, the hand is not hurt, and why is
said."""

from types import SimpleNamespace

import numpy as np
import pytest

from groundtruth import HapticMaster, Operator
from needleforce.control import Beside, HandleWatch, State
from tests.needleforce.control.haptic import (
    DT,
    answer,
    estimate,
    handle,
    push,
    teleoperate,
    track,
)
from tests.needleforce.control.managed_session import inserting, play, run

FAULT_S = 1.0


def changed(sample, **changes):
    """Return a device's sample with something changed."""
    return SimpleNamespace(**vars(sample) | changes)


def jumping(offset_m, seconds=np.inf):
    def fault(t_s, sample):
        is_there = FAULT_S <= t_s < FAULT_S + seconds
        return changed(
            sample, position_m=sample.position_m + is_there * np.array(offset_m)
        )

    return fault


def replaced(**parts):
    return lambda t_s, sample: changed(sample, **parts if t_s >= FAULT_S else {})


def frozen(**parts):
    first = []

    def fault(t_s, sample):
        if t_s < FAULT_S:
            first[:] = [sample]
        return changed(first[0], **parts if t_s >= FAULT_S else {})

    return fault


FAULTS = {
    "jumps and stays": (jumping((0.0, 0.0, 0.1)), "100 mm"),
    "jumps back": (jumping((0.0, 0.0, -0.1)), "100 mm"),
    "jumps by 8 mm": (jumping((0.0, 0.0, 8e-3)), "8 mm"),
    "jumps across": (jumping((0.0, 0.2, 0.0)), "200 mm"),
    "jumps for a sample": (jumping((0.0, 0.0, 0.1), DT), "jumped"),
    "nan position": (replaced(position_m=np.full(3, np.nan)), "finite"),
    "nan velocity": (replaced(velocity_m_s=np.full(3, np.nan)), "finite"),
    "two numbers": (replaced(position_m=np.zeros(2)), "finite"),
    "frozen": (frozen(), "repeated"),
    "frozen, no stamp": (frozen(t_s=None), "repeated"),
    "gone": (lambda t_s, sample: sample if t_s < FAULT_S else None, "silent"),
    "quick": (replaced(velocity_m_s=np.array([0.0, 0.0, 1.0])), "contradicts"),
    "quick back": (replaced(velocity_m_s=np.array([0.0, 0.0, -1.0])), "contradicts"),
    "askew": (replaced(velocity_m_s=np.array([0.3, 0.0, 0.1])), "contradicts"),
}
SEEN_BY_MANAGER = ("nan", "two", "frozen", "gone")


def stamped(sample):
    """Return a device's sample as something that can be changed."""
    names = ("t_s", "position_m", "velocity_m_s", "clutch")
    return SimpleNamespace(**{name: getattr(sample, name) for name in names})


def drive(fault, hand_m_s, *, ticks=2500, stiffness=500.0, **tele_settings):
    """Drive a needle into a spring 2 mm away, a hand that has a fault after 1 s.

    Returns depth [m] and force on the hand [N] of every tick, its place in the end [m],
    and the reasons for which the needle stands.
    """
    device = HapticMaster(Operator(wish_m=lambda t_s: (0.0, 0.0, hand_m_s * t_s)))
    samples = (fault(k * DT, stamped(device.read())) for k in range(ticks))
    spring_N = lambda depth_m, speed_m_s: stiffness * max(depth_m - 2e-3, 0.0)  # noqa: E731
    rows = track(teleoperate(**tele_settings), samples, spring_N, device=device)
    return rows[0], rows[2], device.position_m[2], rows[4]


@pytest.mark.parametrize("hand_m_s", [0.01, 0.1, -0.03])
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_the_handle_neither_drives_the_needle_nor_hurts(name, hand_m_s):
    fault, reason = FAULTS[name]
    depth_m, force_N, _, reasons = drive(fault, hand_m_s, ticks=1300)
    at = round(FAULT_S / DT)

    assert np.abs(depth_m[at:] - depth_m[at - 1]).max() <= 1e-3
    assert np.abs(force_N).max() <= 5.0
    assert np.diff(np.abs(force_N), prepend=0.0).max() <= 0.5 + 1e-9
    assert not any(reasons[:at])
    assert reason in reasons[at + 50]
    assert reason in reasons[-1]


@pytest.mark.parametrize("name", [n for n in FAULTS if n.startswith(SEEN_BY_MANAGER)])
def test_the_manager_stops_without_a_usable_handle(name):
    manager, sensor = inserting()
    device = HapticMaster(Operator(wish_m=lambda t_s: (0.0, 0.0, 0.02 * t_s)))
    fault, reason = FAULTS[name]
    watch = HandleWatch()
    reports = [
        watch.update(fault(k * DT, stamped(device.read())), DT)
        for k in range(round(FAULT_S / DT) + 50)
    ]
    besides = [Beside(handle=report) for report in reports]
    play(manager, sensor, "arrived", besides[0], 1e-3, "teleoperate")
    states = [run(manager, DT, beside).state for beside in besides]

    assert set(states[: round(FAULT_S / DT)]) == {State.TELEOP}
    assert reason in run(manager, DT, besides[-1]).reason
    play(manager, sensor, State.STOPPED, "release", "!teleoperate device")


def test_the_needle_follows_again_once_the_clutch_was_opened():
    """A jump is no way: the needle goes on from where both are."""
    jump = jumping((0.0, 0.0, 0.1))

    def fault(t_s, sample):
        return changed(jump(t_s, sample), clutch=not 1.4 <= t_s < 1.5)

    depth_m, _, _, reasons = drive(fault, 0.01, stiffness=0.0)

    assert depth_m[1400] - depth_m[1010] == pytest.approx(0.0, abs=1e-5)
    assert depth_m[-1] - depth_m[1500] == pytest.approx(0.4 * 0.01 * 1.0, abs=2e-4)
    assert reasons[1399]
    assert not reasons[1400]


def test_an_open_clutch_feels_free():
    """A quick hand with the clutch open is not held back by more than 0.5 N."""
    _, force_N, _, _ = drive(
        lambda t_s, sample: changed(sample, clutch=t_s < 1.0), 0.03, stiffness=2000.0
    )

    assert np.abs(force_N[:1000]).max() > 2.0
    assert np.abs(force_N[1000:]).max() <= 0.5


def test_the_largest_force_is_a_setting():
    _, force_N, _, _ = drive(
        lambda t_s, sample: sample, 0.05, stiffness=2000.0, max_force_N=1.5
    )

    assert np.abs(force_N).max() == pytest.approx(1.5)


def test_a_device_without_velocity_drives_the_needle_too():
    """Velocities that are always zero are none: those of the positions count."""
    depth_m, _, hand_m, reasons = drive(
        lambda t_s, sample: changed(sample, velocity_m_s=np.zeros(3)),
        0.02,
        stiffness=0.0,
    )

    assert depth_m[-1] == pytest.approx(0.4 * hand_m, abs=1e-3)
    assert not any(reasons)


@pytest.mark.parametrize(
    "sample",
    [
        handle(position_m=None),
        handle(position_m=(0.0, 0.0)),
        handle(position_m=((0.0,), 1.0, 2.0)),
        handle(velocity_m_s=(0.0, 0.0, 1e300)),
        handle(velocity_m_s=(0.0, np.nan, 0.0)),
        handle(clutch=np.zeros(3)),
        SimpleNamespace(position_m=np.zeros(3), velocity_m_s=np.zeros(3)),
        SimpleNamespace(),
    ],
)
def test_an_impossible_handle_sample_counts_as_none(sample):
    """A sample that no handle can have given counts as none."""
    good = [handle(2e-5 * k, 0.02) for k in range(100)]
    forces_N = []
    for wrong in (sample, None):
        samples = [*good[:50], wrong, *good[51:]]
        forces_N.append(track(teleoperate(), samples, push(1.0))[2])

    assert np.abs(forces_N[0]).max() > 0.01
    assert forces_N[0].tolist() == forces_N[1].tolist()


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_a_velocity_that_positions_contradict_counts_along_them_and_no_faster(way):
    watch = HandleWatch()
    for k in range(400):
        sample = handle(way * 1e-4 * k, velocity_m_s=np.array([0.3, 0.0, way * 0.05]))
        used = watch.update(sample, DT).reading

    assert used.velocity_m_s == pytest.approx([0.0, 0.0, way * 0.05], abs=1e-6)


def reasons_of(samples):
    """Return why the needle stands, of every sample; None is one that was not sent."""
    tele = teleoperate()
    return [answer(tele, sample, estimate(0.0)).reason for sample in samples]


@pytest.mark.parametrize("every", [1, 3, 10])
@pytest.mark.parametrize("lag_s", [0.0, 5e-3])
def test_a_swinging_hand_is_believed(every, lag_s):
    """4 Hz with an amplitude of 10 mm, the velocity late, samples now and then lost."""
    rng = np.random.default_rng(3)
    t_s = DT * np.arange(3000)
    omega = 2.0 * np.pi * 4.0
    z_m = np.round(1e-2 * np.sin(omega * t_s), 5)
    speed_m_s = 1e-2 * omega * np.cos(omega * (t_s - lag_s))
    samples = [
        handle(z_m[k], speed_m_s[k], t_s=t_s[k])
        if k % every == 0 and rng.random() > 0.02
        else None
        for k in range(3000)
    ]

    assert not any(reasons_of(samples))


LATE = [handle(1e-6 * k, 0.1, t_s=k) for k in range(20)]
RIGHT = [handle(1e-6 * k, 1e-3, clutch=False, t_s=k) for k in range(20, 120)]


@pytest.mark.parametrize(
    ("samples", "reason"),
    [
        # A device whose clock goes on may report the same place for long.
        ([handle(1.0, t_s=k * DT) for k in range(500)], None),
        # One that says it moves may not, for 30 ms.
        ([handle(0.0, 0.01, t_s=k) for k in range(30)], None),
        ([handle(0.0, 0.01, t_s=k) for k in range(32)], "frozen"),
        # A jump is more than 5 mm.
        ([handle(), handle(4.8e-3, 0.0)], None),
        ([handle(), handle(5.2e-3, 0.0)], "jumped"),
        # A velocity may be wrong for 20 ms now and then, not for 80 ms in a row.
        ((LATE + RIGHT) * 3 + LATE, None),
        (RIGHT + LATE * 4, "contradicts"),
    ],
)
def test_a_handle_is_doubted_from_a_limit_on(samples, reason):
    last = reasons_of(samples)[-1]

    assert last == "" if reason is None else reason in last
