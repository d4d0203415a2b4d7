"""A rigid body carried at the flange."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from urdf.errors import InputError
from urdf.finite_array import finite_array, read_only
from urdf.pseudo_inertia import (
    inertia_about_com,
    moved_parameters,
    parameters_about_com,
    require_mass,
    require_physical,
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Payload:
    """A rigid body fixed to a frame (as a robot's load: its flange frame).

    Two payloads in the same frame compose with ``+``. Arrays are stored as read-only copies.

    Attributes:
        mass_kg: Mass in kg; zero only for no body at all.
        com_m: Centre of mass in the frame, shape (3,), m.
        inertia_kg_m2: Inertia about the centre of mass in the frame's axes, shape (3, 3), kg m^2.

    Raises:
        InputError: Wrong shape, not finite, or an inertia that is not symmetric.
        InertiaError: Numbers no rigid body can have.
    """

    mass_kg: float
    com_m: NDArray[np.float64]
    inertia_kg_m2: NDArray[np.float64]

    def __post_init__(self) -> None:
        mass = float(finite_array(self.mass_kg, (), "payload mass_kg"))
        inertia = finite_array(self.inertia_kg_m2, (3, 3), "payload inertia_kg_m2")
        if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=1e-12):
            raise InputError(f"payload inertia_kg_m2 is not symmetric: {inertia.tolist()}")
        object.__setattr__(self, "mass_kg", mass)
        object.__setattr__(self, "com_m", finite_array(self.com_m, (3,), "payload com_m"))
        object.__setattr__(self, "inertia_kg_m2", read_only(0.5 * (inertia + inertia.T)))
        require_physical(self.parameters, "payload")

    @classmethod
    def from_parameters(cls, parameters: ArrayLike) -> Self:
        """Build a payload from its ten parameters.

        Args:
            parameters: (m, m c, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz) with the inertia about the
                frame origin, shape (10,), kg, kg m, kg m^2.

        Raises:
            InputError: Wrong shape or not finite.
            InertiaError: Numbers no rigid body can have.
        """
        phi = finite_array(parameters, (10,), "payload parameters")
        require_mass(phi, "payload")
        if phi[0] == 0.0:
            return cls(mass_kg=0.0, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
        return cls(mass_kg=phi[0], com_m=phi[1:4] / phi[0], inertia_kg_m2=inertia_about_com(phi))

    @property
    def parameters(self) -> NDArray[np.float64]:
        """Ten parameters in Pinocchio's order, inertia about the frame origin, shape (10,)."""
        return parameters_about_com(self.mass_kg, self.com_m, self.inertia_kg_m2)

    @property
    def spatial_inertia(self) -> pin.Inertia:
        """The payload as a Pinocchio inertia in the same frame."""
        return pin.Inertia(self.mass_kg, self.com_m.copy(), self.inertia_kg_m2.copy())

    def moved(self, rotation: ArrayLike, translation_m: ArrayLike) -> "Payload":
        """Describe the same body in another frame.

        Args:
            rotation: Rotation from this frame's axes to the new frame's, shape (3, 3).
            translation_m: Origin of this frame in the new one, shape (3,), m.

        Raises:
            InputError: Wrong shape, not finite, or a matrix that is not a rotation.
        """
        turn = finite_array(rotation, (3, 3), "rotation")
        shift = finite_array(translation_m, (3,), "translation_m")
        if not np.allclose(turn @ turn.T, np.eye(3), atol=1e-9) or np.linalg.det(turn) < 0.0:
            raise InputError(f"rotation is not a rotation matrix: {turn.tolist()}")
        return Payload.from_parameters(moved_parameters(self.parameters, turn, shift))

    def __add__(self, other: "Payload") -> "Payload":
        """Join two bodies given in the same frame into one."""
        if not isinstance(other, Payload):
            return NotImplemented
        return Payload.from_parameters(self.parameters + other.parameters)
