"""A force that no tissue exerts is reported, and no rupture."""

import numpy as np
import pytest

from identification import Identifier, SampleStatus
from identification.mixture.needle_pull import NeedlePull, NetForce

STEP_s = 2e-3
SPEED_m_s = 5e-3
PULLED = SampleStatus.NEEDLE_PULLED


def course(seed=3):
    """Depth and force, with 10 mN of noise: 10 mm of air, a layer, 20 mm of another."""
    depth_m = SPEED_m_s * STEP_s * np.arange(4_500)
    into_m = np.maximum(depth_m - 10e-3, 0.0)
    first_N = np.minimum(into_m, 15e-3) * 60.0
    second_N = np.maximum(into_m - 15e-3, 0.0) * 40.0
    tip_N = np.where(into_m < 15e-3, into_m * 40.0, 0.0)
    noise_N = 0.01 * np.random.default_rng(seed).normal(size=len(depth_m))
    return depth_m, 0.4 * first_N + second_N + tip_N + noise_N


def insert(fault_N):
    """Estimates of the course with a fault, a force a sample."""
    depth_m, force_N = course()
    identifier = Identifier()
    return [
        identifier.update(float(depth), SPEED_m_s, float(force), STEP_s)
        for depth, force in zip(depth_m, force_N + fault_N, strict=True)
    ]


def alarms(estimates):
    """Samples with an alarm that is not retracted within half a second."""
    raised = [k for k, e in enumerate(estimates) if e.rupture is not None]
    retracted = [k for k, e in enumerate(estimates) if e.retracted is not None]
    return [k for k in raised if not any(0 < n - k <= 250 for n in retracted)]


def reported(estimates):
    return [k for k, e in enumerate(estimates) if e.status is PULLED]


RUPTURE = 2_500


def test_a_rupture_is_no_pull():
    estimates = insert(np.zeros(4_500))
    (alarm,) = alarms(estimates)

    assert RUPTURE < alarm < RUPTURE + 50
    assert reported(estimates) == []


@pytest.mark.parametrize("step_N", [-2.0, -5.0])
@pytest.mark.parametrize("start", [700, 1_200, 2_300, 2_700, 3_500])
def test_a_step_below_zero_is_reported_and_no_rupture(start, step_N):
    fault_N = np.where(np.arange(4_500) >= start, step_N, 0.0)
    estimates = insert(fault_N)[: start + 500]
    real = [k for k in alarms(estimates) if RUPTURE < k < RUPTURE + 50]

    assert start <= reported(estimates)[0] < start + 20
    assert alarms(estimates) == real
    assert not any(estimates[k].status.is_used for k in reported(estimates))


def test_a_push_at_the_hub_ends_and_the_rupture_is_found():
    k = np.arange(4_500)
    estimates = insert(np.where((k >= 1_500) & (k < 2_000), -10.0, 0.0))

    assert 1_500 <= reported(estimates)[0] <= 1_505
    assert reported(estimates)[-1] <= 2_010
    (alarm,) = alarms(estimates)
    assert RUPTURE < alarm < RUPTURE + 50


def test_a_drift_below_zero_is_reported_and_its_alarms_retracted():
    k = np.arange(4_500)
    estimates = insert(-5.0 * np.clip((k - 1_600) / 500, 0.0, 1.0))[:2_400]

    assert 1_600 < reported(estimates)[0] < 1_750
    assert alarms(estimates) == []


def test_a_force_that_stays_below_zero_becomes_a_new_zero():
    identifier = Identifier()
    force_N = np.where(np.arange(3_000) >= 700, -1.0, 0.0)
    noise_N = 0.01 * np.random.default_rng(5).normal(size=3_000)
    estimates = [
        identifier.update(1e-5 * k, SPEED_m_s, float(force), STEP_s)
        for k, force in enumerate(force_N + noise_N)
    ]

    assert 700 <= reported(estimates)[0] < 710
    assert 1_940 < reported(estimates)[-1] < 1_980  # 2.5 s later
    assert abs(estimates[-1].tip_force_N) < 0.05


