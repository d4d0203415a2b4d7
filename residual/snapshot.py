"""What a snapshot needs: the form of state trees, and to which sensor they belong."""

import hashlib
import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from residual.errors import Array, SnapshotError
from residual.momentum_observer import joint_axis
from urdf import Robot

GROWING = "recorder.sums"  # End of the place of the one array that grows
LIKE = {
    "stream.guard.noise": "stream.guard.last",
    "stream.guard.rejected": "stream.guard.last",
    "stream.guard.swept": "stream.guard.velocity",
}
"""Places of arrays that a new sensor has not got yet, and others of the same shape."""
LARGEST = (
    1e30  # No number of a state is larger; its square can still be calculated with
)
_SPEEDS_RAD_S = np.array([0.0, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0])


def _names(node: object) -> tuple[str, ...]:
    """Names of the fields of a named tuple or data class, none of anything else."""
    if is_dataclass(node):
        return tuple(field.name for field in fields(node))
    return getattr(type(node), "_fields", ())


def arrays(node: Any, place: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    """Every array of a tree, and where it stands: names of fields with dots between.

    Refuses a part that is of another kind than its field, or a number that no state can
    have.
    """
    if isinstance(node, np.ndarray):
        yield place, node
    if isinstance(node, np.ndarray | float):
        # A limit may be infinite.
        allowed = (np.abs(node) <= LARGEST) | (
            place.endswith("alone.limit_s") & (node == np.inf)
        )
        if not np.all(allowed):
            raise SnapshotError(f"{place} cannot be {str(node)[:80]}")
    hints = get_type_hints(type(node)) if _names(node) else {}
    for name in _names(node):
        part = getattr(node, name)
        hint = hints[name]
        where = f"{place}.{name}" if place else name
        given = get_args(hint) if isinstance(hint, UnionType) else (hint,)
        kinds = tuple(get_origin(kind) or kind for kind in given)
        if Literal not in kinds and not isinstance(part, kinds):
            raise SnapshotError(f"{where} is a {type(part).__name__}, expected {hint}")
        yield from arrays(part, where)
    if isinstance(node, tuple) and not hints:
        for k, part in enumerate(node):
            yield from arrays(part, f"{place}.{k}")


def settings_text(config: Any, joints: int) -> str:
    """Settings in words that are equal only for equal settings.

    Every setting by name, all digits of every number. A friction model may be any
    object: it is known by the torques that it gives.
    """
    texts = [
        f"{name}={_plain(getattr(config, name))}"
        for name in _names(config)
        if name != "friction"
    ]
    friction = config.friction
    text = "None"
    if friction is not None:
        found = hashlib.sha256()
        for speed in (*_SPEEDS_RAD_S, *-_SPEEDS_RAD_S):
            # Not the same speed everywhere: joints may have changed places.
            torque = friction.torque(speed * (1.0 + 0.1 * np.arange(joints)))
            found.update(np.ascontiguousarray(torque, dtype=np.float64).tobytes())
        text = f"{type(friction).__name__} {found.hexdigest()[:16]}"
    return f"{', '.join(texts)}, friction={text}"


def _plain(value: object) -> object:
    """Numbers of any kind and shape as Python's own, whose text has all their
    digits.
    """
    if is_dataclass(value):
        return {name: _plain(getattr(value, name)) for name in _names(value)}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return tuple(_plain(one) for one in value)
    return repr(value)


def robot_digest(robot: Robot) -> str:
    """A hash of everything about a robot that an estimate depends on.

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
    found = hashlib.sha256("\n".join(names).encode())
    for array in arrays:
        found.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
    return found.hexdigest()


TRIED = 3
TRIED_S = 0.03
"""Steps of a trial, each long enough that everything which changes slowly is
renewed."""


def try_out(twin: Any, state: Any) -> None:
    """Make a damaged state fail now, with a `SnapshotError`, and not in a later update.

    The twin is a new `VirtualForceSensor` of the same robot and settings, that nobody
    uses.
    """
    try:
        still = np.zeros(len(state.weighed_at))
        _run(twin, state, still, still, still)
        expected = {place: array.shape for place, array in arrays(twin.snapshot())}
        for place, array in arrays(state):
            first = 1 if place.endswith(GROWING) else 0
            wanted = expected.get(LIKE.get(place, place), array.shape)
            if array.ndim != len(wanted) or array.shape[first:] != wanted[first:]:
                raise SnapshotError(
                    f"{place} has shape {array.shape}, expected {wanted}"
                )
        twin._take(deepcopy(state))
        _run(
            twin, state, state.offset.q, state.offset.dq, state.offset.joint_memory[-2]
        )
    except Exception as error:  # whatever a damaged state makes of its parts
        raise SnapshotError(f"the snapshot is damaged: {error}") from error


def _run(twin: Any, state: Any, q: Array, dq: Array, torque: Array) -> None:
    """A few samples of the kind that the state is of."""
    stream = state.stream
    if stream is None:
        return
    update = twin.update_external_torque if state.is_external else twin.update
    for _ in range(TRIED):
        found = update(q, dq if stream.velocity is None else None, torque, TRIED_S)
        if not np.isfinite(found[:4]).all() or not math.isfinite(found.model_mismatch):
            raise SnapshotError("its estimates are not finite")
