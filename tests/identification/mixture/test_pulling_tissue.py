"""How long tissue pulls before it counts as moving, and what is then in doubt."""

import pytest

from identification.mixture.block import Block
from identification.mixture.tissue_pull import TissuePull

DT_S = 0.05


def course(*stretches, amplitude_mm=0.0, breathing_N=0.0, is_sliding=True):
    """Tissue after stretches of a force [N] and its seconds; the needle advances."""
    pull = TissuePull(is_met=True)
    time_s = 0.0
    for force_N, seconds in stretches:
        for _ in range(round(seconds / DT_S)):
            time_s += DT_S
            block = Block(time_s=time_s, duration_s=DT_S, force_N=force_N)
            pull = pull.with_force(
                block, 1e-4, amplitude_mm, breathing_N**2, is_sliding=is_sliding
            )
    return pull, time_s


@pytest.mark.parametrize(
    ("stretches", "is_moving"),
    [
        ([(0.5, 2.0), (-0.5, 0.3)], True),
        ([(0.5, 2.0), (-0.5, 0.1)], False),
        ([(0.5, 2.0), (-0.05, 5.0)], False),  # the inertia of a needle pulls so
        (5 * [(-0.5, 0.1), (0.5, 1.0)], False),  # friction that turns again and again
        ([(-0.5, 0.3), (0.5, 14.0)], True),  # as long as two breaths later
        ([(-0.5, 0.3), (0.5, 16.0)], False),
    ],
)
def test_tissue_moves_once_it_has_pulled_in_one_go(stretches, is_moving):
    pull, time_s = course(*stretches)

    assert pull.is_moving(time_s) == is_moving


def test_a_needle_that_does_not_advance_is_held_and_not_pulled():
    pull, time_s = course((-0.5, 2.0), is_sliding=False)

    assert not pull.is_moving(time_s)


@pytest.mark.parametrize(("amplitude_mm", "is_moving"), [(1.5, False), (3.0, True)])
def test_tissue_moves_where_its_motion_is_too_large_to_be_followed(
    amplitude_mm, is_moving
):
    pull, time_s = course((0.5, 1.0), amplitude_mm=amplitude_mm)

    assert pull.is_moving(time_s) == is_moving


@pytest.mark.parametrize(
    ("force_N", "breathing_N", "seconds", "is_moving"),
    [
        (1.0, 0.35, 5.0, True),
        (1.0, 0.35, 3.0, False),  # the force bends where a layer begins
        (1.0, 0.1, 5.0, False),  # texture, and the noise of an arm
        (0.2, 0.08, 5.0, False),  # little force: noise is a large part of it
    ],
)
def test_tissue_moves_where_breathing_is_a_large_part_of_the_force(
    force_N, breathing_N, seconds, is_moving
):
    pull, time_s = course((force_N, seconds), breathing_N=breathing_N)

    assert pull.is_moving(time_s) == is_moving


def test_friction_is_known_no_better_than_half_the_swing_of_the_force():
    pull, _ = course((0.8, 1.0), (-0.4, 1.0))

    assert pull.doubt_N == pytest.approx(0.6, rel=0.1)


def test_a_swing_of_long_ago_leaves_no_doubt():
    """A force of a withdrawal a minute before says nothing of this breath."""
    drawn_back, _ = course((-5.0, 0.1), (0.5, 75.0), (-0.5, 1.0))
    never, _ = course((0.5, 75.0), (-0.5, 1.0))

    assert drawn_back.doubt_N == pytest.approx(never.doubt_N, rel=0.1)