def test_friction_on_a_needle_drawn_back_is_no_pull():
    identifier = Identifier()
    depth_m, force_N = course()
    for depth, force in zip(depth_m[:2_000], force_N[:2_000], strict=True):
        identifier.update(float(depth), SPEED_m_s, float(force), STEP_s)
    back_m = SPEED_m_s * STEP_s * np.arange(1, 500)
    friction_N = 0.4 * (2.0 * np.exp(-back_m / 0.3e-3) - 1.0)
    back = [
        identifier.update(float(depth), -SPEED_m_s, float(force), STEP_s)
        for depth, force in zip(depth_m[1_999] - back_m, friction_N, strict=True)
    ]

    assert reported(back) == []


def test_a_snapshot_amid_a_pull_goes_on_bit_for_bit():
    depth_m, force_N = course()
    force_N = force_N - 3.0 * (np.arange(4_500) >= 1_500)
    identifier = Identifier()
    rows = [
        (float(d), SPEED_m_s, float(f), STEP_s)
        for d, f in zip(depth_m, force_N, strict=True)
    ]
    for row in rows[:1_600]:
        identifier.update(*row)
    resumed = Identifier()
    resumed.restore(identifier.snapshot())

    assert [identifier.update(*row) for row in rows[1_600:1_700]] == [
        resumed.update(*row) for row in rows[1_600:1_700]
    ]


@pytest.mark.parametrize(("behind_mm", "is_pulled"), [(0.0, True), (0.06, False)])
def test_a_needle_just_drawn_back_is_held_and_not_pulled(behind_mm, is_pulled):
    """Friction that turns at a reversal passes zero within a tenth of a millimetre."""
    advancing = NetForce(1.0, 0.005, 10.0, 0.01, is_advancing=True, behind_mm=0.0)
    after = NetForce(-0.2, 0.005, 10.05, 0.01, is_advancing=False, behind_mm=behind_mm)

    pull = NeedlePull().with_force(advancing).with_force(after)

    assert pull.is_pulled == is_pulled


def pull_of(force_at, seconds):
    """The pull at every block of an advancing needle, for a force over time."""
    pull = NeedlePull()
    pulls = []
    for time_s in np.arange(0.0, seconds, 0.01).tolist():
        force = NetForce(
            force_at(time_s), 0.005, time_s, 0.01, is_advancing=True, behind_mm=0.0
        )
        pull = pull.with_force(force)
        pulls.append((time_s, pull))
    return pulls


def test_a_zero_is_new_once_the_force_has_been_steady_for_two_and_a_half_seconds():
    """A force that still falls is no zero, however long it has fallen."""
    pulls = pull_of(lambda time_s: -max(min(time_s, 4.0), 0.0), 8.0)
    new_s = [time_s for time_s, pull in pulls if pull.is_new_zero(time_s)]

    assert new_s[0] == pytest.approx(6.5, abs=0.1)


@pytest.mark.parametrize(("behind_mm", "is_pulled"), [(0.05, True), (0.15, False)])
def test_a_pulled_needle_that_is_drawn_back_is_pulled_no_more(behind_mm, is_pulled):
    """Behind its deepest point tissue holds it, as friction has turned."""
    _, pull = pull_of(lambda _: -1.0, 0.5)[-1]
    back = NetForce(-1.0, 0.005, 0.5, 0.01, is_advancing=False, behind_mm=behind_mm)

    assert pull.is_pulled
    assert pull.with_force(back).is_pulled == is_pulled


def block(value_N, time_s, behind_mm=0.0, *, is_advancing=True, std_N=0.03, **place):
    return NetForce(
        value_N, std_N, time_s, 0.01, is_advancing, behind_mm=behind_mm, **place
    )


