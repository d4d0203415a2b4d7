"""Sound snapshots: to which sensor they belong, and whether they are damaged."""

import hashlib
import math
from copy import deepcopy
from dataclasses import fields, is_dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.state import check_state
from residual.config import SensorConfig
from residual.errors import SnapshotError
from residual.estimate import WrenchEstimate
from residual.joint_friction import FrictionModel
from residual.momentum_observer import joint_axis
from residual.sensor_state import SensorState
from urdf import Robot

FRICTION_SPEEDS_RAD_S = np.array(
    [0.0, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0]
)
"""Speeds, both ways, at which two friction models are compared."""

JOINT_SPEED_RATIO = 0.1
"""Difference of the speeds of two neighbouring joints at which they are compared,
relative to the speed: joints may have changed places."""

TRIED_SAMPLES = 3
"""Samples with which a snapshot is tried out."""

TRIED_STEP_S = 0.03
"""Time step of these samples, so long that everything which changes slowly is
renewed."""


class TrialSensor(Protocol):
    """What a snapshot is tried out on: a `VirtualForceSensor` of its own."""

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, tau: ArrayLike, dt_s: float
    ) -> WrenchEstimate:
        """See `VirtualForceSensor.update`."""
        ...

    def update_external_torque(
        self,
        q: ArrayLike,
        dq: ArrayLike | None,
        external_torque: ArrayLike,
        dt_s: float,
    ) -> WrenchEstimate:
        """See `VirtualForceSensor.update_external_torque`."""
        ...

    def snapshot(self) -> SensorState:
        """See `VirtualForceSensor.snapshot`."""
        ...

    def restore_unchecked(self, state: SensorState) -> None:
        """See `VirtualForceSensor.restore_unchecked`."""
        ...


def settings_text(config: SensorConfig, joints: int) -> str:
    """Return settings in words that are equal only for equal settings.

    Every setting by name, all digits of every number. A friction model may be any
    object: it is known by the torques that it gives.
    """
    texts = [
        f"{field.name}={_plain_value(getattr(config, field.name))}"
        for field in fields(config)
        if field.name != "friction"
    ]
    friction = "None"
    if config.friction is not None:
        friction = _friction_text(config.friction, joints)
    return f"{', '.join(texts)}, friction={friction}"


def _friction_text(friction: FrictionModel, joints: int) -> str:
    """Return the name of a friction model with a hash of its torques."""
    digest = hashlib.sha256()
    joint_factors = 1.0 + JOINT_SPEED_RATIO * np.arange(joints)
    for speed in (*FRICTION_SPEEDS_RAD_S, *-FRICTION_SPEEDS_RAD_S):
        torque = friction.torque(speed * joint_factors)
        digest.update(np.ascontiguousarray(torque, dtype=np.float64).tobytes())
    return f"{type(friction).__name__} {digest.hexdigest()[:16]}"


def _plain_value(value: object) -> object:
    """Return numbers of any kind and shape as Python's own, with all their digits."""
    if is_dataclass(value):
        return {
            field.name: _plain_value(getattr(value, field.name))
            for field in fields(value)
        }
    if isinstance(value, np.ndarray | np.generic):
        return _plain_value(value.tolist())
    if isinstance(value, list | tuple):
        return tuple(_plain_value(item) for item in value)
    return repr(value)


def robot_digest(robot: Robot) -> str:
    """Return a hash of everything about a robot that an estimate depends on.

    Joints with their axes and parents, links, payload, frames, limits and gravity: 64
    hexadecimal digits, equal for robots that no estimator can distinguish.
    """
    model = robot.model
    names = (*robot.joint_names, robot.tool_frame, *robot.frame_names)
    arrays = [
        np.array(list(model.parents)),
        np.array([frame.parentJoint for frame in model.frames]),
        *(joint_axis(joint) for joint in list(model.joints)[1:]),
        *(inertia.toDynamicParameters() for inertia in model.inertias),
        *(placement.homogeneous for placement in model.jointPlacements),
        *(frame.placement.homogeneous for frame in model.frames),
        robot.gravity_m_s2,
        robot.position_lower_rad,
        robot.position_upper_rad,
        robot.effort_limit_Nm,
        model.armature,
    ]
    digest = hashlib.sha256("\n".join(names).encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
    return digest.hexdigest()


def check_sensor_state(twin: TrialSensor, state: SensorState) -> None:
    """Refuse a damaged state now, so that no later update fails.

    Its types, numbers and shapes are compared with those of a twin that has taken a few
    samples; then the twin goes on from it.

    Args:
        twin: A new sensor of the same robot and settings, that nobody uses.
        state: The state to check; it stays as it is.

    Raises:
        SnapshotError: If the state is damaged.
    """
    try:
        still = np.zeros(len(state.gain_configuration))
        _try_samples(twin, state, still, still, still)
        check_state(state, twin.snapshot())
        twin.restore_unchecked(deepcopy(state))
        offset = state.offset
        _try_samples(twin, state, offset.q, offset.dq, offset.lagged_torque)
    except Exception as error:  # whatever a damaged state makes of its parts
        raise SnapshotError(f"the snapshot is damaged: {error}") from error


def _try_samples(
    twin: TrialSensor, state: SensorState, q: Array, dq: Array, torque: Array
) -> None:
    """Give the twin a few equal samples of the kind that the state is of."""
    stream = state.stream
    if stream is None:
        return
    update = twin.update_external_torque if state.is_external else twin.update
    given_dq = dq if stream.velocity is None else None
    for _ in range(TRIED_SAMPLES):
        estimate = update(q, given_dq, torque, TRIED_STEP_S)
        numbers = (
            estimate.axial,
            estimate.axial_std,
            estimate.lateral,
            estimate.lateral_std,
            estimate.model_mismatch,
        )
        if not all(map(math.isfinite, numbers)):
            raise SnapshotError("its estimates are not finite")
