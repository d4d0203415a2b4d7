"""A hard contact is an event of its own, and a hand that trembles hides no rupture."""

from dataclasses import replace

import numpy as np
import pytest

from groundtruth import (
    Layer,
    ShaftFriction,
    Tremor,
    constant_motion,
    insert_needle,
    random_stack,
    scenario,
)
from identification import Identifier, MixtureConfig, TissueWarning
from identification.mixture.block import Block
from identification.mixture.needle_swing import NeedleSwing, update_swing
from identification.mixture.tissue_doubt import HardContactState
from tests.identification.worlds import follow, values_of

BONE_DEPTH_M = 15e-3
BOUND_N_PER_MM = 4.0
STEP_MM = 0.02


def insert_onto(stiffness_N_per_m, speed_m_s=3e-3, **settings):
    """An insertion through muscle onto something, up to 8 N more."""
    muscle = Layer(
        name="muscle",
        thickness_m=BONE_DEPTH_M,
        exit_force_N=0.8,
        cutting_fraction=0.1,
        stiffening=0.1,
        release_m=0.3e-3,
        relaxed_fraction=0.4,
        friction=ShaftFriction.calibrated(
            force_N_per_m=10.0,
            reference_speed_m_s=3e-3,
            coulomb_fraction=0.6,
            presliding_m=0.3e-3,
        ),
    )
    bone = replace(
        muscle,
        name="bone",
        thickness_m=20e-3,
        exit_force_N=20e-3 * stiffness_N_per_m,
        cutting_fraction=0.0,
    )
    motion = constant_motion(
        speed_m_s=speed_m_s,
        depth_m=BONE_DEPTH_M + 8.0 / stiffness_N_per_m,
        standoff_m=5e-3,
    )
    stack = random_stack(np.random.default_rng(0))
    chosen = replace(stack, layers=(muscle, bone), motion=motion)
    run = insert_needle(chosen, seed=3, rate_hz=250.0)
    _, estimates, _ = follow(run, Identifier(MixtureConfig(**settings)))
    return values_of(estimates, "hard_contact"), estimates


@pytest.mark.parametrize(
    ("stiffness_N_per_m", "speed_m_s"), [(8e3, 1.5e-3), (40e3, 5e-3)]
)
def test_bone_is_one_event_soon_after_the_contact(stiffness_N_per_m, speed_m_s):
    [contact], estimates = insert_onto(stiffness_N_per_m, speed_m_s)

    assert BONE_DEPTH_M < contact.depth_m < BONE_DEPTH_M + 0.4e-3
    assert contact.growth_N_per_m > 4000.0
    assert contact.force_N < 4.0
    assert TissueWarning.HARD_CONTACT in estimates[-1].warnings


def test_what_counts_as_hard_is_a_setting():
    soft, _ = insert_onto(1500.0)
    [contact], _ = insert_onto(1500.0, hard_contact_N_per_m=800.0)

    assert soft == []
    assert contact.growth_N_per_m == pytest.approx(1500.0, rel=0.4)


def pushed(state, depths_mm, forces_N, *, speed_mm_s=2.0, is_even=True):
    """The state after blocks of such depths and forces, and the contacts found."""
    found = 0
    columns = np.broadcast_arrays(depths_mm, forces_N, speed_mm_s)
    for depth_mm, force_N, speed in np.transpose(columns).tolist():
        block = Block(depth_mm=depth_mm, speed_mm_s=speed, noise_std_N=0.005)
        state = state.with_force(block, force_N, BOUND_N_PER_MM, is_even=is_even)
        found += state.is_new
    return state, found


def test_bone_is_hard_until_half_of_its_force_is_gone_and_may_be_met_again():
    depths_mm = STEP_MM * np.arange(75)
    forces_N = 0.3 + 12.0 * np.maximum(depths_mm - 1.0, 0.0)
    state, found = pushed(HardContactState(), depths_mm, forces_N)
    near, _ = pushed(state, [1.4], [0.6 * state.force_N])
    away, _ = pushed(state, [0.5], [0.4 * state.force_N])
    again, _ = pushed(away, depths_mm[25:], forces_N[25:])
    growths_N = BOUND_N_PER_MM * np.maximum(depths_mm - 1.0, 0.0)
    contacts = [
        pushed(HardContactState(), depths_mm, f * growths_N)[1] for f in (0.9, 1.1)
    ]

    assert (found, *contacts) == (1, 0, 1)
    assert state.force_N == pytest.approx(6.0, abs=0.5)
    assert [each.is_hard for each in (near, away, again)] == [True, False, True]


@pytest.mark.parametrize(("speed_mm_s", "contacts"), [(2.0, 1), (4.0, 0)])
def test_friction_of_a_needle_that_becomes_faster_is_no_bone(speed_mm_s, contacts):
    depths_mm = STEP_MM * np.arange(75)
    forces_N, speeds_mm_s = np.where(
        depths_mm > 1.0, [[1.5], [speed_mm_s]], [[0.3], [2.0]]
    )
    _, found = pushed(HardContactState(), depths_mm, forces_N, speed_mm_s=speeds_mm_s)

    assert found == contacts


