"""The second link table of the LWR 4+: the end point of the plant's model mismatch.

The estimator believes the nominal table of the ``urdf`` room, a fit to KUKA's own interface data.
The simulated arm may blend that table with this one, so that no estimator is judged on an arm that
obeys its own numbers.
"""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from groundtruth.errors import ArmLevelError

# Read in two public LWR 4 simulators (a course work of Sapienza, models of the KUKA_LWR MATLAB
# simulator); believed to stem from CoppeliaSim's LBR4p. Joint frames, inertia about the com.
#  mass kg, com x, y, z m,            Ixx,      Ixy,   Ixz,   Iyy,      Iyz,       Izz  kg m^2
_CAD_TABLE = (
    (2.7, 0.00134, 0.02622, 0.11222, 0.016341, 1e-6, 3e-6, 0.016172, -0.003533, 0.005026),
    (2.7, 0.00134, -0.02622, 0.08778, 0.016341, -1e-6, 3e-6, 0.016172, 0.003533, 0.005026),
    (2.7, -0.00134, -0.02622, 0.11222, 0.016341, -1e-6, 3e-6, 0.016192, 0.003533, 0.005026),
    (2.7, -0.00134, 0.02622, 0.08778, 0.016341, -1e-6, -3e-6, 0.016192, -0.003533, 0.005026),
    (1.7, -0.00099, 0.02696, 0.07835, 0.009573, -1e-6, -1e-6, 0.008807, -0.003094, 0.003708),
    (1.6, -0.00026, -0.00596, -0.00533, 0.002898, 0.0, 0.0, 0.003022, -1.9e-5, 0.003413),
    (0.3, 0.0, 0.0, -0.015, 0.000101, 0.0, 0.0, 0.000101, 0.0, 0.000158),
)


def cad_link_parameters() -> NDArray[np.float64]:
    """Inertial parameters of the CAD link table.

    Returns:
        Shape (7, 10): per link (m, m c, Ixx, Ixy, Iyy, Ixz, Iyz, Izz) in the link's joint frame,
        inertia about the joint's origin (Pinocchio's order).
    """
    rows = []
    for mass, cx, cy, cz, ixx, ixy, ixz, iyy, iyz, izz in _CAD_TABLE:
        about_com = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
        link = pin.Inertia(mass, np.array([cx, cy, cz]), about_com)
        rows.append(link.toDynamicParameters())
    return np.array(rows)


def blend_link_parameters(
    nominal: NDArray[np.float64], cad: NDArray[np.float64], cad_share: float
) -> NDArray[np.float64]:
    """Blend two link tables: phi = (1 - a) phi_nominal + a phi_CAD.

    Physically consistent 10-vectors form a convex set: a blend of two consistent links is one.

    Args:
        nominal: Shape (n, 10), the estimator's links.
        cad: Shape (n, 10), the other table, same frames.
        cad_share: a in [0, 1].

    Returns:
        Shape (n, 10).

    Raises:
        ArmLevelError: The share lies outside [0, 1] or the tables differ in shape.
    """
    if not 0.0 <= cad_share <= 1.0:
        raise ArmLevelError(f"share of the CAD table is {cad_share}; expected a number in [0, 1]")
    if nominal.shape != cad.shape:
        raise ArmLevelError(
            f"link tables have shapes {nominal.shape} and {cad.shape}; "
            "expected the same number of links in both"
        )
    return (1.0 - cad_share) * nominal + cad_share * cad
