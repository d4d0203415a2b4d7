"""Settings in words that are equal only for equal settings."""

import hashlib
from dataclasses import fields, is_dataclass

import numpy as np

from residual.joint_friction import FrictionModel
from residual.sensor_config import SensorConfig

_SPEEDS_RAD_S = np.array([0.0, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0])


def settings_text(config: SensorConfig, joints: int) -> str:
    """Every setting by name, all digits of every number, friction by what it does.

    A friction model may be any object: it is known by the torques that it gives.

    Args:
        config: Settings of a sensor.
        joints: Number of joints of its robot.
    """
    texts = [
        f"{field.name}={_plain(getattr(config, field.name))}"
        for field in fields(config)
        if field.name != "friction"
    ]
    return f"{', '.join(texts)}, friction={_friction_text(config.friction, joints)}"


def _friction_text(friction: FrictionModel | None, joints: int) -> str:
    if friction is None:
        return "None"
    found = hashlib.sha256()
    for speed in (*_SPEEDS_RAD_S, *-_SPEEDS_RAD_S):
        # Not the same speed everywhere: joints may have changed places.
        torque = friction.torque(speed * (1.0 + 0.1 * np.arange(joints)))
        found.update(np.ascontiguousarray(torque, dtype=np.float64).tobytes())
    return f"{type(friction).__name__} {found.hexdigest()[:16]}"


def _plain(value: object) -> object:
    """Numbers of any kind and shape as Python's own, whose text has all their digits."""
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return tuple(_plain(one) for one in value)
    return repr(value)
