"""Manual guidance: the dead zone, the lag, rejected samples, stiff hands, any arm."""

from collections import deque
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from groundtruth import HandOnArm, SimulatedArm
from needleforce.control import (
    AxialSpeed,
    Controller,
    Fixture,
    Guidance,
    Limits,
    Posture,
    SettingError,
)
from residual import DEFAULT, BiasPrior, Status, VirtualForceSensor
from tests.needleforce.control.late_arm import DT_s, LateArm, follow
from urdf import LWR_GEAR_RATIO, NeedleTool, load_example, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
SIGMA = np.full(7, 0.01)
ZONE_Nm = 0.0016 * ROBOT.effort_limit_Nm + 4.0 * SIGMA


def velocity(guidance, torque, ticks=1, **how):
    for _ in range(ticks):
        task = guidance.update(np.zeros(7) + torque, SIGMA, 1e-3, **how)
    return task.velocity_rad_s


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_arm_yields_beyond_a_dead_zone_only(sign):
    """Below it the arm rests exactly; above it the motion is viscous, heavy at first,
    and the zone closes again behind the hand."""
    guidance = Guidance(ROBOT, np.full(7, 10.0))

    assert not velocity(guidance, 0.95 * sign * ZONE_Nm, 1000).any()
    assert (
        np.abs(velocity(guidance, 5.0 * sign, 60)) < 0.5 * (5.0 - ZONE_Nm) / 10.0
    ).all()

    expected_rad_s = sign * (5.0 - 0.15 * ZONE_Nm) / 10.0

    assert velocity(guidance, 5.0 * sign, 3000) == pytest.approx(
        expected_rad_s, rel=1e-2
    )
    led_rad_s = velocity(guidance, 0.9 * sign * ZONE_Nm, 100)
    assert (np.abs(led_rad_s) > 0.4 * ZONE_Nm / 10.0).all()
    assert not velocity(guidance, 0.9 * sign * ZONE_Nm, 4000).any()


def test_swings_are_damped_leading_is_not():
    guidance = Guidance(ROBOT, np.full(7, 10.0))
    torques_Nm = 5.0 * np.sin(2.0 * np.pi * 5e-3 * np.arange(3000))  # 5 Hz
    speeds_rad_s = [np.abs(velocity(guidance, t)).max() for t in torques_Nm]

    assert max(speeds_rad_s[1500:]) < 0.05  # 5 Nm on 10 Nms
    assert np.abs(velocity(guidance, 5.0, 3000)).max() > 0.4


@pytest.mark.parametrize("is_valid", [True, False])
def test_guidance_rests_exactly_when_released(is_valid):
    """Also through rejected samples, of which the last valid one holds for 20 ms."""
    guidance = Guidance(ROBOT)
    led_rad_s = velocity(guidance, 5.0, 300)
    after_rad_s = velocity(guidance, 0.0 if is_valid else np.nan, 15, is_valid=is_valid)

    assert (after_rad_s < led_rad_s).all() == is_valid
    assert after_rad_s.all()
    assert not (velocity(guidance, 5.0, 3000, is_valid=False) > 1e-9).any()
    assert not velocity(guidance, 0.0, 2000).any()


def test_the_deviation_may_fall_at_once_and_grow_slowly():
    """A deviation that grows while a hand pushes does not stop the motion."""
    guidance = Guidance(ROBOT)
    led_rad_s = velocity(guidance, 5.0, 300)
    uncertain = guidance.update(np.full(7, 5.0), 100.0 * SIGMA, 1e-3)

    assert uncertain.velocity_rad_s == pytest.approx(led_rad_s, rel=0.05)

    push_Nm = 1.1 * ZONE_Nm
    for waited_s, is_felt in ((0.1, True), (40.0, False)):
        later = Guidance(ROBOT)
        velocity(later, 0.0)
        for _ in range(round(waited_s / 0.1)):
            later.update(np.zeros(7), 100.0 * SIGMA, 0.1)
        felt = later.update(push_Nm, 100.0 * SIGMA, 1e-3)
        assert felt.velocity_rad_s.any() == is_felt


def test_a_pause_does_not_make_the_arm_light():
    guidance = Guidance(ROBOT, np.full(7, 10.0))
    for k in range(300):
        velocity(guidance, 5.0 * np.sin(0.05 * k))

    for dt_s in (0.5, 1e5):
        led = guidance.update(np.full(7, 5.0), SIGMA, dt_s)
        assert np.abs(led.velocity_rad_s).max() <= 5.0 / 10.0


