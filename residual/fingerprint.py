"""What a snapshot belongs to: the robot, and the settings of the sensor."""

import hashlib
from dataclasses import replace

import numpy as np

from residual.config import SensorConfig
from urdf import Robot


def settings_text(config: SensorConfig, joints: int) -> str:
    """Return settings in words that are equal only for equal settings.

    Every setting by name, all digits of every number. A friction model may be any
    object: it is known by the torques that it gives.
    """
    text = repr(replace(config, friction=None))
    if config.friction is None:
        return text
    digest = hashlib.sha256()
    speeds_rad_s = np.array([0.0, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0])
    # Different speeds of neighbours: joints may have changed places.
    joint_factors = 1.0 + 0.1 * np.arange(joints)
    for speed_rad_s in (*speeds_rad_s, *-speeds_rad_s):
        torque = config.friction.torque(speed_rad_s * joint_factors)
        digest.update(np.ascontiguousarray(torque, dtype=np.float64).tobytes())
    return f"{text} with {type(config.friction).__name__} {digest.hexdigest()[:16]}"


def robot_digest(robot: Robot) -> str:
    """Return a hash of everything about a robot that an estimate depends on.

    Joints with their axes and parents, links, payload, frames, limits and gravity: 64
    hexadecimal digits.
    """
    text = f"{robot.tool_frame}\n{robot.model.saveToString()}"
    return hashlib.sha256(text.encode()).hexdigest()
