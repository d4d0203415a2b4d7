"""Steps of one torque: how large, which are jumps, and the doubt that they leave."""

import numpy as np
import pytest

from residual.checks.torque_doubt import TorqueDoubt
from residual.checks.torque_jump import JumpFinding, JumpKind, TorqueCourse, fit_steps

ALONG_NEEDLE = np.array([[0.4, -0.6, 0.3, 0.5, -0.2, 0.1, 0.05]])
"""Torque per newton at the tip [m]."""


ANY_FORCE_N = 1e4
"""Deviation of a force at the tip of which nothing is known."""


def step_of(joint, step_Nm):
    return step_Nm * (np.arange(7) == joint)


@pytest.mark.parametrize("joint", [0, 3, 6])
def test_a_step_beside_a_force_is_found_in_its_size(joint):
    usual_Nm2 = np.diag(np.full(7, 0.01**2))
    change_Nm = step_of(joint, 0.5) + 3.0 * ALONG_NEEDLE[0]
    steps = fit_steps(ALONG_NEEDLE, change_Nm, usual_Nm2, ANY_FORCE_N)

    assert steps.ratios.argmax() == joint
    assert steps.steps_Nm[joint] == pytest.approx(0.5, rel=0.01)
    assert steps.is_jump


def test_a_usual_change_has_a_ratio_of_one_for_every_joint():
    rng = np.random.default_rng(0)
    stds_Nm = rng.uniform(0.02, 0.1, 7)
    ratios = [
        fit_steps(ALONG_NEEDLE, change_Nm, np.diag(stds_Nm**2), ANY_FORCE_N).ratios
        for change_Nm in stds_Nm * rng.normal(size=(2000, 7))
    ]

    assert np.mean(ratios, axis=0) == pytest.approx(np.ones(7), abs=0.12)


@pytest.mark.parametrize(("step_Nm", "is_jump"), [(0.045, False), (0.06, True)])
def test_a_step_that_a_twisted_needle_makes_is_no_jump(step_Nm, is_jump):
    usual_Nm2 = np.diag(np.full(7, 1e-3**2))
    steps = fit_steps(ALONG_NEEDLE, step_of(2, step_Nm), usual_Nm2, ANY_FORCE_N)

    assert steps.is_jump == is_jump


@pytest.mark.parametrize(("sigmas", "is_jump"), [(4.8, False), (5.2, True)])
def test_a_step_of_five_deviations_is_a_jump(sigmas, is_jump):
    usual_Nm2 = np.diag(np.full(7, 0.1**2))
    one_Nm = fit_steps(ALONG_NEEDLE, step_of(2, 1.0), usual_Nm2, ANY_FORCE_N)
    std_Nm = np.sqrt(one_Nm.variances_Nm2[2])
    change_Nm = step_of(2, sigmas * std_Nm)
    steps = fit_steps(ALONG_NEEDLE, change_Nm, usual_Nm2, ANY_FORCE_N)

    assert steps.is_jump == is_jump


def doubt_after(*torques_Nm, seconds=3.0):
    """The doubt after a while of each of these torques, after the same without any."""
    course = TorqueCourse.after_tare(np.full(7, 0.005**2))
    doubt = TorqueDoubt.after_tare(7)
    rng = np.random.default_rng(0)
    for torque_Nm in (np.zeros(7), *torques_Nm):
        for _ in range(round(seconds / 0.02)):
            noisy_Nm = torque_Nm + 0.005 * rng.normal(size=7)
            course, finding = course.advanced(ALONG_NEEDLE, noisy_Nm, 0.02)
            doubt = doubt.after_finding(finding, 0.0)
    return doubt


FIRST_NM = step_of(1, 0.5)
BOTH_NM = FIRST_NM + step_of(5, 0.4)


def test_the_level_of_a_second_jump_adds_to_that_of_the_first():
    first = doubt_after(FIRST_NM)
    both = doubt_after(FIRST_NM, BOTH_NM)

    assert first.jumps == 1
    assert both.jumps == 2
    assert first.level_Nm == pytest.approx(FIRST_NM, abs=0.02)
    assert both.level_Nm == pytest.approx(BOTH_NM, abs=0.04)
    assert (np.diag(both.level_Nm2) >= np.diag(first.level_Nm2)).all()


