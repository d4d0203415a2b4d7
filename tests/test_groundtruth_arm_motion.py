import numpy as np
import pinocchio as pin
import pytest

from groundtruth.arm_control import (
    JointMotion,
    drive,
    joint_excitation,
    joint_reference,
    motion_along,
)
from groundtruth.arm_plant import ArmPlant, TICK_s, TissueContact, lwr_bodies
from groundtruth.errors import PathError, PlantError
from groundtruth.insertion_path import LWR_POSTURE_rad, insertion_path, needle_down
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.scenarios import SCENARIOS
from groundtruth.tissue import Tissue
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
START = needle_down(ROBOT, np.array(LWR_POSTURE_rad))
REACH_M = 0.24


def tool_pose(q):
    data = ROBOT.create_data()
    pin.framesForwardKinematics(ROBOT.model, data, q)
    return data.oMf[ROBOT.tool_frame_id]


def test_start_points_the_needle_straight_down_with_the_tip_in_place():
    before, after = tool_pose(np.array(LWR_POSTURE_rad)), tool_pose(START)
    np.testing.assert_allclose(after.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-10)
    np.testing.assert_allclose(after.translation, before.translation, atol=1e-10)


def test_path_is_a_straight_line_along_the_needle_between_knots_too():
    path = insertion_path(ROBOT, START, (0.0, REACH_M))
    for travel in np.linspace(0.0, REACH_M, 97):
        moved = path.transform_start_to_base.actInv(tool_pose(path.spline(travel)))
        np.testing.assert_allclose(moved.translation, [0.0, 0.0, travel], atol=2e-9)
        np.testing.assert_allclose(moved.rotation, np.eye(3), atol=2e-9)


def test_path_stays_well_inside_limits_and_away_from_singularities():
    path = insertion_path(ROBOT, START, (0.0, REACH_M))
    for travel in np.linspace(0.0, REACH_M, 21):
        q = path.spline(travel)
        margin = np.minimum(ROBOT.position_upper_rad - q, q - ROBOT.position_lower_rad)
        assert margin.min() > np.radians(20.0)
        jacobian = pin.computeFrameJacobian(
            ROBOT.model, ROBOT.create_data(), q, ROBOT.tool_frame_id
        )
        assert np.linalg.cond(jacobian) < 12.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_every_scenario_is_within_the_arms_reach(name):
    motion = SCENARIOS[name].motion
    assert 0.0 < motion.deepest_m - motion.start_m <= REACH_M


def test_line_out_of_reach_is_refused():
    with pytest.raises(PathError, match="no posture reaches"):
        insertion_path(ROBOT, START, (0.0, 2.0))


def test_line_beyond_joint_limits_is_refused():
    with pytest.raises(PathError, match="limits of lwr_joint_6 are exceeded"):
        insertion_path(ROBOT, START, (-0.3, 0.0))


def test_nearly_stretched_arm_is_refused():
    with pytest.raises(PathError, match="nearly singular"):
        needle_down(ROBOT, np.array([0.0, 1.57, 0.0, -0.02, 0.0, 1.57, 0.0]))


def test_joint_speed_is_the_derivative_of_joint_position():
    time = np.arange(2001) * TICK_s
    path = insertion_path(ROBOT, START, (0.0, 0.06))
    travel, speed = 0.03 * (1 - np.cos(np.pi * time)), 0.03 * np.pi * np.sin(np.pi * time)
    for motion in (motion_along(path, travel, speed), joint_excitation(START, 12.0, TICK_s)):
        numeric = (motion.q_rad[2:] - motion.q_rad[:-2]) / (2.0 * TICK_s)
        np.testing.assert_allclose(motion.dq_rad_s[1:-1], numeric, atol=2e-6)


def test_excitation_moves_all_joints_from_rest_to_rest_within_limits():
    motion = joint_excitation(START, 20.0, TICK_s)
    peak = np.abs(motion.dq_rad_s).max(axis=0)
    assert ((peak > 0.3) & (peak < 0.6)).all()
    assert (motion.q_rad > ROBOT.position_lower_rad).all()
    assert (motion.q_rad < ROBOT.position_upper_rad).all()
    np.testing.assert_array_equal(motion.dq_rad_s[[0, -1]], 0.0)
    assert np.abs(np.diff(motion.dq_rad_s, axis=0)).max() / TICK_s < 2.0


def test_motions_join_without_repeating_the_common_sample():
    first = joint_excitation(START, 9.0, TICK_s)
    second = joint_excitation(first.q_rad[-1], 9.0, TICK_s)
    both = first.then(second)
    assert len(both.q_rad) == len(first.q_rad) + len(second.q_rad) - 1
    assert np.abs(np.diff(both.q_rad, axis=0)).max() < 1e-3


def free_arm():
    bodies = lwr_bodies(NeedleTool(), PLANT_MODELS["degraded"], np.random.default_rng(0))
    air = TissueContact(
        law=Tissue(()), surface_in_base_m=np.zeros(3), axis_in_base=np.array([0.0, 0.0, -1.0])
    )
    return bodies, ArmPlant(bodies, air)


def test_controller_follows_a_fast_free_motion():
    bodies, plant = free_arm()
    motion = joint_excitation(START, 10.0, TICK_s)
    trace = drive(plant, joint_reference(bodies.model(), motion, TICK_s))
    assert np.abs(trace.q_rad - motion.q_rad[:-1]).max() < 1e-6
    assert not trace.external_torque_Nm.any()


def test_losing_the_motion_is_reported():
    bodies, plant = free_arm()
    still = JointMotion(q_rad=np.tile(START, (1002, 1)), dq_rad_s=np.zeros((1002, 7)))
    reference = joint_reference(bodies.model(), still, TICK_s)
    reference.feed_forward_Nm[:, 1] += 5e4
    with pytest.raises(PlantError, match="off its motion at tick"):
        drive(plant, reference)
