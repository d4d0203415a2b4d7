"""Inertial parameters of one rigid body as a vector of ten, and what makes them physical.

The ten numbers, in Pinocchio's order, are linear in every torque the body causes:

    phi = (m, m c_x, m c_y, m c_z, I_xx, I_xy, I_yy, I_xz, I_yz, I_zz),

with c the centre of mass and I the inertia about the frame origin. A body with non-negative density
exists for phi exactly when m >= 0, the inertia about the centre of mass is positive semidefinite,
and its principal moments obey the triangle inequality (Wensing, Kim, Slotine, "Linear matrix
inequalities for physically consistent inertial parameter identification", RA-L 2018).

In every function parameters have shape (10,), in kg, kg m and kg m^2.
"""

import numpy as np
import pinocchio as pin

from urdf.errors import Array, InertiaError

# Tables carry a few digits: a thin rod, once rounded, may miss the boundary by this fraction.
_ROUNDING = 1e-6
# Fraction of the inertia about the origin that subtracting m c^2 may lose in double precision.
_CANCELLATION = 1e-12
# Where the six moments stand in a matrix, in the order of the parameters.
_MOMENTS = ([0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2])
# No link or tool comes near this in kg, kg m or kg m^2, and no product of them overflows.
_LARGEST = 1e9


def parameters_about_com(mass_kg: float, com_m: Array, inertia_kg_m2: Array) -> Array:
    """Return the ten parameters of a body given by its inertia about the centre of mass."""
    # What overflows comes out as infinite, which `require_mass` refuses by name.
    with np.errstate(over="ignore", invalid="ignore"):
        steiner = mass_kg * (com_m @ com_m * np.eye(3) - np.outer(com_m, com_m))
        about_origin = inertia_kg_m2 + steiner
        return np.concatenate([[mass_kg], mass_kg * com_m, about_origin[_MOMENTS]])


def require_mass(parameters: Array, owner: str) -> None:
    """Raise `InertiaError`, naming the owner, for absurd numbers or moments without a mass."""
    if not np.all(np.abs(parameters) <= _LARGEST):
        raise InertiaError(
            f"{owner}: inertial parameters {parameters.tolist()} (mass, first moments, inertia) "
            f"are not finite or above {_LARGEST:g} in SI units; check the numbers and their units"
        )
    if parameters[0] == 0.0 and np.any(parameters):
        raise InertiaError(f"{owner}: mass is 0 kg but its moments are not; give it a mass")


def require_physical(parameters: Array, owner: str) -> None:
    """Raise `InertiaError` unless a body can have these, to the rounding of a written table."""
    require_mass(parameters, owner)
    mass = parameters[0]
    if mass < 0.0:
        raise InertiaError(f"{owner}: mass is {mass:g} kg, expected a positive mass")
    if mass == 0.0:
        return
    moments = np.linalg.eigvalsh(pin.Inertia.FromDynamicParameters(parameters).inertia)
    slack = _ROUNDING * moments[2] + _CANCELLATION * np.sum(parameters[[4, 6, 9]])
    shown = ", ".join(f"{moment:.6g}" for moment in moments)
    if moments[0] < -slack:
        raise InertiaError(
            f"{owner}: inertia about the centre of mass is not positive definite "
            f"(principal moments {shown} kg m^2); check signs and the frame it is expressed in"
        )
    if moments[0] + moments[1] < moments[2] - slack:
        raise InertiaError(
            f"{owner}: principal moments {shown} kg m^2 break the triangle inequality (the largest "
            f"exceeds the sum of the others by {moments[2] - moments[0] - moments[1]:.3g} kg m^2)"
        )
