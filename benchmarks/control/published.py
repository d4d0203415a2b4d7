"""The published recursion of task priority, to compare with: Ferro et al., Section V.B.

It has the damped inverses of the authors' code and knows no limits. A projector made of
damped inverses is none, so near singular postures lower tasks undo higher ones.
"""

import numpy as np

from foundation.arrays import Array
from needleforce.control.errors import ControlError
from needleforce.control.priority_solver import Stack


def solve_published(stack: Stack) -> tuple[Array, bool]:
    """Return joint velocities, and False, see `needleforce.control.priority_solver`.

    dq_k = dq_{k-1} + (J_k P_{k-1})^# (v_k - J_k dq_{k-1})
    P_k = P_{k-1} - (J_k P_{k-1})^# J_k P

    The authors' code adds 0.5 to the diagonal of A A^T where its determinant is below
    1e-10.
    """
    joint_velocity = stack.joint_velocity
    velocity = np.zeros_like(joint_velocity)
    projector = np.eye(joint_velocity.size)
    for rows, rates in stack.levels:
        free = rows @ projector
        square = free @ free.T
        if np.linalg.det(square) <= 1e-10:
            square = square + 0.5 * np.eye(len(square))
        inverse = free.T @ np.linalg.inv(square)
        velocity = velocity + inverse @ (rates - rows @ velocity)
        projector = projector - inverse @ free
    velocity = velocity + projector @ (joint_velocity - velocity)
    if not np.isfinite(velocity).all():
        raise ControlError("positions or goals are not finite")
    return velocity, False
