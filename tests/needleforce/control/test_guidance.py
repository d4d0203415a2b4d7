"""Manual guidance: the dead zone, the lag, rejected samples, a stiff hand."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.control.guidance import GuidedArm
from needleforce.control import Guidance, SettingError
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
SIGMA = np.full(7, 0.01)


def velocity(guidance, torque, ticks=1, **how):
    for _ in range(ticks):
        task = guidance.update(np.zeros(7) + torque, SIGMA, 1e-3, **how)
    return task.wish


def test_below_the_dead_zone_it_rests_exactly_and_above_it_is_viscous():
    assert not velocity(Guidance(ROBOT), 0.1, 1000).any()
    zone = 0.0016 * ROBOT.effort_limit_Nm + 4.0 * SIGMA
    guidance = Guidance(ROBOT, np.full(7, 10.0))
    assert (
        velocity(guidance, 5.0, 60) < 0.5 * (5.0 - zone) / 10.0
    ).all()  # heavy at first
    expected = (5.0 - 0.15 * zone) / 10.0
    assert velocity(guidance, 5.0, 3000) == pytest.approx(expected, rel=1e-2)


def test_the_dead_zone_opens_for_a_hand_and_closes_behind_it():
    below = 0.9 * 0.0016 * ROBOT.effort_limit_Nm
    guidance = Guidance(ROBOT)
    assert not velocity(guidance, below, 1000).any()
    assert velocity(guidance, 5.0, 300).all()
    assert velocity(guidance, below, 100).all()
    assert not velocity(guidance, below, 4000).any()


def test_what_swings_is_damped_and_what_is_led_is_not():
    guidance = Guidance(ROBOT, np.full(7, 10.0))
    speeds = []
    for k in range(3000):
        torque = 5.0 * np.sin(2.0 * np.pi * 5e-3 * k)  # 5 Hz
        speeds.append(np.abs(velocity(guidance, torque)).max())
    assert max(speeds[1500:]) < 0.05  # 5 Nm on 10 Nms
    assert np.abs(velocity(guidance, 5.0, 3000)).max() > 0.4


def test_it_comes_to_an_exact_rest_when_let_go_also_through_rejected_samples():
    for how in ({}, {"is_valid": False}):
        guidance = Guidance(ROBOT)
        assert velocity(guidance, 5.0, 300).all()
        assert velocity(guidance, np.nan if how else 0.0, 10, **how).all()
        guidance_rest = velocity(guidance, 0.0, 2000)
        assert not guidance_rest.any()


def test_a_sigma_that_grows_under_the_hand_does_not_stop_it():
    guidance = Guidance(ROBOT)
    before = velocity(guidance, 5.0, 300)
    after = guidance.update(np.full(7, 5.0), 100.0 * SIGMA, 1e-3).wish
    assert after == pytest.approx(before, rel=0.05)


@pytest.mark.parametrize("damping", [[1.0] * 6, [0.0] * 7, [np.nan] * 7])
def test_a_damping_that_cannot_work_is_refused(damping):
    with pytest.raises(SettingError, match="damping"):
        Guidance(ROBOT, damping)


def test_a_stiff_hand_does_not_swing_an_arm_whose_torques_come_late():
    arm = GuidedArm("S", "fri", 1)
    begin_s = arm.begin_s
    arm.hand.stiffness_N_per_m = 2000.0
    way = np.array((0.02, 0.0, 0.0))
    arm.hand.path_m = lambda time_s: min(max(time_s - begin_s, 0.0) / 0.4, 1.0) * way
    apart_m = [np.linalg.norm(arm.hand.stretch_m) for _ in arm.run(1.5)]
    assert arm.sensor.rejected == 0
    assert 1e-3 < max(apart_m) < 0.02
    assert max(apart_m[-500:]) < 3e-3


def test_a_pause_does_not_make_the_arm_light():
    guidance = Guidance(ROBOT, np.full(7, 10.0))
    torque = 5.0
    for k in range(300):
        velocity(guidance, 5.0 * np.sin(0.05 * k))
    for dt_s in (0.5, 1e5):
        assert (
            np.abs(guidance.update(np.full(7, torque), SIGMA, dt_s).wish).max()
            <= torque / 10.0
        )


def test_a_time_step_that_is_none_changes_nothing():
    guidance = Guidance(ROBOT)
    before = velocity(guidance, 5.0, 300).tolist()
    for dt_s in (None, "x", np.nan, np.inf, 0.0, -1.0):
        assert guidance.update(np.zeros(7), SIGMA, dt_s).wish.tolist() == before


def test_numbers_that_no_joint_can_have_and_rejected_deviations_are_skipped():
    guidance = Guidance(ROBOT)
    other = Guidance(ROBOT)
    assert np.isfinite(velocity(guidance, 1e308)).all()
    other.update(np.zeros(7), np.zeros(7), 1e-3, is_valid=False)
    assert velocity(guidance, 5.0, 300) == pytest.approx(
        velocity(other, 5.0, 300), rel=1e-3
    )


def test_a_torque_limit_that_nobody_knows_leaves_a_dead_zone():
    robot = SimpleNamespace(nv=1, effort_limit_Nm=np.zeros(1))
    guidance = Guidance(robot, [1.0])
    rng = np.random.default_rng(0)
    wishes = [
        guidance.update(
            0.01 * rng.standard_normal(1), np.full(1, 0.01), 1e-3
        ).wish.any()
        for _ in range(20_000)
    ]
    assert not any(wishes)
