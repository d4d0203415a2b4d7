"""Steps of one torque: how large, which are jumps, and what several leave in doubt."""

import numpy as np
import pytest

from residual.checks.torque_jump import TorqueCourse, fit_steps

ALONG_NEEDLE = np.array([[0.4, -0.6, 0.3, 0.5, -0.2, 0.1, 0.05]])
"""Torque per newton at the tip [m]."""


def step_of(joint, step_Nm):
    return step_Nm * (np.arange(7) == joint)


@pytest.mark.parametrize("joint", [0, 3, 6])
def test_a_step_beside_a_force_is_found_in_its_size(joint):
    usual_Nm2 = np.diag(np.full(7, 0.01**2))
    change_Nm = step_of(joint, 0.5) + 3.0 * ALONG_NEEDLE[0]
    steps = fit_steps(ALONG_NEEDLE, change_Nm, usual_Nm2)

    assert steps.ratios.argmax() == joint
    assert steps.steps_Nm[joint] == pytest.approx(0.5, rel=0.01)
    assert steps.is_jump


def test_a_usual_change_has_a_ratio_of_one_for_every_joint():
    rng = np.random.default_rng(0)
    stds_Nm = rng.uniform(0.02, 0.1, 7)
    ratios = [
        fit_steps(ALONG_NEEDLE, change_Nm, np.diag(stds_Nm**2)).ratios
        for change_Nm in stds_Nm * rng.normal(size=(2000, 7))
    ]

    assert np.mean(ratios, axis=0) == pytest.approx(np.ones(7), abs=0.12)


@pytest.mark.parametrize(("step_Nm", "is_jump"), [(0.045, False), (0.06, True)])
def test_a_step_that_a_twisted_needle_makes_is_no_jump(step_Nm, is_jump):
    usual_Nm2 = np.diag(np.full(7, 1e-3**2))
    steps = fit_steps(ALONG_NEEDLE, step_of(2, step_Nm), usual_Nm2)

    assert steps.is_jump == is_jump


def course_of(*torques_Nm):
    """The course after two seconds of each of these torques, after two without."""
    course = TorqueCourse.after_tare(np.full(7, 0.005**2))
    rng = np.random.default_rng(0)
    for torque_Nm in (np.zeros(7), *torques_Nm):
        for _ in range(100):
            noisy_Nm = torque_Nm + 0.005 * rng.normal(size=7)
            course = course.advanced(ALONG_NEEDLE, noisy_Nm, 0.02)
    return course


FIRST_NM = step_of(1, 0.5)
BOTH_NM = FIRST_NM + step_of(5, 0.4)


def test_a_second_jump_adds_to_the_doubt_of_the_first():
    first = course_of(FIRST_NM)
    both = course_of(FIRST_NM, BOTH_NM)

    assert first.jumps == 1
    assert both.jumps == 2
    assert np.sqrt(first.jump_Nm2[1]) == pytest.approx(0.6, rel=0.1)
    assert np.sqrt(both.jump_Nm2[1]) > 0.5
    assert np.sqrt(both.jump_Nm2[5]) > 0.4


def test_torques_are_back_once_the_first_jump_is_undone_too():
    one_back = course_of(FIRST_NM, BOTH_NM, FIRST_NM)
    both_back = course_of(FIRST_NM, BOTH_NM, FIRST_NM, np.zeros(7))

    assert one_back.has_jumped
    assert not both_back.has_jumped
