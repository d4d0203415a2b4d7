"""A force that no tissue exerts is reported, and no rupture."""

import math

import numpy as np
import pytest

from identification import SampleStatus, TissueWarning
from identification.mixture.block import Block
from identification.mixture.foreign_force import NeedlePull, NetForce, RestForce
from tests.identification.worlds import noisy, rows_of, run, straight

STEP_S = 2e-3
SPEED_M_S = 5e-3
TICKS = 4_500
RUPTURE = 2_500
DEPTH_M = SPEED_M_S * STEP_S * np.arange(TICKS)


def insert(fault_N, end=TICKS, force_std_N=0.0):
    """Estimates of a course with a fault, a force a sample.

    After 10 mm of air come a layer and 20 mm of another; the noise is 10 mN.
    """
    into_m = np.maximum(DEPTH_M - 10e-3, 0.0)
    friction_N = np.interp(into_m, [0.0, 15e-3, 35e-3], [0.0, 0.36, 1.16])
    tip_N = np.where(into_m < 15e-3, into_m * 40.0, 0.0)
    force_N = noisy(friction_N + tip_N, 0.01, 3) + fault_N
    rows = rows_of(DEPTH_M, SPEED_M_S, force_N, STEP_S)[:end]
    return run((*row, None, force_std_N) for row in rows)[1]


def events(estimates, name):
    """Samples with an event of that name."""
    return [k for k, e in enumerate(estimates) if getattr(e, name) is not None]


def alarms(estimates):
    """Samples with an alarm that is not retracted within half a second."""
    raised, retracted = (events(estimates, name) for name in ("rupture", "retracted"))
    return [k for k in raised if not any(0 < n - k <= 250 for n in retracted)]


def reported(estimates):
    """Samples whose force is said to be no tissue's."""
    return [
        k for k, e in enumerate(estimates) if e.status is SampleStatus.NEEDLE_PULLED
    ]


def step(start, step_N):
    """A force that falls for good, and the samples at which that is to be reported."""
    return lambda k: step_N * (k >= start), start + 500, (start, start + 20), None


@pytest.mark.parametrize(
    ("fault_at", "end", "begin", "ruptures"),
    [
        (lambda k: 0.0 * k, TICKS, None, 1),
        *(step(k, n) for k in (700, 1_200, 2_300, 2_700, 3_500) for n in (-2.0, -5.0)),
        # A push at the hub that ends
        (lambda k: -10.0 * ((k >= 1_500) & (k < 2_000)), TICKS, (1_500, 1_506), 1),
        # A drift
        (lambda k: -np.clip((k - 1_600) / 100, 0.0, 5.0), 2_400, (1_600, 1_750), 0),
    ],
)
def test_a_force_below_zero_is_reported_and_no_rupture(fault_at, end, begin, ruptures):
    estimates = insert(fault_at(np.arange(TICKS)), end)
    real = [k for k in alarms(estimates) if RUPTURE < k < RUPTURE + 50]
    told = reported(estimates)

    assert alarms(estimates) == real
    assert ruptures in (None, len(real))
    assert bool(told) == (begin is not None)
    assert not any(estimates[k].status.is_used for k in told)
    if begin:
        assert begin[0] <= told[0] < begin[1]
    if ruptures == 1:
        assert max(told, default=0) <= 2_010


def test_a_push_that_leaves_a_plausible_force_is_retracted_once_the_hand_lets_go():
    k = np.arange(TICKS)
    push_N = -1.05 * ((k >= 3_500) & (k < 4_000))
    estimates = insert(push_N, 4_200, force_std_N=0.25)
    raised, retracted = (events(estimates, name) for name in ("rupture", "retracted"))

    assert 3_500 < raised[-1] < 3_550
    assert 4_000 < retracted[-1] < 4_020
    assert 4_000 < reported(estimates)[0] < 4_020


def test_a_force_that_stays_below_zero_becomes_a_new_zero():
    ticks = np.arange(3_000)
    force_N = noisy(-1.0 * (ticks >= 700), 0.01, 5)
    _, estimates = run(rows_of(1e-5 * ticks, SPEED_M_S, force_N, STEP_S))
    first, *_, last = reported(estimates)

    assert 700 <= first < 710 < 1_940 < last < 1_980  # 2.5 s later
    assert abs(estimates[-1].tip_force_N) < 0.05


