"""How much an arm may carry: what a payload beyond that is, is something else.

Ratings are those of the makers' public data sheets; an arm that is not listed is rated
by the effort limits of its description.
"""

import re

import numpy as np
import pinocchio as pin

from urdf.robot import Robot

RATED_PAYLOADS_KG: dict[str, float] = {
    "lwr": 7.0,  # KUKA LBR 4+, technical data
    "iiwa7": 7.0,  # KUKA LBR iiwa 7 R800, data sheet
    "iiwa_7": 7.0,
    "iiwa14": 14.0,  # KUKA LBR iiwa 14 R820, data sheet
    "iiwa_14": 14.0,
    "panda": 3.0,  # Franka Emika Panda, data sheet
    "fr3": 3.0,  # Franka Research 3, data sheet
    "fer": 3.0,  # the Panda in franka_description
    "ur3": 3.0,  # Universal Robots, data sheets of the UR3 and the UR3e
    "ur5": 5.0,  # UR5 and UR5e
    "ur7e": 7.5,
    "ur10e": 12.5,
    "ur10": 10.0,
    "ur12e": 12.5,
    "ur15": 15.0,
    "ur16": 16.0,
    "ur20": 20.0,
    "ur30": 30.0,
    "xarm5": 3.0,  # UFACTORY xArm 5, 6 and 7, user manual
    "xarm6": 5.0,
    "xarm7": 3.5,
    "gen3": 4.0,  # Kinova Gen3 and Gen3 lite, user guides
    "gen3_lite": 0.5,
    "sawyer": 4.0,  # Rethink Robotics Sawyer, specifications
}
"""Rated payload by a part of the arm's name, the longest that fits [kg]."""

STANDARD_GRAVITY_M_S2 = 9.80665
"""Takes the place of a gravity of zero."""

EFFORT_FRACTION = 0.3
"""Fraction of the shoulder's torque that the rated payload takes with the arm
outstretched; the arm itself takes most of the rest."""


def rated_payload_kg(robot: Robot) -> float:
    """Return how much an arm may carry.

    That is the maker's rating where the arm's name says which one it is. Else it is
    estimated from the effort limits: what takes `EFFORT_FRACTION` of the strongest
    joint's torque at the reach of the arm.
    """
    known_effort_Nm = 1e4  # effort limits from here on are placeholders [Nm]
    min_rating_kg = 0.5  # least rating from effort limits
    # Rating of an arm whose description has no effort limits: anything a small arm
    # carries.
    unknown_rating_kg = 50.0
    name = robot.model.name.lower().replace("-", "_")
    known = [
        part
        for part in RATED_PAYLOADS_KG
        if re.search(rf"(?<![a-z0-9]){part}", name)  # not within a word
    ]
    if known:
        return RATED_PAYLOADS_KG[max(known, key=len)]
    efforts = robot.effort_limit_Nm
    is_known = (efforts > 0.0) & (efforts < known_effort_Nm)
    reach_m = sum(_joint_distances_m(robot.bare_model))
    if not is_known.any() or reach_m == 0.0:
        return unknown_rating_kg
    gravity = float(np.linalg.norm(robot.gravity_m_s2)) or STANDARD_GRAVITY_M_S2
    rating_kg = EFFORT_FRACTION * float(efforts[is_known].max()) / (gravity * reach_m)
    return max(rating_kg, min_rating_kg)


def _joint_distances_m(model: pin.Model) -> list[float]:
    """Return the distances from joint to joint behind the first."""
    placements = list(model.jointPlacements)[2:]
    return [float(np.linalg.norm(place.translation)) for place in placements]
