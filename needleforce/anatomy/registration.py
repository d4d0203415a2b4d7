"""Where the model lies in the robot's base, and how far off that is at any point.

The model (CT, LPS) is carried into the robot's base: y = R x + t. The covariance of
the six parameters of a registration gives the target registration error at any point,
equal to Fitzpatrick's formula (1998) for isotropic errors. `landmarks` and
`surface_fit` find registrations.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.special import fdtri

from foundation.arrays import Array

MIN_WIDTH_m = 5e-3
"""Root mean square distance of points from a line below which they count as
collinear."""

MAX_LENGTH_RATIO = 5.0
"""Ratio of lengths in model and robot beyond which their units differ."""


MAX_DEGREES = 1e9
"""With so many degrees of freedom the F law is that of chi squared."""


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the model lies in the robot's base, with its uncertainty.

    The covariance is that of a small rotation [rad] about the pivot, and a shift [m],
    in the robot's base; nan where nothing can be said.

    Attributes:
        rotation: R, (3, 3).
        translation_m: t, (3,).
        covariance: Of rotation and shift, (6, 6).
        pivot_m: In the robot's base, (3,).
        degrees: Of freedom behind the covariance; infinite where the deviation was
            known.
        residual_rms_m: At the landmarks or touches; says nothing of the target.
        indentation_m: By so much touches pressed the surface in, on average.
        indentation_std_m: Its standard deviation.
    """

    rotation: Array
    translation_m: Array
    covariance: Array
    pivot_m: Array
    degrees: float
    residual_rms_m: float
    indentation_m: float = 0.0
    indentation_std_m: float = 0.0

    def to_robot(self, points_m: ArrayLike) -> Array:
        """Carry points of the model, shape (..., 3), into the robot's base."""
        return np.asarray(points_m, dtype=float) @ self.rotation.T + self.translation_m

    def to_model(self, points_m: ArrayLike) -> Array:
        """Carry points in the robot's base, shape (..., 3), into the model."""
        return (np.asarray(points_m, dtype=float) - self.translation_m) @ self.rotation

    def covariance_at(self, point_m: ArrayLike) -> Array:
        """Return covariances of the error at points (..., 3) of the model, (..., 3, 3).

        Their axes are those of the robot's base.
        """
        jacobian = displacement_jacobian(self.to_robot(point_m) - self.pivot_m)
        return jacobian @ self.covariance @ np.swapaxes(jacobian, -1, -2)

    def tre_m(self, point_m: ArrayLike) -> float:
        """Return the root mean square error to be expected at a point of the model."""
        return float(np.sqrt(np.trace(self.covariance_at(point_m))))

    def std_along_m(self, axis: ArrayLike, point_m: ArrayLike) -> float:
        """Return the standard deviation of a point of the model along an axis.

        Args:
            axis: In the robot's base, of any length, shape (3,).
            point_m: Of the model, shape (3,).
        """
        unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        return float(np.sqrt(unit @ self.covariance_at(point_m) @ unit))

    def largest_std_m(self, points_m: ArrayLike) -> float:
        """Return the largest standard deviation in any direction at points.

        Between two points on a straight path it is no larger than at both.

        Args:
            points_m: Of the model, shape (n, 3).
        """
        variances_m2 = np.linalg.eigvalsh(self.covariance_at(points_m))
        return float(np.sqrt(variances_m2.max()))

    def region_contains(
        self, point_m: ArrayLike, truth_m: ArrayLike, level: float = 0.95
    ) -> bool:
        """Return whether a place lies in the region of a level about a point.

        Args:
            point_m: Of the model, shape (3,).
            truth_m: The place, in the robot's base, shape (3,).
            level: Probability that the point lies in the region.
        """
        min_variance_m2 = 1e-18  # a nanometre, squared, of a fit without any error
        error_m = np.asarray(truth_m, dtype=float) - self.to_robot(point_m)
        covariance = self.covariance_at(point_m) + min_variance_m2 * np.eye(3)
        hotelling_t2 = error_m @ np.linalg.solve(covariance, error_m)
        quantile = 3.0 * fdtri(3, min(self.degrees, MAX_DEGREES), level)
        return bool(hotelling_t2 <= quantile)


class RigidTransform(NamedTuple):
    """A motion: y = R x + t.

    Attributes:
        rotation: R, from the model to the robot's base, (3, 3).
        translation_m: t, (3,).
    """

    rotation: Array
    translation_m: Array

    def carry(self, points_m: Array) -> Array:
        """Return points (n, 3) of the model where the motion carries them."""
        return points_m @ self.rotation.T + self.translation_m


def fit_rigidly(model_m: Array, robot_m: Array) -> RigidTransform:
    """Fit a rotation and a shift to points in both frames, shape (n, 3) each.

    Least squares (Arun, Huang, Blostein 1987).
    """
    model_mean_m = model_m.mean(axis=0)
    robot_mean_m = robot_m.mean(axis=0)
    fit = Rotation.align_vectors(robot_m - robot_mean_m, model_m - model_mean_m)[0]
    return RigidTransform(fit.as_matrix(), robot_mean_m - fit.apply(model_mean_m))


def displacement_jacobian(lever_m: Array) -> Array:
    """Return the displacement of points per small rotation and shift, (..., 3, 6).

    Args:
        lever_m: From the pivot to the points, shape (..., 3).
    """
    turned = np.cross(np.eye(3), lever_m[..., None, :])  # about each axis, in rows
    shifted = np.broadcast_to(np.eye(3), turned.shape)
    return np.concatenate([np.swapaxes(turned, -1, -2), shifted], axis=-1)


def rms_length(vectors: Array) -> float:
    """Return the root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


def rms_extents_m(points_m: Array) -> Array:
    """Return the root mean square extents of points about their mean, shape (3,).

    Along their principal axes, the largest first; points have shape (n, 3).
    """
    centred_m = points_m - points_m.mean(axis=0)
    return np.linalg.svd(centred_m, compute_uv=False) / len(points_m) ** 0.5