def pulled(forces_N, *lasts, std_N=0.03, **place):
    """The pull after blocks of an advancing needle, then after some others."""
    pull = NeedlePull()
    advancing = {"is_advancing": True, "behind_mm": 0.0} | place
    blocks = [{"value_N": force_N} | advancing for force_N in forces_N]
    blocks += [{"is_advancing": False, "behind_mm": 0.0} | last for last in lasts]
    for k, block in enumerate(blocks):
        force = NetForce(std_N=std_N, time_s=0.01 * k, duration_s=0.01, **block)
        pull = pull.with_force(force)
    return pull


PUSHED = [1.0] * 50
RESTED = [{"value_N": 1.0}] * 30


@pytest.mark.parametrize(
    ("forces_N", "lasts", "is_pulled", "is_foreign"),
    [
        # Friction that turns at a reversal passes zero within a tenth of a millimetre.
        (PUSHED, [{"value_N": -0.2}], True, True),
        (PUSHED, [{"value_N": -0.2, "behind_mm": 0.02}], True, True),
        (PUSHED, [{"value_N": -0.2, "behind_mm": 0.04}], False, False),
        # Behind its deepest point tissue holds a pulled needle, as friction has turned.
        ([-1.0] * 50, [{"value_N": -1.0, "behind_mm": 0.05}], True, True),
        ([-1.0] * 50, [{"value_N": -1.0, "behind_mm": 0.15}], False, False),
        # A needle at rest where it has advanced to is not pulled by tissue.
        (PUSHED, [*RESTED, {"value_N": -0.05}], False, False),
        (PUSHED, [*RESTED, {"value_N": -0.5}], True, True),
        # A needle drawn back is pulled by no more than tissue has pushed.
        (PUSHED, [{"value_N": -0.9, "behind_mm": 5.0}], False, False),
        (PUSHED, [{"value_N": -1.2, "behind_mm": 5.0}], True, True),
        # One that has come out is pulled by nothing.
        (
            PUSHED,
            [{"value_N": -0.5, "behind_mm": 50.0, "is_outside": True}],
            True,
            True,
        ),
        # Tissue that moves pulls slowly, a sensor at fault beyond its friction.
        ([*PUSHED, *np.linspace(1.0, -0.7, 50)], [], True, False),
        ([*PUSHED, *np.linspace(1.0, -1.0, 60), -1.05, -1.1, -1.2], [], True, True),
    ],
)
def test_what_pulls_and_what_tissue_cannot_do(forces_N, lasts, is_pulled, is_foreign):
    pull = pulled(forces_N, *lasts)

    assert (pull.is_pulled, pull.is_foreign) == (is_pulled, is_foreign)


@pytest.mark.parametrize(
    ("friction_N", "ticks", "is_foreign"),
    [(0.0, 30, False), (0.5, 30, True), (0.5, 14, False), (0.28, 30, False)],
)
def test_a_quick_fall_below_the_friction_of_layers_traversed_is_no_rupture(
    friction_N, ticks, is_foreign
):
    forces_N = [*PUSHED, *[0.2] * ticks]

    assert pulled(forces_N, friction_N=friction_N).is_foreign == is_foreign


def test_alarms_wait_no_longer_than_a_step_takes():
    """A force that stays between half the limit and the limit blocks no alarm."""
    rng = np.random.default_rng(3)
    forces_N = [*PUSHED, *(-0.07 + 0.005 * rng.normal(size=200))]
    waits = [pulled(forces_N[:k]).may_pull for k in range(51, 251)]

    assert waits[0]
    assert 10 < sum(waits[:20]) == sum(waits) < 20


def rest(force_at, seconds, *, depth_at=lambda _: 30.0, std_N=0.05, has_ruptured=False):
    """Times at which the force on a needle at rest is said to be no tissue's."""
    held = RestForce()
    foreign_s = []
    noise = {"duration_s": 0.01, "noise_std_N": 0.02, "depth_std_mm": 2e-3}
    for time_s in (0.01 * np.arange(round(100.0 * seconds))).tolist():
        block = Block(depth_mm=depth_at(time_s), **noise)
        force_N = force_at(time_s)
        held = held.with_force(block, force_N, std_N, has_ruptured=has_ruptured)
        foreign_s += [time_s] * held.is_foreign
    return foreign_s