def test_torques_are_back_once_the_first_jump_is_undone_too():
    one_back = doubt_after(FIRST_NM, BOTH_NM, FIRST_NM)
    both_back = doubt_after(FIRST_NM, BOTH_NM, FIRST_NM, np.zeros(7))

    assert one_back.has_jumped
    assert not both_back.has_jumped
    assert not both_back.level_Nm.any()
    assert both_back.jumps == 4


def test_while_a_jump_is_measured_the_zero_stays_and_the_variance_holds_the_jump():
    doubt = doubt_after(FIRST_NM, seconds=0.6)

    assert not doubt.level_Nm.any()
    assert 0.5 < np.sqrt(doubt.jump_Nm2[1, 1]) < 0.7


def test_a_torque_that_several_joints_share_leaves_no_level():
    push_Nm = step_of(1, 0.5) - step_of(3, 0.7) + step_of(5, 0.9)
    doubt = doubt_after(push_Nm)

    assert not doubt.has_jumped
    assert doubt.jumps == 0


LWR_ROWS = np.array(
    [
        [0.029, -0.128, 0.043, 0.47, -0.018, -0.27, 0.0],
        [-0.539, -0.034, -0.525, 0.057, -0.232, 0.021, 0.0],
        [0.0, 0.529, -0.059, -0.329, 0.0, 0.0, 0.0],
    ]
)
"""Torque per newton at the tip of an LWR 4+ whose needle points down [m]."""


def measured(step_Nm, force_N=(0.0, 0.0, 0.0)):
    """The doubt after a jump beside a change of the force at the tip."""
    change_Nm = step_Nm + np.array(force_N) @ LWR_ROWS
    steps = fit_steps(LWR_ROWS, change_Nm, np.diag(np.full(7, 0.05**2)), 1.0)
    finding = JumpFinding(JumpKind.MEASURED, steps)
    return TorqueDoubt.after_tare(7).after_finding(finding, 0.0)


@pytest.mark.parametrize("joint", [1, 3, 5])
@pytest.mark.parametrize("size_Nm", [0.3, 3.0])
def test_a_level_is_within_its_deviation_whichever_joint_of_a_plane_has_jumped(
    joint, size_Nm
):
    step_Nm = step_of(joint, size_Nm)
    doubt = measured(step_Nm, force_N=(0.0, 0.0, -0.5))
    error_Nm = doubt.level_Nm - step_Nm
    axial_N = np.linalg.pinv(LWR_ROWS.T)[2]
    std_N = np.sqrt(axial_N @ doubt.jump_Nm2 @ axial_N)

    assert abs(axial_N @ error_Nm) < 2.0 * std_N
    assert std_N < 1.0


def test_a_large_jump_is_known_by_its_joint_and_a_small_one_is_not():
    """A force of needles would have to change by 6 N to make up for 3 Nm elsewhere."""
    large = measured(step_of(1, 3.0))
    small = measured(step_of(1, 0.3))

    assert large.level_Nm == pytest.approx(step_of(1, 3.0), abs=0.15)
    assert small.level_Nm[1] < 0.25


def test_the_covariance_follows_a_mismatch_once_it_is_a_tenth_too_small():
    doubt = TorqueDoubt.after_tare(7).widened(2.0)

    assert doubt.widening == 3.0  # 1 + 2 (2 - 1)
    assert not doubt.is_too_narrow(2.14)
    assert doubt.is_too_narrow(2.16)


@pytest.mark.parametrize(("pushed_s", "since_s"), [(0.0, 0.6), (0.02, 0.12)])
def test_a_jump_began_before_it_was_noticed(pushed_s, since_s):
    usual_Nm2 = np.diag(np.full(7, 0.05**2))
    steps = fit_steps(LWR_ROWS, step_of(1, 3.0), usual_Nm2, ANY_FORCE_N)
    finding = JumpFinding(JumpKind.JUMPED, steps)
    doubt = TorqueDoubt.after_tare(7).after_finding(finding, pushed_s)
    later = doubt.after_finding(finding, pushed_s + 1.0)

    assert doubt.since_s == pytest.approx(since_s)
    assert later.since_s == doubt.since_s