@pytest.mark.parametrize("dt_s", [None, "x", np.nan, np.inf, 0.0, -1.0])
def test_a_time_step_that_is_none_changes_nothing(dt_s):
    guidance = Guidance(ROBOT)
    led_rad_s = velocity(guidance, 5.0, 300)
    after = guidance.update(np.zeros(7), SIGMA, dt_s)

    assert after.velocity_rad_s.tolist() == led_rad_s.tolist()


def test_impossible_torques_and_rejected_sigma_are_skipped():
    guidance = Guidance(ROBOT)
    other = Guidance(ROBOT)

    assert not velocity(guidance, 1e308).any()

    other.update(np.zeros(7), np.zeros(7), 1e-3, is_valid=False)

    assert velocity(guidance, 5.0, 300) == pytest.approx(
        velocity(other, 5.0, 300), rel=1e-3
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"damping_Nms_per_rad": [1.0] * 6},
        {"damping_Nms_per_rad": [0.0] * 7},
        {"damping_Nms_per_rad": [np.nan] * 7},
        {"scale": -1.0},
    ],
)
def test_a_damping_that_cannot_work_is_refused(wrong):
    with pytest.raises(SettingError):
        Guidance(ROBOT, **wrong)


def test_an_arm_without_speed_limits_needs_a_damping():
    robot = SimpleNamespace(
        nv=1,
        joint_names=["a"],
        velocity_limit_rad_s=np.array([np.inf]),
        effort_limit_Nm=np.zeros(1),
    )
    with pytest.raises(SettingError, match="damping"):
        Guidance(robot)

    assert not velocity(Guidance(robot, [1.0]), 0.05, 100).any()  # unknown torque limit


STROKE_s = 4.0


def guide_simulated_arm(plant, stiffness_N_per_m, way_m, seconds):
    """Tare an arm over a stroke in free air, then lead it by the spring of a hand.

    Returns the sensor, and for every tick of the leading and a second after it the
    stretch of the spring [m] and the velocities [rad/s].
    """
    begin_s = STROKE_s + 0.2
    way = np.array((way_m, 0.0, 0.0))
    hand = HandOnArm(at="hub", stiffness_N_per_m=stiffness_N_per_m)
    arm = SimulatedArm(
        plant=plant, seed=1, contacts=[hand], duration_s=begin_s + seconds + 1.0
    )
    control = Controller(arm.robot, Limits(arm.robot))
    control.tool.update(arm.home_rad)
    line = Fixture.here(control.tool)
    guidance = Guidance(arm.robot)
    known = {"alignment": "hold", "prior": BiasPrior(gear_ratio=LWR_GEAR_RATIO)}
    config = replace(DEFAULT, smooth_momentum=False, **known)
    sensor = VirtualForceSensor(arm.robot, config)
    rows = []
    for sample in arm:
        wrench = sensor.update(*sample[1:], sample.dt_s)
        if arm.time_s < begin_s:
            turn = 2.0 * np.pi * min(arm.time_s / STROKE_s, 1.0)
            speed_m_s = -np.pi * 0.06 / STROKE_s * np.sin(turn)
            tasks = [line, AxialSpeed(speed_m_s), Posture(arm.home_rad)]
        else:
            if not sensor.tared:
                sensor.tare()
                hand.path_m = lambda t_s: min((t_s - begin_s) / seconds, 1.0) * way
            signals = (wrench.residual, sensor.residual_std_Nm, sample.dt_s)
            is_valid = wrench.status is Status.OK
            tasks = [guidance.update(*signals, is_valid=is_valid)]
            rows.append((np.linalg.norm(hand.stretch_m), control.last_rad_s))
        arm.send(control.update(sample, tasks).dq_rad_s)
    return sensor, *map(np.array, zip(*rows, strict=True))


@pytest.mark.slow
def test_stiff_hands_do_not_swing_late_arms():
    sensor, stretches_m, _ = guide_simulated_arm("fri", 2000.0, 0.02, 0.4)

    assert sensor.rejected == 0
    assert 1e-3 < stretches_m.max() < 0.02
    assert stretches_m[-500:].max() < 3e-3


