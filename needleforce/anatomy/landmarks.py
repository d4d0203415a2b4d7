"""Rigid registration from landmarks, and how far off it is at any point.

The model (CT, LPS) is carried into the robot's base: y = R x + t. Least squares (Arun, Huang,
Blostein 1987); the covariance of the six parameters gives the target registration error at any
point, equal to Fitzpatrick's formula (1998) for isotropic errors. Residuals at the landmarks do not
say how large the error at the target is (Fitzpatrick 2009); they serve to estimate the touches'
deviation, and to refuse.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation
from scipy.stats import chi2
from scipy.stats import f as f_law

from needleforce.anatomy.errors import Array, RegistrationError, require_deviation

LEAST_WIDTH_m = 5e-3
"""Root mean square distance of landmarks from a line below which they count as collinear."""
LARGEST_SCALE = 5.0  # Beyond this, or its inverse, units differ
FALSE_REFUSAL = 1e-6  # Probability that good landmarks do not fit


@dataclass(frozen=True, eq=False)
class Registration:
    """Where the model lies in the robot's base, with its uncertainty.

    Attributes:
        rotation: R, shape (3, 3).
        translation_m: t, shape (3,).
        covariance: Of a small rotation [rad] about `pivot_m`, and a shift [m], in the robot's base,
            shape (6, 6); nan where nothing can be said.
        pivot_m: In the robot's base, shape (3,).
        degrees: Of freedom behind the covariance; infinite where the deviation was known.
        residual_rms_m: At the landmarks or touches; says nothing of the target.
    """

    rotation: Array
    translation_m: Array
    covariance: Array
    pivot_m: Array
    degrees: float
    residual_rms_m: float

    def to_robot(self, points_m: ArrayLike) -> Array:
        """Points of the model, shape (..., 3), in the robot's base."""
        return np.asarray(points_m, dtype=float) @ self.rotation.T + self.translation_m

    def to_model(self, points_m: ArrayLike) -> Array:
        """Points in the robot's base, shape (..., 3), in the model."""
        return (np.asarray(points_m, dtype=float) - self.translation_m) @ self.rotation

    def covariance_at(self, point_m: ArrayLike) -> Array:
        """Covariance of the error at a point of the model, in the robot's base, shape (3, 3)."""
        lever = point_jacobian(self.to_robot(point_m) - self.pivot_m)
        return lever @ self.covariance @ lever.T

    def tre_m(self, point_m: ArrayLike) -> float:
        """Root mean square error to be expected at a point of the model."""
        return float(np.sqrt(np.trace(self.covariance_at(point_m))))

    def std_along_m(self, axis: ArrayLike, point_m: ArrayLike) -> float:
        """Standard deviation at a point of the model along an axis in the robot's base."""
        unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
        return float(np.sqrt(unit @ self.covariance_at(point_m) @ unit))

    def region_contains(self, point_m: ArrayLike, truth_m: ArrayLike, level: float = 0.95) -> bool:
        """Whether a place in the robot's base lies in the region of that level about a point."""
        error = np.asarray(truth_m, dtype=float) - self.to_robot(point_m)
        distance = error @ np.linalg.solve(self.covariance_at(point_m), error)
        # Hotelling's T squared; with so many degrees chi squared.
        return bool(distance <= 3.0 * f_law.ppf(level, 3, min(self.degrees, 1e9)))


def point_jacobian(lever_m: Array) -> Array:
    """Displacement of points (..., 3) about a pivot by a small rotation and shift, (..., 3, 6)."""
    turned = np.cross(lever_m[..., None, :], np.eye(3))
    return np.concatenate((turned, np.broadcast_to(np.eye(3), turned.shape)), axis=-1)


def rms(vectors: Array) -> float:
    """Root mean square length of vectors (n, 3)."""
    return float(np.sqrt((vectors**2).sum(axis=-1).mean()))


def widths_m(points_m: Array) -> Array:
    """Root mean square extents of points (n, 3) about their mean, the largest first, (3,)."""
    return np.linalg.svd(points_m - points_m.mean(axis=0), compute_uv=False) / len(points_m) ** 0.5


def rigid_fit(model: Array, robot: Array) -> tuple[Array, Array, float]:
    """Rotation and shift with the least squares, and their sum."""
    one, two = model.mean(axis=0), robot.mean(axis=0)
    found = Rotation.align_vectors(robot - two, model - one)
    turn = found[0]
    return turn.as_matrix(), two - turn.apply(one), float(found[1]) ** 2


