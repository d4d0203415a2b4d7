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
    return task.velocity_rad_s


def test_guidance_rests_below_the_dead_zone():
    """Below the dead zone the arm rests exactly, above it the motion is viscous."""
    assert not velocity(Guidance(ROBOT), 0.1, 1000).any()

    zone = 0.0016 * ROBOT.effort_limit_Nm + 4.0 * SIGMA
    guidance = Guidance(ROBOT, np.full(7, 10.0))

    assert (
        velocity(guidance, 5.0, 60) < 0.5 * (5.0 - zone) / 10.0
    ).all()  # heavy at first

    expected = (5.0 - 0.15 * zone) / 10.0

    assert velocity(guidance, 5.0, 3000) == pytest.approx(expected, rel=1e-2)


def test_the_dead_zone_opens_and_closes():
    """The dead zone opens for a hand and closes behind it."""
    below = 0.9 * 0.0016 * ROBOT.effort_limit_Nm
    guidance = Guidance(ROBOT)

    assert not velocity(guidance, below, 1000).any()
    assert velocity(guidance, 5.0, 300).all()
    assert velocity(guidance, below, 100).all()
    assert not velocity(guidance, below, 4000).any()


def test_swings_are_damped_leading_is_not():
    """A torque that swings is damped, a steady one is not."""
    guidance = Guidance(ROBOT, np.full(7, 10.0))
    speeds = []
    for k in range(3000):
        torque = 5.0 * np.sin(2.0 * np.pi * 5e-3 * k)  # 5 Hz
        speeds.append(np.abs(velocity(guidance, torque)).max())

    assert max(speeds[1500:]) < 0.05  # 5 Nm on 10 Nms
    assert np.abs(velocity(guidance, 5.0, 3000)).max() > 0.4


def test_guidance_rests_exactly_when_released():
    """When released, the arm comes to an exact rest, also through rejected samples."""
    for how in ({}, {"is_valid": False}):
        guidance = Guidance(ROBOT)
        assert velocity(guidance, 5.0, 300).all()
        assert velocity(guidance, np.nan if how else 0.0, 10, **how).all()
        guidance_rest = velocity(guidance, 0.0, 2000)
        assert not guidance_rest.any()


def test_a_motion_after_a_rest_is_another_one():
    """To which side the arm was led before its rest damps the next motion no more."""
    after_rad_s = []
    for side in (1.0, -1.0):
        guidance = Guidance(ROBOT)
        assert velocity(guidance, 5.0 * side, 1000).all()
        assert not velocity(guidance, 0.0, 10_000).any()
        after_rad_s.append(velocity(guidance, 5.0, 100))

    assert after_rad_s[0] == pytest.approx(after_rad_s[1], rel=1e-6)


def test_growing_sigma_does_not_stop_guidance():
    """A deviation that grows while a hand pushes does not stop the motion."""
    guidance = Guidance(ROBOT)
    led_rad_s = velocity(guidance, 5.0, 300)
    uncertain_rad_s = guidance.update(
        np.full(7, 5.0), 100.0 * SIGMA, 1e-3
    ).velocity_rad_s

    assert uncertain_rad_s == pytest.approx(led_rad_s, rel=0.05)


@pytest.mark.parametrize("damping", [[1.0] * 6, [0.0] * 7, [np.nan] * 7])
def test_a_damping_that_cannot_work_is_refused(damping):
    with pytest.raises(SettingError, match="damping"):
        Guidance(ROBOT, damping)


@pytest.mark.slow
def test_stiff_hands_do_not_swing_late_arms():
    """A stiff hand does not swing an arm whose torques come late."""
    arm = GuidedArm("S", "fri", 1)
    begin_s = arm.begin_s
    arm.hand.stiffness_N_per_m = 2000.0
    way = np.array((0.02, 0.0, 0.0))
    arm.hand.path_m = lambda time_s: min(max(time_s - begin_s, 0.0) / 0.4, 1.0) * way
    apart_m = [np.linalg.norm(arm.hand.stretch_m) for _ in arm.run(1.5)]

    assert arm.sensor.rejected == 0
    assert 1e-3 < max(apart_m) < 0.02
    assert max(apart_m[-500:]) < 3e-3


@pytest.mark.slow
def test_a_stiff_arm_does_not_answer_its_own_acceleration():
    """Led at 120 mm/s it moves smoothly: no torque steps that count as spikes."""
    arm = GuidedArm("S", "clean", 1)
    begin_s = arm.begin_s
    way = np.array((0.12, 0.0, 0.0))
    arm.hand.path_m = lambda time_s: min(max(time_s - begin_s, 0.0), 1.0) * way
    velocities_rad_s = [arm.control.last_rad_s for _ in arm.run(1.0)]
    held_N = np.linalg.norm(arm.hand.applied_N)
    jumps_rad_s2 = np.diff(velocities_rad_s[50:], 2, axis=0) / 1e-3

    assert arm.sensor.rejected == 0
    assert np.abs(jumps_rad_s2).max() < 2.0  # from cycle to cycle; the limit is 20
    assert held_N < 4.0


def test_a_pause_does_not_make_the_arm_light():
    guidance = Guidance(ROBOT, np.full(7, 10.0))
    torque = 5.0
    for k in range(300):
        velocity(guidance, 5.0 * np.sin(0.05 * k))

    for dt_s in (0.5, 1e5):
        assert (
            np.abs(
                guidance.update(np.full(7, torque), SIGMA, dt_s).velocity_rad_s
            ).max()
            <= torque / 10.0
        )


def test_a_time_step_that_is_none_changes_nothing():
    guidance = Guidance(ROBOT)
    led_rad_s = velocity(guidance, 5.0, 300).tolist()
    for dt_s in (None, "x", np.nan, np.inf, 0.0, -1.0):
        assert (
            guidance.update(np.zeros(7), SIGMA, dt_s).velocity_rad_s.tolist()
            == led_rad_s
        )


def test_impossible_torques_and_rejected_sigma_are_skipped():
    """Torques that no joint can have and deviations of rejected samples are skipped."""
    guidance = Guidance(ROBOT)
    other = Guidance(ROBOT)

    assert np.isfinite(velocity(guidance, 1e308)).all()

    other.update(np.zeros(7), np.zeros(7), 1e-3, is_valid=False)

    assert velocity(guidance, 5.0, 300) == pytest.approx(
        velocity(other, 5.0, 300), rel=1e-3
    )


@pytest.mark.slow
def test_an_unknown_torque_limit_leaves_a_dead_zone():
    """Without a known torque limit the dead zone is still above the noise."""
    robot = SimpleNamespace(nv=1, effort_limit_Nm=np.zeros(1))
    guidance = Guidance(robot, [1.0])
    rng = np.random.default_rng(0)
    wishes = [
        guidance.update(
            0.01 * rng.standard_normal(1), np.full(1, 0.01), 1e-3
        ).velocity_rad_s.any()
        for _ in range(20_000)
    ]

    assert not any(wishes)