@pytest.mark.slow
def test_a_stiff_arm_does_not_answer_its_own_acceleration():
    """Led at 120 mm/s it moves smoothly: no torque steps that count as spikes."""
    sensor, _, velocities_rad_s = guide_simulated_arm("clean", 500.0, 0.12, 1.0)
    jumps_rad_s2 = np.diff(velocities_rad_s[50:], 2, axis=0) / 1e-3

    assert sensor.rejected == 0
    assert np.abs(jumps_rad_s2).max() < 2.0  # from cycle to cycle; the limit is 20


MAX_TIP_m_s = 0.25
UR5E = load_example("ur5e", payload=NeedleTool())
PANDA = load_example("panda", without=["panda_hand"], payload=NeedleTool())
ARMS = {
    "ur5e": (
        UR5E,
        Limits(UR5E, tip_m_s=MAX_TIP_m_s),
        (0.0, -1.2, 1.6, -1.9, -1.57, 0.0),
    ),
    "fr3": (
        PANDA,
        Limits.of_arm(PANDA, "fr3", tip_m_s=MAX_TIP_m_s),
        (0.0, -0.4, 0.0, -2.2, 0.0, 1.8, 0.8),
    ),
}


def lead(name, force_at, seconds):
    """Lead an arm whose torques come 10 ms late, with 0.05 Nm friction of its joints.

    ``force_at`` returns the hand's force [N] from the tip's displacement and velocity.
    Returns displacements [m], velocities [m/s] and forces [N] of the tip.
    """
    robot, limits, posture_rad = ARMS[name]
    guidance = Guidance(robot)
    controller = Controller(robot, limits)
    arm = LateArm(robot, posture_rad)
    start_m = arm.tool.tip_m
    late = deque([np.zeros(robot.nv)] * 10)
    tip_m_s = np.zeros(3)
    rows = []
    for tick in range(round(seconds / DT_s)):
        force_N = force_at(tick * DT_s, arm.tool.tip_m - start_m, tip_m_s)
        late.append(arm.tool.jacobian[:3].T @ force_N)
        torque_Nm = late.popleft()
        torque_Nm -= np.clip(torque_Nm, -0.05, 0.05)
        task = guidance.update(torque_Nm, np.full(robot.nv, 0.01), DT_s)
        follow(controller, arm, [task], 1)
        tip_m_s = (arm.tips_m[-1] - arm.tips_m[-2]) / DT_s
        rows.append((arm.tool.tip_m - start_m, tip_m_s, force_N))
    return map(np.array, zip(*rows, strict=True))


def test_the_formula_gives_an_lwr_about_what_was_found_for_it():
    names = "nv model create_data effort_limit_Nm velocity_limit_rad_s"
    names += " position_lower_rad position_upper_rad"
    known = {name: getattr(ROBOT, name) for name in names.split()}
    stranger = SimpleNamespace(joint_names=["a"] * 7, **known)
    by_formula, found = (
        velocity(Guidance(robot), 5.0, 3000) for robot in (stranger, ROBOT)
    )

    assert (found / by_formula).min() > 0.5
    assert (found / by_formula).max() < 2.0


@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("push_N", [5.0, 20.0])
def test_a_hand_moves_the_needle_at_a_bounded_speed(name, push_N):
    pushed_N = np.array([0.0, push_N, 0.0])
    _, speed_m_s, _ = lead(name, lambda t, x, v: pushed_N, seconds=0.3)

    assert 0.05 < np.linalg.norm(speed_m_s, axis=1).max() < 1.05 * MAX_TIP_m_s
    assert (speed_m_s @ pushed_N).min() >= 0.0  # it never pushes back


@pytest.mark.parametrize("name", ARMS)
def test_a_hand_of_500_N_per_m_leads_and_does_not_swing(name):
    goal_m = np.array([0.0, 0.05, 0.0])

    def pull(time_s, moved_m, speed_m_s):
        return 500.0 * (goal_m * min(time_s, 1.0) - moved_m) - 5.0 * speed_m_s

    moved_m, speed_m_s, force_N = lead(name, pull, seconds=3.0)
    assert np.linalg.norm(moved_m[-1] - goal_m) < 0.01
    assert np.abs(speed_m_s[-300:]).max() < 5e-3
    energy_J = DT_s * np.cumsum((force_N * speed_m_s).sum(axis=1))
    assert energy_J.min() > -1e-3


def test_one_number_makes_an_arm_heavier():
    light, heavy = (velocity(Guidance(ROBOT, scale=s), 3.0, 1000) for s in (1.0, 4.0))

    assert light == pytest.approx(4.0 * heavy, rel=0.05)
    assert (heavy > 0.0).all()
