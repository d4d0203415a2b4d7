"""The robot every estimator works on: a Pinocchio model with a tool and a payload."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Array
from urdf.errors import (
    GIVE_INERTIA,
    InertiaError,
    InputError,
    UnknownNameError,
    UnsupportedJointError,
    finite_array,
    read_only,
)
from urdf.payload import (
    NeedleTool,
    Payload,
    impossible_moment,
    principal_moments,
    rigid_motion,
)

STANDARD_GRAVITY_M_S2 = (0.0, 0.0, -9.80665)
"""Straight down along the base's z axis."""

SENSOR_FRAME = "ft_sensor"
"""Frame that a needle tool adds in the sensor's measuring plane."""
TOOL_FRAME = "tool"
"""Frame that a tool placement adds."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Robot:
    """An arm of one-number joints, what it carries, and the frame forces are asked for.

    Build one with a loader of `urdf`, or from a Pinocchio model with
    `urdf.build_robot`. ``model`` has the payload and is handed out directly for hot
    loops: read it, do not write it.

    Attributes:
        bare_model: The arm without payload; copied on construction.
        tool_frame: Frame whose wrench is of interest.
        flange_frame: Frame that carries the payload.
        payload: Body that hangs on the flange, in the flange frame.
        warnings: What is odd in the robot's description, and what it does to a force.
        model: The arm with its payload.
        tool_frame_id: Index of the tool frame in ``model.frames``.
        position_lower_rad: Lower limits of the positions, shape (nv,), read-only like
            the other limits; of sliding joints in m.
        position_upper_rad: Upper limits of the positions, shape (nv,).
        velocity_limit_rad_s: Limits of the velocities, shape (nv,); of sliding joints
            in m/s.
        effort_limit_Nm: Limits of the torques, shape (nv,); of sliding joints in N.

    Raises:
        UnknownNameError: The tool or flange frame is not in the model.
        UnsupportedJointError: A joint of several numbers, as a ball joint or a point on
            the circle is, or none that moves.
    """

    bare_model: pin.Model
    tool_frame: str
    flange_frame: str
    payload: Payload | None = None
    warnings: tuple[str, ...] = ()
    model: pin.Model = field(init=False, repr=False)
    tool_frame_id: int = field(init=False)
    position_lower_rad: Array = field(init=False, repr=False)
    position_upper_rad: Array = field(init=False, repr=False)
    velocity_limit_rad_s: Array = field(init=False, repr=False)
    effort_limit_Nm: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        bare = pin.Model(self.bare_model)
        _require_simple_joints(bare)
        limits = {
            "position_lower_rad": bare.lowerPositionLimit,
            "position_upper_rad": bare.upperPositionLimit,
            "velocity_limit_rad_s": bare.upperVelocityLimit,
            "effort_limit_Nm": bare.upperEffortLimit,
        }
        object.__setattr__(self, "bare_model", bare)
        object.__setattr__(self, "model", pin.Model(bare))
        object.__setattr__(self, "tool_frame_id", self.frame_id(self.tool_frame))
        for name, limit in limits.items():
            object.__setattr__(self, name, read_only(limit))
        flange = bare.frames[self.frame_id(self.flange_frame)]
        if self.payload is not None and self.payload.mass_kg > 0.0:
            self.model.appendBodyToJoint(
                flange.parentJoint, self.payload.spatial_inertia, flange.placement
            )

    @property
    def nv(self) -> int:
        """Number of joints (and of positions, velocities and torques)."""
        return self.model.nv

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints in the order of every joint vector."""
        return tuple(self.model.names[1:])

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of all frames, each once."""
        return tuple(dict.fromkeys(frame.name for frame in self.model.frames))

    @property
    def gravity_m_s2(self) -> Array:
        """Gravity in base axes, shape (3,), m/s^2."""
        return read_only(self.model.gravity.linear)

    def frame_id(self, name: str) -> int:
        """Return the index of a frame in ``model.frames``.

        A joint and the link behind it may share a name; they then share the origin and
        axes too. `UnknownNameError` lists the names there are.
        """
        names = [frame.name for frame in self.model.frames]
        if name not in names:
            raise UnknownNameError(
                f"there is no frame {name!r} on {self.model.name!r}; "
                f"frames: {', '.join(self.frame_names)}"
            )
        return names.index(name)

    def create_data(self) -> pin.Data:
        """Return a new Pinocchio workspace for ``model``.

        Each thread and each observer needs its own.
        """
        return self.model.createData()

    def with_payload(self, payload: Payload | None) -> "Robot":
        """Return the robot with another payload, or with none.

        `InputError` for anything but a `Payload` or None.
        """
        if payload is not None and not isinstance(payload, Payload):
            raise InputError(
                f"with_payload expects a Payload or None, got {type(payload).__name__} "
                "(a NeedleTool brings frames too: give it to the loader, or pass its "
                ".payload)"
            )
        return replace(self, payload=payload)

    def with_armature(self, rotor_inertia_kg_m2: ArrayLike) -> "Robot":
        """Return the robot with rotor inertias added to its mass matrix's diagonal.

        For arms whose torque is measured at the motor (the LWR measures behind the
        gear): as seen at the joints, so times the gear ratio squared, shape (nv,);
        `InputError` if negative.
        """
        rotor = finite_array(rotor_inertia_kg_m2, (self.nv,), "rotor_inertia_kg_m2")
        if np.any(rotor < 0.0):
            raise InputError(
                f"rotor_inertia_kg_m2 must not be negative: {rotor.tolist()}"
            )
        bare = pin.Model(self.bare_model)
        bare.armature = rotor.copy()
        return replace(self, bare_model=bare)


def build_robot(
    model: pin.Model,
    *,
    flange_frame: str,
    tool_placement: pin.SE3 | ArrayLike | None = None,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    payload: Payload | NeedleTool | None = None,
    check_inertias: bool = True,
) -> Robot:
    """Return a robot of a Pinocchio model, with gravity set and the tool mounted.

    Args:
        model: The arm without tool; copied.
        flange_frame: Frame that carries the tool.
        tool_placement: See `urdf.load_urdf`, as for the other arguments and the errors.
        gravity_m_s2: Gravity in base axes, shape (3,), m/s^2.
        payload: What hangs on the flange, in its frame.
        check_inertias: False accepts, with a warning, links without inertia or with one
            that no rigid body can have, as identified models have.
    """
    tip_frame = "needle_tip"  # frame that a needle tool adds at its tip
    if payload is not None and not isinstance(payload, Payload | NeedleTool):
        raise InputError(
            f"payload must be Payload, NeedleTool or None, got {type(payload).__name__}"
        )
    model = pin.Model(model)
    model.gravity = pin.Motion(
        finite_array(gravity_m_s2, (3,), "gravity_m_s2").copy(), np.zeros(3)
    )
    # Refuses an unknown flange with a list of the frames there are.
    Robot(bare_model=model, tool_frame=flange_frame, flange_frame=flange_frame)
    if tool_placement is not None:
        placement = rigid_motion(tool_placement, "tool_placement")
        _add_frame(model, TOOL_FRAME, flange_frame, placement)
        flange_frame = TOOL_FRAME
    tool_frame = flange_frame
    body = payload
    if isinstance(body, NeedleTool):
        heights = {SENSOR_FRAME: body.sensor_height_m} if body.has_sensor else {}
        heights[tip_frame] = body.tip_in_flange_m[2]
        for name, height_m in heights.items():
            along_z = pin.SE3(np.eye(3), np.array([0.0, 0.0, height_m]))
            _add_frame(model, name, flange_frame, along_z)
        tool_frame = tip_frame
        body = body.payload
    robot = Robot(
        bare_model=model, tool_frame=tool_frame, flange_frame=flange_frame, payload=body
    )
    faults = _find_inertia_faults(robot)
    has_inertia = any(inertia.mass != 0.0 for inertia in list(robot.model.inertias)[1:])
    if faults and (check_inertias or not has_inertia):
        raise InertiaError(f"{model.name}: {'; '.join(faults)}", GIVE_INERTIA)
    warnings = tuple(f"{model.name}: accepted: {fault}" for fault in faults)
    return replace(robot, warnings=warnings)


def _require_simple_joints(model: pin.Model) -> None:
    """Refuse joints of several positions or velocities, and robots without joints."""
    if model.nv == 0:
        raise UnsupportedJointError(f"robot {model.name!r} has no joint that moves")
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if (joint.nq, joint.nv) != (1, 1):
            raise UnsupportedJointError(
                f"joint {name!r} has {joint.nq} positions and {joint.nv} velocities, "
                "expected one each"
            )


def _add_frame(model: pin.Model, name: str, parent: str, placement: pin.SE3) -> None:
    names = [frame.name for frame in model.frames]
    if name in names:
        raise UnknownNameError(
            f"the tool adds the frame {name!r}, but robot {model.name!r} has one of "
            "that name; rename it, or attach the tool as a plain payload (tool.payload)"
        )
    index = names.index(parent)
    frame = model.frames[index]
    placement = frame.placement * placement
    model.addFrame(
        pin.Frame(name, frame.parentJoint, index, placement, pin.FrameType.OP_FRAME)
    )


def _find_inertia_faults(robot: Robot) -> Sequence[str]:
    """Return what is wrong with the inertia of what a robot's joints move, in words.

    Links that are fixed to each other move as one body, and only what they have
    together enters a torque. Inertia that no body can have changes no torque at rest;
    while joints accelerate it does, by the `impossible_moment` times the acceleration.
    """
    model = robot.model
    mass_matrix = pin.crba(model, robot.create_data(), pin.neutral(model))
    is_turning = [
        joint.shortname().startswith("JointModelR") for joint in list(model.joints)[1:]
    ]
    # Neither what joints turn nor a body's own moment is known better than to 5 %; a
    # milligram at a metre is the rounding of a written table.
    tolerated_kg_m2 = max(
        1e-6, 0.05 * np.diag(mass_matrix)[is_turning].max(initial=0.0)
    )
    faults: list[str] = []
    for joint in range(1, model.njoints):
        where = f"behind joint {model.names[joint]}"
        body = robot.bare_model.inertias[joint]
        if model.inertias[joint].mass == 0.0:
            faults.append(f"{where} there is no mass, its weight would be in the force")
        elif (
            body.mass != 0.0
            and impossible_moment(body.toDynamicParameters()) > tolerated_kg_m2
        ):
            moments = principal_moments(body.toDynamicParameters()).round(9).tolist()
            faults.append(
                f"{where} no rigid body has the mass {body.mass:g} kg and principal "
                f"moments {moments} kg m^2"
            )
    if not faults and np.linalg.eigvalsh(mass_matrix)[0] <= 0.0:
        idle = np.flatnonzero(np.diag(mass_matrix) <= 0.0)
        names = ", ".join(robot.joint_names[k] for k in idle)
        faults.append(f"the mass matrix is singular; joints without inertia: {names}")
    return faults
