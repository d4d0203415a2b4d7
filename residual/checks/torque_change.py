"""How unusual a change of the joint torques is beside any force at the tip.

A change is compared with the covariance of the changes before it. A force at the tip
has its share: it is one more cause, of a given size.
"""

from typing import Any

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import (
    dot,
    multiply,
    multiply_transposed,
    multiply_vector,
)

invert: Any = np.linalg.inv
"""The inverse, whose annotations do not say that it keeps the type of numbers."""

USUAL_S = 8.0
"""Time constant of the covariance of usual changes."""

ANY_FORCE_N = 1e4
"""Deviation of a force at the tip of which nothing is known."""


@compiled_inside
def invert_beside_force(rows: Matrix, covariance: Matrix, force_N: float) -> Array:
    """Return the inverse covariance of torque that a force at the tip adds to.

    Args:
        rows: Torque per unit of each unknown of the force, shape (k, n).
        covariance: Without the force [Nm^2], shape (n, n).
        force_N: Deviation of the force.
    """
    # Both are symmetric; turned, what LAPACK returns is contiguous in rows.
    precision = invert(covariance).T
    weighted = multiply(rows, precision)
    information = multiply_transposed(weighted, rows)
    for i in range(len(rows)):
        information[i, i] += 1.0 / force_N**2
    share = multiply(invert(information).T, weighted)
    joints = len(covariance)
    for i in range(joints):
        for j in range(joints):
            for k in range(len(rows)):
                precision[i, j] -= weighted[k, i] * share[k, j]
    return precision


@compiled
def change_covariance(
    rows: Matrix, change: Vector, usual: Matrix, least_Nm: float
) -> Array:
    """Return the covariance of a change of torque without a force, shape (n, n).

    Args:
        rows: Torque per unit of each unknown of a force, shape (k, n), k < n.
        change: Change of joint torque [Nm], shape (n,).
        usual: Mean product of usual changes, a force left out [Nm^2], shape (n, n).
        least_Nm: Deviation that a change of a joint has at least.
    """
    # The mean product is learnt from few samples: it is shrunk towards its diagonal.
    diagonal_weight = 0.2
    # Lever arms are known within 2 % of the largest torque that a force explains.
    lever_error = 0.02
    joints = len(change)
    covariance = np.zeros((joints, joints))
    for i in range(joints):
        for j in range(joints):
            covariance[i, j] = (1.0 - diagonal_weight) * usual[i, j]
        covariance[i, i] += diagonal_weight * usual[i, i] + least_Nm**2
    precision = invert_beside_force(rows, covariance, ANY_FORCE_N)
    remaining = multiply_vector(covariance, multiply_vector(precision, change))
    largest_Nm = 0.0
    for i in range(joints):
        largest_Nm = max(largest_Nm, abs(change[i] - remaining[i]))
    for i in range(joints):
        covariance[i, i] += (lever_error * largest_Nm) ** 2
    return covariance


@compiled
def unusual_change(rows: Matrix, change: Vector, usual: Matrix) -> float:
    """Return the mean square of a change that no force explains.

    It is in units of the usual one, about 1 for a usual change; 0 for as many unknowns
    of the force as joints. Arguments are those of `change_covariance`.
    """
    free = len(change) - len(rows)
    if free <= 0:
        return 0.0
    least_Nm = 3e-4  # Hysteresis of a joint's sensor.
    covariance = change_covariance(rows, change, usual, least_Nm)
    precision = invert_beside_force(rows, covariance, ANY_FORCE_N)
    return dot(change, multiply_vector(precision, change)) / free
