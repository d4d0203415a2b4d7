"""The rigid body nearest to a least-squares answer that is none."""

import numpy as np
from numpy.typing import NDArray

from urdf.pseudo_inertia import pseudo_inertia

# Weight of directions the data say nothing about, against the strongest: enough to settle them.
_PRIOR = 1e-6
# The barrier shrinks from a tenth of the cost's scale until it no longer matters.
_BARRIERS = np.logspace(-1, -14, 27)
_BASIS = np.array([pseudo_inertia(unit) for unit in np.eye(10)])


def nearest_body(
    solution: NDArray[np.float64], information_root: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the consistent parameters of least cost ``|R (phi - solution)|^2``.

    The consistent parameters are a convex cone, J(phi) positive semidefinite, so there is one
    answer. It is approached from inside by Newton's method with a barrier ``-mu log det J(phi)``
    whose weight shrinks; the cost ends within 4 mu of the least.

    Args:
        solution: Ten parameters in units in which they are of comparable size, shape (10,).
        information_root: R, shape (10, 10).
    """
    strongest = np.linalg.norm(information_root, 2)
    root = np.vstack([information_root / strongest, _PRIOR * np.eye(10)])
    hessian = root.T @ root
    size = max(float(np.linalg.norm(solution)), 1e-12)
    parameters = np.array([1.0, 0, 0, 0, 1, 0, 1, 0, 0, 1]) * size
    for barrier in _BARRIERS * size**2:
        parameters = _centre(parameters, solution, hessian, barrier)
    return parameters


def is_consistent(parameters: NDArray[np.float64]) -> bool:
    """Whether the pseudo-inertia is positive semidefinite, exactly: no allowance for rounding."""
    return bool(np.linalg.eigvalsh(pseudo_inertia(parameters))[0] >= 0.0)


def _centre(
    parameters: NDArray[np.float64],
    solution: NDArray[np.float64],
    hessian: NDArray[np.float64],
    barrier: float,
) -> NDArray[np.float64]:
    """Minimise half the cost plus the barrier, starting from inside the cone.

    The sum divided by ``barrier`` is self-concordant: a Newton step shortened by 1 / (1 + its
    decrement) never leaves the cone and always descends (Boyd and Vandenberghe, section 9.6).
    """
    for _ in range(100):
        scaled = np.linalg.solve(pseudo_inertia(parameters), _BASIS)
        slope = hessian @ (parameters - solution) / barrier - np.trace(scaled, axis1=1, axis2=2)
        curvature = hessian / barrier + np.einsum("aij,bji->ab", scaled, scaled)
        step = np.linalg.solve(curvature, slope)
        decrement = float(np.sqrt(max(slope @ step, 0.0)))
        parameters = parameters - step / (1.0 + decrement)
        if decrement < 1e-3:
            break
    return parameters
