"""Bone under soft tissue is an event of its own, soft tissue is none."""

from dataclasses import replace

import numpy as np
import pytest

from groundtruth import insert_needle, random_stack
from groundtruth.layers import Layer, ShaftFriction
from groundtruth.motion import constant_motion
from identification import Identifier, MixtureConfig, TissueWarning
from identification.mixture.block import Block
from identification.mixture.hard_contact import ContactPoint, HardContactState

BONE_DEPTH_M = 15e-3


def contacts(stiffness_N_per_m, speed_m_s=3e-3, **settings):
    """The hard contacts of an insertion through muscle onto something, and estimates.

    The force grows by 8 N beyond the muscle.
    """
    friction = ShaftFriction.calibrated(
        force_N_per_m=10.0,
        reference_speed_m_s=3e-3,
        coulomb_fraction=0.6,
        presliding_m=0.3e-3,
    )
    muscle = Layer(
        name="muscle",
        thickness_m=BONE_DEPTH_M,
        exit_force_N=0.8,
        cutting_fraction=0.1,
        stiffening=0.1,
        release_m=0.3e-3,
        relaxed_fraction=0.4,
        friction=friction,
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
    scenario = replace(stack, layers=(muscle, bone), motion=motion)
    run = insert_needle(scenario, seed=3, rate_hz=250.0)
    rows = (run.t_s > run.tare_end_s) & (run.t_s < motion.withdrawal_start_s)
    identifier = Identifier(MixtureConfig(**settings))
    columns = zip(
        run.depth_m[rows].tolist(),
        run.speed_m_s[rows].tolist(),
        run.force_N[rows].tolist(),
        strict=True,
    )
    estimates = [identifier.update(*sample, 4e-3) for sample in columns]
    return [item.hard_contact for item in estimates if item.hard_contact], estimates


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stiffness_N_per_m", "speed_m_s"), [(8e3, 1.5e-3), (40e3, 5e-3)]
)
def test_bone_is_one_event_soon_after_the_contact(stiffness_N_per_m, speed_m_s):
    [contact], estimates = contacts(stiffness_N_per_m, speed_m_s)

    assert BONE_DEPTH_M < contact.depth_m < BONE_DEPTH_M + 0.4e-3
    assert contact.growth_N_per_m > 4000.0
    assert contact.force_N < 4.0
    assert TissueWarning.HARD_CONTACT in estimates[-1].warnings
    assert estimates[-1].hard_contact is None


@pytest.mark.slow
def test_soft_tissue_is_no_hard_contact():
    found, estimates = contacts(1500.0)

    assert found == []
    assert TissueWarning.HARD_CONTACT not in estimates[-1].warnings


def test_what_counts_as_hard_is_a_setting():
    [contact], _ = contacts(1500.0, hard_contact_N_per_m=800.0)

    assert contact.growth_N_per_m == pytest.approx(1500.0, rel=0.4)


@pytest.mark.parametrize(("growth_N_per_mm", "is_hard"), [(3.8, False), (4.2, True)])
def test_a_contact_is_hard_beyond_the_bound(growth_N_per_mm, is_hard):
    """The bound is 4 N/mm, over the last 0.2 mm."""
    first = ContactPoint(depth_mm=10.0, force_N=0.5, speed_mm_s=3.0, is_known=True)
    state = HardContactState(first=first, second=first)
    block = Block(depth_mm=10.2, speed_mm_s=3.0, noise_std_N=0.01)
    after = state.with_force(block, 0.5 + 0.2 * growth_N_per_mm, 4.0, is_even=True)

    assert after.is_hard == is_hard
    assert after.is_new == is_hard


@pytest.mark.parametrize(("force_N", "is_hard"), [(0.9, False), (1.1, True)])
def test_a_hard_contact_is_over_below_half_its_force(force_N, is_hard):
    state = HardContactState(force_N=2.0)

    assert state.with_force(Block(), force_N, 4.0, is_even=False).is_hard == is_hard