def fit_landmarks(
    model_m: ArrayLike, robot_m: ArrayLike, *, std_m: float = 1e-3, is_std_known: bool = False
) -> Registration:
    """Register by landmarks.

    Args:
        model_m: Landmarks in the CT [m], LPS, shape (n, 3).
        robot_m: The same, in the same order, touched with the robot's pointer [m], base axes.
        std_m: Standard deviation of a touch along each axis, localisation in the CT included: what
            does not fit with several times as much is refused.
        is_std_known: Believe it in the covariance too; else that is estimated from the residuals,
            and with three landmarks, which leave next to none, nothing is claimed.

    Raises:
        RegistrationError: Too few, collinear, mirrored or swapped landmarks, millimetres for
            metres, a deviation that is none, one landmark elsewhere. Three landmarks cannot show a
            mirror image.
    """
    require_deviation("std_m", std_m, RegistrationError)
    model, robot = _checked(model_m, robot_m)
    rotation, translation, squares = rigid_fit(model, robot)
    degrees, residual_m = 3 * len(model) - 6, float(np.sqrt(squares / len(model)))
    if not _fits(model, robot, std_m):
        causes = [why for why, *cured in _explanations(model, robot) if _fits(*cured, std_m)]
        unknown = (
            f"the landmarks do not fit: {1e3 * residual_m:.1f} mm rms are left with "
            f"{1e3 * std_m:g} mm per axis expected; are they the same points, in the same order?"
        )
        raise RegistrationError([*causes, unknown][0])
    moved = model @ rotation.T + translation
    pivot = moved.mean(axis=0)
    lever = point_jacobian(moved - pivot).reshape(-1, 6)
    variance = std_m**2 if is_std_known else squares / degrees if len(model) > 3 else np.nan
    return Registration(
        rotation=rotation,
        translation_m=translation,
        covariance=variance * np.linalg.inv(lever.T @ lever),
        pivot_m=pivot,
        degrees=np.inf if is_std_known else float(degrees),
        residual_rms_m=residual_m,
    )


def _checked(model_m: ArrayLike, robot_m: ArrayLike) -> tuple[Array, Array]:
    model, robot = (np.asarray(points, dtype=float) for points in (model_m, robot_m))
    if model.ndim != 2 or model.shape[1:] != (3,) or model.shape != robot.shape:
        raise RegistrationError(
            f"landmarks of shapes {model.shape} and {robot.shape}: expected (n, 3) twice"
        )
    if len(model) < 3:
        raise RegistrationError(f"too few landmarks: {len(model)}; touch three or more")
    if not np.isfinite([model, robot]).all():
        raise RegistrationError("a landmark is not finite; touch it again")
    widths = np.array([widths_m(model), widths_m(robot)])
    scale = widths[1, 0] / max(widths[0, 0], 1e-12)
    if not 1.0 / LARGEST_SCALE < scale < LARGEST_SCALE:
        raise RegistrationError(
            f"the touched landmarks are {scale:.3g} times as far apart as those of the model: "
            "millimetres for metres? Give both in metres"
        )
    if widths[:, 1].min() < LEAST_WIDTH_m:
        raise RegistrationError(
            "the landmarks are collinear: the model could turn about their line; touch one that "
            "lies aside"
        )
    return model, robot


def _fits(model: Array, robot: Array, std_m: float) -> bool:
    limit = std_m**2 * chi2.isf(FALSE_REFUSAL, 3 * len(model) - 6)
    return bool(rigid_fit(model, robot)[2] <= limit)


def _explanations(model: Array, robot: Array) -> Iterator[tuple[str, Array, Array]]:
    """What may be wrong, and the landmarks without it: order, mirror, scale, one, in this order."""
    count = len(model)
    for i, j in combinations(range(count), 2):
        order = np.arange(count)
        order[[i, j]] = j, i
        why = f"landmarks {i + 1} and {j + 1} are swapped; touch them in the model's order"
        yield why, model, robot[order]
    yield (
        "the touched landmarks are the mirror image of the model's: left for right?",
        -model,
        robot,
    )
    scale = rms(robot - robot.mean(axis=0)) / rms(model - model.mean(axis=0))
    why = f"the touched landmarks fit with a scale of {scale:.3f}: is the spacing right?"
    yield why, scale * model, robot
    for k in range(count if count > 4 else 0):
        why = f"landmark {k + 1} lies elsewhere than in the model; touch it again"
        yield why, np.delete(model, k, axis=0), np.delete(robot, k, axis=0)
