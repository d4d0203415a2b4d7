"""The force on a needle at rest relaxes, and changes quickly by a fault or a hand."""

import math

import pytest

from identification.mixture.rest_force import HeldForce, RestForce

BLOCK_s = 0.01


def rest(force_at, seconds, *, depth_at=lambda _: 30.0, std_N=0.05, has_ruptured=False):
    """What is judged of a force over time, every block."""
    held = RestForce()
    course = []
    for k in range(round(seconds / BLOCK_s)):
        time_s = BLOCK_s * k
        held = held.with_force(
            HeldForce(
                value_N=force_at(time_s),
                noise_std_N=0.02,
                slow_std_N=std_N,
                depth_mm=depth_at(time_s),
                depth_std_mm=0.002,
                duration_s=BLOCK_s,
                has_ruptured=has_ruptured,
            )
        )
        course.append((time_s, held))
    return [time_s for time_s, judged in course if judged.is_foreign]


@pytest.mark.parametrize("change_N", [-0.8, 0.8])
def test_a_quick_change_is_foreign_after_a_tenth_of_a_second(change_N):
    foreign_s = rest(lambda t_s: 1.0 + change_N * (t_s > 1.0), 2.0)

    assert 1.1 < foreign_s[0] < 1.15
    assert foreign_s[-1] == pytest.approx(1.99)


def test_two_short_changes_do_not_add_up():
    """Each lasts for 70 ms, and a tenth of a second is needed."""
    foreign_s = rest(lambda t_s: 1.0 - 0.8 * (1.0 < t_s % 1.2 < 1.08), 3.0)

    assert foreign_s == []


@pytest.mark.parametrize(("change_N", "is_foreign"), [(-0.7, False), (-0.9, True)])
def test_a_change_is_more_than_four_tenths_of_the_force(change_N, is_foreign):
    """The force is 2 N; its noise would allow for a change of 0.12 N."""
    foreign_s = rest(lambda t_s: 2.0 + change_N * (t_s > 1.0), 2.0)

    assert bool(foreign_s) == is_foreign


def test_a_hand_that_lets_go_ends_it():
    foreign_s = rest(lambda t_s: 1.0 - 0.8 * (1.0 < t_s < 2.0), 4.0)

    assert foreign_s[-1] == pytest.approx(2.0, abs=0.03)


def test_an_arm_that_begins_to_move_changes_it_before_the_needle_has_moved():
    foreign_s = rest(
        lambda t_s: 1.0 - min(max(t_s - 1.0, 0.0) / 0.03, 1.0),
        2.0,
        depth_at=lambda t_s: 30.0 - 50.0 * max(t_s - 1.0, 0.0) ** 2,
    )

    assert foreign_s == []


def test_a_change_within_the_sensors_slow_error_is_not_judged():
    assert rest(lambda t_s: 1.0 + 0.5 * (t_s > 1.0), 3.0, std_N=0.3) == []


def test_tissue_that_breathes_changes_it_slowly():
    breath = lambda t_s: 0.6 * math.sin(2.0 * math.pi * 0.25 * t_s)  # noqa: E731

    assert rest(lambda t_s: 1.0 + breath(t_s), 8.0) == []


@pytest.mark.parametrize(
    ("force_at", "has_ruptured", "is_foreign"),
    [
        (lambda t_s: 1.0 * math.exp(-t_s / 4.0), True, False),  # tissue relaxes
        (lambda t_s: 1.0 - 1.25 * t_s, True, True),  # a sensor drifts
        (lambda t_s: 1.0 - 0.8 * t_s, False, False),  # tissue may move
    ],
)
def test_a_force_that_falls_on_after_a_rupture_is_foreign(
    force_at, has_ruptured, is_foreign
):
    foreign_s = rest(force_at, 1.2, has_ruptured=has_ruptured)

    assert bool(foreign_s) == is_foreign