def test_a_force_that_grows_at_a_stop_or_after_a_rest_is_no_bone():
    """A hand that stops the needle may push at it, and friction comes back."""
    even, _ = pushed(HardContactState(), STEP_MM * np.arange(50), 0.3)
    at_rest, _ = pushed(even, np.full(5, 1.0), 0.3, is_even=False)
    further_mm = 1.0 + STEP_MM * np.arange(50)

    assert [
        pushed(even, [1.0], 2.0, is_even=False)[1],
        pushed(even, [1.0], 2.0)[1],
        pushed(at_rest, further_mm, 2.0)[1],
        pushed(even, further_mm, 2.0)[1],
    ] == [0, 1, 0, 1]


@pytest.mark.parametrize(
    ("tremor_m", "delay_s"),
    [(0.0, 0.1), (0.05e-3, 0.6), (0.12e-3, 0.6)],
)
def test_a_rupture_is_found_by_a_needle_that_trembles(tremor_m, delay_s):
    motion = replace(
        constant_motion(speed_m_s=3e-3, depth_m=36e-3, standoff_m=5e-3),
        tremor=Tremor(amplitude_m=tremor_m, frequency_hz=9.0) if tremor_m else None,
    )
    chosen = replace(scenario("gel-25-constant"), motion=motion)
    run = insert_needle(chosen, seed=4, rate_hz=500.0)
    _, estimates, rows = follow(run)
    [rupture] = values_of(estimates, "rupture")
    tip_N, std_N, is_in_contact = np.array(
        [(e.tip_force_N, e.tip_force_std_N, e.in_contact) for e in estimates]
    ).T
    is_inserted = run.t_s[rows] < motion.insertion_end_s
    is_covered = np.abs(tip_N - run.truth.tip_N[rows]) < 2.0 * std_N

    assert 0.0 < rupture.alarm_s - run.truth.ruptures[0].onset_s < delay_s
    assert is_covered[is_inserted & (is_in_contact == 1.0)].mean() > 0.85


DT_S = 2e-3
MEAN_M_S = 3e-3


def swings(speeds_m_s):
    """Whether a swing ends, and whether the needle swings, sample by sample."""
    swing = NeedleSwing(mean_m_s=MEAN_M_S, smoothed_m_s=MEAN_M_S)
    return [(update_swing(swing, v, DT_S), swing.is_swinging) for v in speeds_m_s]


def swinging(rate_hz, amplitude_m_s, *, noise_m_s=0.0):
    """Whether the needle swings, sample by sample, and how many swings have ended.

    It swings for two seconds about a mean speed, and then for one second no more.
    """
    t_s = DT_S * np.arange(1_500)
    wave = np.sin(2.0 * np.pi * rate_hz * t_s) * (t_s < 2.0)
    noise = noise_m_s * np.random.default_rng(0).normal(size=len(t_s))
    ends, is_swinging = np.array(swings(MEAN_M_S + amplitude_m_s * wave + noise)).T
    return is_swinging, ends.sum()


@pytest.mark.parametrize(
    ("rate_hz", "amplitude_m_s", "noise_m_s", "fraction"),
    [
        (6.0, 4e-3, 0.0, 1.0),
        (12.0, 4e-3, 0.0, 1.0),
        (2.0, 4e-3, 0.0, 0.0),  # a motion of its own
        (35.0, 9e-3, 0.0, 0.0),  # vibration
        (9.0, 0.4e-3, 0.0, 0.0),  # noise of a measured speed
        (9.0, 0.0, 0.7e-3, 0.0),
        (9.0, 1.2e-3, 0.0, 1.0),  # it hardly slows the needle
        (9.0, 4e-3, 0.7e-3, 1.0),
    ],
)
def test_what_is_a_tremor(rate_hz, amplitude_m_s, noise_m_s, fraction):
    is_swinging, ends = swinging(rate_hz, amplitude_m_s, noise_m_s=noise_m_s)

    assert is_swinging[650:1000].mean() == pytest.approx(fraction, abs=0.1)
    assert (is_swinging[:1100].any(), is_swinging[1100:].any()) == (fraction > 0, False)
    if fraction and not noise_m_s:
        assert ends == pytest.approx(2.0 * rate_hz, abs=1)


@pytest.mark.parametrize(
    ("halves_s", "is_swinging"),
    [
        ([0.05] * 12 + [0.03], True),
        ([0.05] * 11 + [0.03], False),
        # One that is vibration, and a pause of more than 0.12 s, begin anew.
        ([0.05] * 11 + [0.014] + [0.05] * 11 + [0.03], False),
        ([0.05] * 2 + [0.014] + [0.05] * 13 + [0.03], True),
        ([0.05] * 11 + [0.11, 0.03], True),
        ([0.05] * 11 + [0.13, 0.03], False),
    ],
)
def test_twelve_turns_in_a_row_are_a_swing(halves_s, is_swinging):
    ticks = np.rint(np.divide(halves_s, DT_S)).astype(int)
    signs = np.repeat((-1.0) ** np.arange(len(ticks)), ticks)

    assert swings(MEAN_M_S + 4e-3 * signs)[-1][1] == is_swinging
