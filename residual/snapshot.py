"""All that a virtual force sensor remembers, as one immutable value."""

import hashlib
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from residual.bias_estimator import OffsetState
from residual.config import SensorConfig
from residual.consistency_checks import SlowState
from residual.errors import SnapshotError
from residual.estimate import WrenchEstimate
from residual.joint_friction import FrictionModel
from residual.sample_stream import ExternalTorqueStreamState, JointStreamState
from residual.wrench_estimator import AxialWeights
from urdf import Robot


class SensorState(NamedTuple):
    """State of a `VirtualForceSensor`.

    Attributes:
        robot: `robot_digest` of its robot.
        config: Its settings in words; they must be the same to go on.
        joints: Of the stream of joint signals; None before the first sample of one.
        external_torque: Of the stream of external torques; None before the first sample of one.
        lag_s: Of the stream that the last sample came by [s].
        offset: Of the offset removal.
        torque_covariance: Of the residual's error, as last renewed [Nm^2], shape (n, n).
        weights: Of the wrench, as last renewed.
        slow: Of the slow checks.
        doubt: Of the doubt that the lag adds [N].
        looked_s: Time since the last slow check [s].
        velocity: Joint velocity of the last sample [rad/s], shape (n,).
        last: Last estimate; None before the first.
        missed_s: Time of samples skipped since then [s].
        skipped: Number of bad samples so far.
    """

    robot: str
    config: str
    joints: JointStreamState | None
    external_torque: ExternalTorqueStreamState | None
    lag_s: float
    offset: OffsetState
    torque_covariance: NDArray[np.float64]
    weights: AxialWeights
    slow: SlowState
    doubt: float | None
    looked_s: float
    velocity: NDArray[np.float64]
    last: WrenchEstimate | None
    missed_s: float
    skipped: int


def check_belongs(state: object, robot: str, config: str) -> None:
    """Refuse a state that is not of such a sensor.

    Args:
        state: What is to be restored.
        robot: `robot_digest` of the sensor's robot.
        config: Its settings in words.

    Raises:
        SnapshotError: With what differs.
    """
    if not isinstance(state, SensorState):
        raise SnapshotError(f"expected a SensorState, got {type(state).__name__}")
    if state.robot != robot:
        raise SnapshotError(
            "the snapshot is of another robot (joints, links, payload, frames or limits differ); "
            "restore it with the robot it was taken with"
        )
    if state.config != config:
        raise SnapshotError(
            f"the snapshot is of other settings: {state.config}, this sensor has {config}"
        )


# Whether a state has the form of a sensor's: arrays of the shapes that such a sensor keeps.


GROWING = ("probe.rows", "recorder.means", "recorder.time_s", "recorder.scatter")
"""Ends of the places of arrays whose first dimension counts what was gathered so far."""
LIKE = {"guard.noise": "guard.last", "guard.rejected": "guard.last"}
"""Arrays that a new sensor has not got yet, and others of the same shape."""


def check_form(state: object, model: object) -> None:
    """Compare the shapes of all arrays of a state with those of another of the same kind.

    Args:
        state: What is to be restored.
        model: State of a sensor of the same robot and settings that has seen samples.

    Raises:
        SnapshotError: With the array that differs.
    """
    expected = {place: array.shape for place, array in _arrays(model)}
    for place, array in _arrays(state):
        first = 1 if place.endswith(GROWING) else 0
        known = place
        for new, old in LIKE.items():
            known = known.replace(new, old)
        wanted = expected.get(known, array.shape)
        if array.ndim != len(wanted) or array.shape[first:] != wanted[first:]:
            raise SnapshotError(f"{place} has shape {array.shape}, expected {wanted}")


def _arrays(value: Any, place: str = "") -> Iterator[tuple[str, np.ndarray[Any, Any]]]:
    """Every array of a state, and where it stands: names of fields with dots between."""
    if isinstance(value, np.ndarray):
        yield place, value
    for name in getattr(type(value), "_fields", ()):
        yield from _arrays(getattr(value, name), f"{place}.{name}" if place else name)


# Settings in words that are equal only for equal settings.


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


# A short name for everything about a robot that an estimate depends on.


def robot_digest(robot: Robot) -> str:
    """Hash of joints with their axes and parents, links, payload, frames, limits and gravity.

    Args:
        robot: Any robot.

    Returns:
        64 hexadecimal digits; equal for robots that no estimator can tell apart.
    """
    model = robot.model
    names = (*robot.joint_names, robot.tool_frame, *robot.frame_names)
    arrays = [
        np.array(list(model.parents)),
        np.array([frame.parentJoint for frame in model.frames]),
        *(_axis(joint) for joint in list(model.joints)[1:]),
        *(inertia.toDynamicParameters() for inertia in model.inertias),
        *(placement.homogeneous for placement in model.jointPlacements),
        *(frame.placement.homogeneous for frame in model.frames),
        robot.gravity_m_s2,
        robot.position_lower_rad,
        robot.position_upper_rad,
        robot.effort_limit_Nm,
        model.armature,
    ]
    found = hashlib.sha256("\n".join(names).encode())
    for array in arrays:
        found.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
    return found.hexdigest()


def _axis(joint: pin.JointModel) -> NDArray[np.float64]:
    """How a joint of one number moves its link: velocity and rotation for a rate of one."""
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq))
    return np.asarray(data.S)
