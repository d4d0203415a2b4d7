"""A short motion in the model, after which every update takes its usual time."""

import numpy as np
import pinocchio as pin

from needleforce.session import InsertionSession
from residual import SensorConfig
from urdf import Robot

SAMPLES = 800
"""Before the tare: as many as a tare needs, at 1 kHz."""

SAMPLES_AFTER = 200
"""After it, with the identification."""

STEP_S = 1e-3
AMPLITUDE_RAD = 0.05
RATE_RAD_S = 2.0 * np.pi
MAX_RANGE_RAD = 2.0
"""Limits beyond this, as of joints without limits, are not halved for a posture."""


def warm_up(robot: Robot, config: SensorConfig) -> None:
    """Let a session of its own follow a motion: what is compiled is then loaded.

    Args:
        robot: The arm.
        config: Settings of the sensor.
    """
    session = InsertionSession(robot, config)
    data = robot.create_data()
    lower_rad = np.clip(robot.position_lower_rad, -MAX_RANGE_RAD, MAX_RANGE_RAD)
    upper_rad = np.clip(robot.position_upper_rad, -MAX_RANGE_RAD, MAX_RANGE_RAD)
    centre_rad = 0.5 * (lower_rad + upper_rad) + 0.1 * np.arange(1, robot.nv + 1)
    for index in range(SAMPLES + SAMPLES_AFTER):
        if index == SAMPLES:
            # So many that one update does all of a tare.
            all_steps = 10**9
            session.start_tare(ignore_contact=True, steps_per_tick=all_steps)
        phase_rad = RATE_RAD_S * STEP_S * index
        q_rad = centre_rad + AMPLITUDE_RAD * np.sin(phase_rad)
        dq_rad_s = np.full(robot.nv, AMPLITUDE_RAD * RATE_RAD_S * np.cos(phase_rad))
        torque_Nm = pin.rnea(robot.model, data, q_rad, dq_rad_s, np.zeros(robot.nv))
        session.update(q_rad, dq_rad_s, torque_Nm, STEP_S)
