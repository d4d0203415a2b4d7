"""Steps of a Kalman filter on the unknowns of one hypothesis, in place."""

import numpy as np

from foundation.arrays import Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import dot
from identification.mixture.force_model import UNKNOWNS


@compiled
def times(covariance: Matrix, row: Vector) -> Vector:
    """Return covariance @ row, for a symmetric covariance and a row with many zeros."""
    product = np.zeros(UNKNOWNS)
    for i in range(UNKNOWNS):
        if row[i] != 0.0:
            for j in range(UNKNOWNS):
                product[j] += row[i] * covariance[i, j]
    return product


@compiled
def update(
    mean: WrittenVector,
    covariance: WrittenMatrix,
    cross_covariance: Vector,
    innovation: float,
    variance: float,
) -> None:
    """Update the unknowns with a measurement.

    Args:
        mean: Of the unknowns, shape (20,).
        covariance: Theirs, shape (20, 20).
        cross_covariance: Of the unknowns with the measurement, shape (20,).
        innovation: Measurement less its prediction.
        variance: Of the innovation.
    """
    for i in range(UNKNOWNS):
        gain = cross_covariance[i] / variance
        mean[i] += gain * innovation
        for j in range(UNKNOWNS):
            covariance[i, j] -= gain * cross_covariance[j]


@compiled_inside
def update_to_zero(
    mean: WrittenVector, covariance: WrittenMatrix, row: Vector, variance: float
) -> None:
    """Update the unknowns with the knowledge that row @ unknowns is zero.

    Args:
        mean: Of the unknowns, shape (20,).
        covariance: Theirs, shape (20, 20).
        row: Shape (20,).
        variance: Of that knowledge.
    """
    cross_covariance = times(covariance, row)
    innovation = -dot(row, mean)
    total_variance = dot(row, cross_covariance) + variance
    update(mean, covariance, cross_covariance, innovation, total_variance)


@compiled_inside
def map_rows(transition: Matrix, matrix: Matrix) -> Matrix:
    """Return (transition @ matrix).T, for a transition with many zeros.

    Applied twice it maps a covariance: transition @ covariance @ transition.T.
    """
    product = np.zeros((UNKNOWNS, UNKNOWNS))
    for i in range(UNKNOWNS):
        for j in range(UNKNOWNS):
            if transition[i, j] != 0.0:
                for k in range(UNKNOWNS):
                    product[k, i] += transition[i, j] * matrix[j, k]
    return product
