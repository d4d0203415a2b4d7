"""Which growth of the force is a hard contact, and when the contact is over."""

import numpy as np
import pytest

from identification.mixture.block import Block
from identification.mixture.hard_contact import HardContactState

BOUND_N_PER_MM = 4.0
STEP_MM = 0.02


def pushed(state, depths_mm, forces_N, *, speed_mm_s=2.0, is_even=True):
    """The state after blocks of such depths and forces, and the contacts found."""
    found = 0
    speeds_mm_s = np.broadcast_to(speed_mm_s, len(depths_mm)).tolist()
    columns = zip(depths_mm, forces_N, speeds_mm_s, strict=True)
    for depth_mm, force_N, speed in columns:
        block = Block(depth_mm=depth_mm, speed_mm_s=speed, noise_std_N=0.005)
        state = state.with_force(block, force_N, BOUND_N_PER_MM, is_even=is_even)
        found += state.is_new
    return state, found


def against_bone(**motion):
    """The state after 1 mm of soft tissue and 0.5 mm onto bone of 12 N/mm."""
    depths_mm = STEP_MM * np.arange(75)
    forces_N = 0.3 + 12.0 * np.maximum(depths_mm - 1.0, 0.0)
    return pushed(HardContactState(), depths_mm, forces_N, **motion)


def test_bone_is_hard_until_half_of_its_force_is_gone():
    state, found = against_bone()

    assert found == 1
    assert state.force_N == pytest.approx(6.0, abs=0.5)
    assert pushed(state, [1.4], [0.6 * state.force_N])[0].is_hard
    assert not pushed(state, [1.3], [0.4 * state.force_N])[0].is_hard


def test_bone_that_is_met_again_is_another_contact():
    state, _ = against_bone()
    away, _ = pushed(state, [0.5], [0.1])
    depths_mm = 0.5 + STEP_MM * np.arange(40)
    _, found = pushed(away, depths_mm, 0.1 + 12.0 * np.maximum(depths_mm - 1.0, 0.0))

    assert found == 1


@pytest.mark.parametrize(("speed_mm_s", "contacts"), [(2.0, 1), (4.0, 0)])
def test_friction_of_a_needle_that_becomes_faster_is_no_bone(speed_mm_s, contacts):
    depths_mm = STEP_MM * np.arange(75)
    is_later = depths_mm > 1.0
    speeds_mm_s = np.where(is_later, speed_mm_s, 2.0)
    forces_N = np.where(is_later, 1.5, 0.3)
    _, found = pushed(HardContactState(), depths_mm, forces_N, speed_mm_s=speeds_mm_s)

    assert found == contacts


@pytest.mark.parametrize(("is_even", "contacts"), [(True, 1), (False, 0)])
def test_a_force_that_grows_as_the_needle_stops_is_no_bone(is_even, contacts):
    """A hand that stops the needle may push at it in the same moment."""
    even, _ = pushed(HardContactState(), STEP_MM * np.arange(50), np.full(50, 0.3))
    _, found = pushed(even, [1.0], [2.0], is_even=is_even)

    assert found == contacts


def test_friction_that_grows_after_a_rest_is_no_bone():
    even, _ = pushed(HardContactState(), STEP_MM * np.arange(50), np.full(50, 0.3))
    at_rest, _ = pushed(even, np.full(5, 1.0), np.full(5, 0.3), is_even=False)
    _, resumed = pushed(at_rest, 1.0 + STEP_MM * np.arange(50), np.full(50, 2.0))
    _, without_rest = pushed(even, 1.0 + STEP_MM * np.arange(50), np.full(50, 2.0))

    assert resumed == 0
    assert without_rest == 1