def pull_after(forces_N, **after):
    """The pull after a course of an advancing needle, and one more block."""
    pull = NeedlePull()
    for k, force_N in enumerate(forces_N):
        pull = pull.with_force(block(force_N, 0.01 * k))
    return (
        pull.with_force(block(time_s=0.01 * len(forces_N), **after)) if after else pull
    )


PUSHED = [1.0] * 50


@pytest.mark.parametrize(("force_N", "is_pulled"), [(-0.05, False), (-0.5, True)])
def test_a_needle_at_rest_where_it_has_advanced_to_is_not_pulled_by_tissue(
    force_N, is_pulled
):
    pull = pull_after(PUSHED, value_N=1.0, is_advancing=False)
    for k in range(51, 81):
        pull = pull.with_force(block(1.0, 0.01 * k, is_advancing=False))
    pull = pull.with_force(block(force_N, 0.81, is_advancing=False))

    assert pull.is_foreign == is_pulled


@pytest.mark.parametrize(("force_N", "is_pulled"), [(-0.9, False), (-1.2, True)])
def test_a_needle_drawn_back_is_pulled_by_no_more_than_tissue_has_pushed(
    force_N, is_pulled
):
    pull = pull_after(PUSHED, value_N=force_N, is_advancing=False, behind_mm=5.0)

    assert pull.is_foreign == is_pulled


def test_a_needle_that_has_come_out_is_pulled_by_nothing():
    outside = {"is_advancing": False, "behind_mm": 50.0, "is_outside": True}
    pull = pull_after(PUSHED, value_N=-0.5, **outside)

    assert pull.is_foreign


def test_tissue_that_moves_pulls_slowly_and_a_sensor_at_fault_beyond_its_friction():
    falling_N = np.linspace(1.0, -1.0, 60).tolist()
    slow = pull_after([*PUSHED, *falling_N[:50]])
    beyond = pull_after([*PUSHED, *falling_N, -1.05, -1.1, -1.2])

    assert slow.is_pulled
    assert not slow.is_foreign
    assert beyond.is_foreign


@pytest.mark.parametrize("friction_N", [0.0, 0.5])
def test_a_quick_fall_below_the_friction_of_layers_traversed_is_no_rupture(friction_N):
    pull = NeedlePull()
    for k in range(80):
        value_N = 1.0 if k < 50 else 0.2
        pull = pull.with_force(block(value_N, 0.01 * k, friction_N=friction_N))

    assert pull.is_foreign == (friction_N > 0.0)


def test_alarms_wait_no_longer_than_a_step_takes():
    """A force that stays between half the limit and the limit blocks no alarm."""
    rng = np.random.default_rng(3)
    pull = pull_after(PUSHED)
    waits = []
    for k in range(50, 250):
        value_N = -0.07 + 0.005 * rng.normal()
        pull = pull.with_force(block(value_N, 0.01 * k))
        waits.append(pull.may_pull)

    assert waits[0]
    assert 0.1 < 0.01 * sum(waits) < 0.2
    assert not any(waits[20:])


def test_a_push_that_leaves_a_plausible_force_is_no_rupture_once_the_hand_lets_go():
    depth_m, force_N = course()
    k = np.arange(4_500)
    force_N = force_N - 1.05 * ((k >= 3_500) & (k < 4_000))
    identifier = Identifier()
    estimates = [
        identifier.update(float(d), SPEED_m_s, float(f), STEP_s, force_std_N=0.25)
        for d, f in zip(depth_m[:4_200], force_N, strict=False)
    ]
    raised = [k for k, e in enumerate(estimates) if e.rupture is not None]
    retracted = [k for k, e in enumerate(estimates) if e.retracted is not None]

    assert 3_500 < raised[-1] < 3_550
    assert 4_000 < retracted[-1] < 4_020
    assert 4_000 < reported(estimates)[0] < 4_020