@pytest.mark.parametrize(
    ("change_N", "seconds", "last_s"),
    [
        (-0.8, 2.0, pytest.approx(1.99)),
        (0.8, 2.0, pytest.approx(1.99)),
        (-0.8, 4.0, pytest.approx(2.0, abs=0.03)),  # the hand lets go after 2 s
    ],
)
def test_a_quick_change_at_rest_is_foreign_after_a_tenth_of_a_second(
    change_N, seconds, last_s
):
    foreign_s = rest(lambda t_s: 1.0 + change_N * (1.0 < t_s < 2.0), seconds)

    assert 1.1 < foreign_s[0] < 1.15
    assert foreign_s[-1] == last_s


def breath_N(t_s):
    return 0.6 * math.sin(2.0 * math.pi * 0.25 * t_s)


@pytest.mark.parametrize(
    ("force_at", "seconds", "settings", "is_foreign"),
    [
        # A change is more than four tenths of the force and lasts for a tenth of a
        # second.
        (lambda t_s: 2.0 - 0.7 * (t_s > 1.0), 2.0, {}, False),
        (lambda t_s: 2.0 - 0.9 * (t_s > 1.0), 2.0, {}, True),
        (lambda t_s: 1.0 - 0.8 * (1.0 < t_s % 1.2 < 1.08), 3.0, {}, False),
        # An arm that begins to move changes it before the needle has moved.
        (
            lambda t_s: 1.0 - min(max(t_s - 1.0, 0.0) / 0.03, 1.0),
            2.0,
            {"depth_at": lambda t_s: 30.0 - 50.0 * max(t_s - 1.0, 0.0) ** 2},
            False,
        ),
        # Within the sensor's slow error it is not judged.
        (lambda t_s: 1.0 + 0.5 * (t_s > 1.0), 3.0, {"std_N": 0.3}, False),
        (lambda t_s: 1.0 + breath_N(t_s), 8.0, {}, False),
        # After a rupture tissue relaxes, and a sensor drifts; else tissue may move.
        (lambda t_s: math.exp(-t_s / 4.0), 1.2, {"has_ruptured": True}, False),
        (lambda t_s: 1.0 - 1.25 * t_s, 1.2, {"has_ruptured": True}, True),
        (lambda t_s: 1.0 - 0.8 * t_s, 1.2, {}, False),
    ],
)
def test_what_changes_the_force_at_rest(force_at, seconds, settings, is_foreign):
    assert bool(rest(force_at, seconds, **settings)) == is_foreign


@pytest.mark.parametrize(
    ("change_N", "is_foreign"), [(0.0, False), (-0.5, True), (0.6, True)]
)
def test_a_force_that_jumps_at_a_resting_needle_is_reported(change_N, is_foreign):
    rows = straight(seed=2)[:3_500]
    forces_N = noisy(0.5 + change_N * (np.arange(2_000) > 1_500), 5e-3, 4)
    _, estimates = run(rows + rows_of(rows[-1].depth_m, 0.0, forces_N, 1e-3))

    assert bool(reported(estimates)) == is_foreign


COUGH_S = 6.0


def cough_m(time_s):
    """Tissue that jumps towards the needle by 4 mm, within a tenth of a second."""
    return -4e-3 * math.exp(-0.5 * ((time_s - COUGH_S) / 0.05) ** 2)


def test_a_force_that_no_hypothesis_explains_is_said_and_in_the_deviations():
    _, estimates = run(straight(seed=3, motion_m=cough_m))
    said_s = [e.time_s for e in estimates if TissueWarning.UNEXPLAINED in e.warnings]
    before, after = (
        estimates[round(1e3 * (COUGH_S + later_s))] for later_s in (-1.0, 1.0)
    )

    assert COUGH_S - 0.3 < said_s[0] < COUGH_S + 0.5
    # It is held for three seconds after the last of it.
    assert COUGH_S + 3.0 < said_s[-1] < estimates[-1].time_s
    assert after.tip_force_std_N > 3.0 * before.tip_force_std_N
