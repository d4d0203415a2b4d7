"""The robot every estimator works on: a Pinocchio model with a tool and a payload."""

from dataclasses import dataclass, field, replace

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from urdf.errors import InputError, UnknownNameError, finite_array, read_only
from urdf.payload import Payload


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Robot:
    """An arm of one-number joints, what it carries, and the frame forces are asked for.

    Build one with `urdf.load_lwr`, `urdf.load_urdf` or `urdf.build_serial_robot`.

    Attributes:
        bare_model: The arm without payload; copied on construction.
        tool_frame: Name of the frame whose wrench is of interest.
        flange_frame: Name of the frame that carries the payload.
        payload: What hangs on the flange, in the flange frame, or None.
        model: The Pinocchio model with the payload, handed out directly for hot loops: read it, do
            not write it.
        tool_frame_id: Index of the tool frame in ``model.frames``.

    Raises:
        UnknownNameError: The tool or flange frame is not in the model.
    """

    bare_model: pin.Model
    tool_frame: str
    flange_frame: str
    payload: Payload | None = None
    model: pin.Model = field(init=False, repr=False)
    tool_frame_id: int = field(init=False)

    def __post_init__(self) -> None:
        bare = pin.Model(self.bare_model)
        object.__setattr__(self, "bare_model", bare)
        object.__setattr__(self, "model", pin.Model(bare))
        object.__setattr__(self, "tool_frame_id", self.frame_id(self.tool_frame))
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
    def gravity_m_s2(self) -> NDArray[np.float64]:
        """Gravity in base axes, shape (3,), m/s^2."""
        return read_only(self.model.gravity.linear)

    @property
    def position_lower_rad(self) -> NDArray[np.float64]:
        """Lower position limits, shape (nv,), rad (m for sliding joints)."""
        return read_only(self.model.lowerPositionLimit)

    @property
    def position_upper_rad(self) -> NDArray[np.float64]:
        """Upper position limits, shape (nv,), rad (m for sliding joints)."""
        return read_only(self.model.upperPositionLimit)

    @property
    def velocity_limit_rad_s(self) -> NDArray[np.float64]:
        """Velocity limits, shape (nv,), rad/s (m/s for sliding joints)."""
        return read_only(self.model.upperVelocityLimit)

    @property
    def effort_limit_Nm(self) -> NDArray[np.float64]:
        """Torque limits, shape (nv,), Nm (N for sliding joints)."""
        return read_only(self.model.upperEffortLimit)

    def frame_id(self, name: str) -> int:
        """Return the index of a frame in ``model.frames``.

        A joint and the link behind it may share a name; they then share the origin and axes too.

        Raises:
            UnknownNameError: No frame of that name; the message lists the names there are.
        """
        for index, frame in enumerate(self.model.frames):
            if frame.name == name:
                return index
        raise UnknownNameError(
            f"there is no frame {name!r} on {self.model.name!r}; "
            f"frames: {', '.join(self.frame_names)}"
        )

    def create_data(self) -> pin.Data:
        """Return fresh Pinocchio workspace for ``model``; each thread or observer needs its own."""
        return self.model.createData()

    def with_payload(self, payload: Payload | None) -> "Robot":
        """Return the robot with this payload in place of the present one; frames stay as they are.

        Raises:
            InputError: Not a payload.
        """
        if payload is not None and not isinstance(payload, Payload):
            raise InputError(
                f"with_payload expects a Payload or None, got {type(payload).__name__} "
                "(a NeedleTool brings frames too: give it to the loader, or pass its .payload)"
            )
        return replace(self, payload=payload)

    def with_armature(self, rotor_inertia_kg_m2: ArrayLike) -> "Robot":
        """Return the robot with rotor inertias added to the diagonal of its mass matrix.

        For arms whose torque is measured at the motor; the LWR measures behind the gear and needs
        none.

        Args:
            rotor_inertia_kg_m2: As seen at the joints, not negative, shape (nv,).

        Raises:
            InputError: Wrong shape, not finite or negative.
        """
        rotor = finite_array(rotor_inertia_kg_m2, (self.nv,), "rotor_inertia_kg_m2")
        if np.any(rotor < 0.0):
            raise InputError(f"rotor_inertia_kg_m2 must not be negative: {rotor.tolist()}")
        bare = pin.Model(self.bare_model)
        bare.armature = rotor.copy()
        return replace(self, bare_model=bare)
