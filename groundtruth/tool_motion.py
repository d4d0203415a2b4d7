"""The joint motion of a scenario: the needle along its line, or all joints in free air."""

import numpy as np

from groundtruth.arm_plant import TICK_s
from groundtruth.insertion_path import InsertionPath, LWR_POSTURE_rad, insertion_path, needle_down
from groundtruth.joint_excitation import joint_excitation
from groundtruth.joint_reference import JointMotion, motion_along
from groundtruth.scenario import Scenario
from urdf import Robot

FREE_MOTION_s = 20.0
"""Length of the joint motion that follows the tare stroke where there is no tissue."""


def scenario_path(robot: Robot, scenario: Scenario) -> InsertionPath:
    """Plan the needle's line for a scenario, from the LWR's starting posture straight down.

    Args:
        robot: The LWR with its needle.
        scenario: Gives the travel.

    Raises:
        PathError: The line is out of the arm's reach.
    """
    start = needle_down(robot, np.array(LWR_POSTURE_rad))
    motion = scenario.motion
    return insertion_path(robot, start, (0.0, motion.deepest_m - motion.start_m))


def scenario_motion(path: InsertionPath, scenario: Scenario) -> JointMotion:
    """Sample a scenario's motion at the controller's ticks.

    A scenario without layers keeps its tare stroke; a motion of all joints then takes the place
    of the insertion.

    Args:
        path: Of `scenario_path`.
        scenario: Gives the travel over time.
    """
    motion = scenario.motion
    end_s = motion.duration_s if scenario.layers else motion.tare_end_s
    time = np.arange(round(end_s / TICK_s) + 1, dtype=np.float64) * TICK_s
    along = motion_along(path, motion.position_m(time) - motion.start_m, motion.speed_m_s(time))
    if scenario.layers:
        return along
    return along.then(joint_excitation(along.q_rad[-1], FREE_MOTION_s, TICK_s))
