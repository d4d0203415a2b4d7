"""Rigid registration by landmarks.

Residuals at the landmarks do not say how large the error at the target is (Fitzpatrick
2009); they serve to estimate the touches' deviation, and to refuse.
"""

from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, chdtri

from foundation.arrays import Array
from needleforce.anatomy.errors import (
    TOUCH_LANDMARKS,
    RegistrationError,
    require_deviation,
)
from needleforce.anatomy.landmark_check import find_equal_order, find_order
from needleforce.anatomy.registration import (
    MAX_LENGTH_RATIO,
    MIN_WIDTH_m,
    Registration,
    displacement_jacobian,
    fit_rigidly,
    rms_extents_m,
    rms_length,
)


class _Landmarks(NamedTuple):
    """The same points in both frames, shape (n, 3) each.

    Attributes:
        model_m: In the CT.
        robot_m: In the robot's base.
    """

    model_m: Array
    robot_m: Array

    def fit(self, std_m: float) -> bool:
        """Return whether they fit with a standard deviation along each axis."""
        return bool(fit_rigidly(*self).squares_m2 <= self.max_squares_m2(std_m))

    def max_squares_m2(self, std_m: float) -> float:
        """Return the largest sum of squares that good landmarks leave."""
        # Probability that good landmarks do not fit: no refusal is wrong in a life.
        false_refusal = 1e-6
        degrees = 3 * len(self.model_m) - 6
        return float(std_m**2 * chdtri(degrees, false_refusal))


class _Noise(NamedTuple):
    """How far landmarks are off.

    Attributes:
        variance_m2: Along each axis; nan where nothing can be said.
        degrees: Of freedom behind it.
    """

    variance_m2: float
    degrees: float


class _Explanation(NamedTuple):
    """What may be wrong with landmarks.

    Attributes:
        cause: In words, and what would help.
        corrected: The landmarks without it.
    """

    cause: str
    corrected: _Landmarks


def fit_landmarks(
    model_m: ArrayLike,
    robot_m: ArrayLike,
    *,
    std_m: float = 1e-3,
    is_std_known: bool = False,
) -> Registration:
    """Register by landmarks.

    Args:
        model_m: Landmarks in the CT [m], LPS, shape (n, 3).
        robot_m: The same, in the same order, touched with the robot's pointer [m], base
            axes.
        std_m: Standard deviation of a touch along each axis, localisation in the CT
            included: what does not fit with several times as much is refused.
        is_std_known: It decides the covariance of three landmarks, which leave next to
            no residuals and else claim nothing; of more it counts as half a residual,
            so that one landmark that is off widens the covariance.

    Raises:
        RegistrationError: Too few, collinear, mirrored or swapped landmarks,
            millimetres for metres, a deviation that is none, one landmark elsewhere,
            landmarks that fit as well in another order.
            Three landmarks cannot show a mirror image.
    """
    require_deviation("std_m", std_m, RegistrationError)
    landmarks = _checked_landmarks(model_m, robot_m)
    fit = fit_rigidly(*landmarks)
    count = len(landmarks.model_m)
    residual_rms_m = float(np.sqrt(fit.squares_m2 / count))
    if not landmarks.fit(std_m):
        raise RegistrationError(
            _find_cause(landmarks, std_m, residual_rms_m),
            "Check the order and the place of the landmarks, touch them "
            "again, or give the `std_m` of a touch.",
        )
    _require_one_order(landmarks, std_m)
    noise = _estimate_noise(fit.squares_m2, count, std_m, is_std_known=is_std_known)
    moved_m = landmarks.model_m @ fit.rotation.T + fit.translation_m
    pivot_m = moved_m.mean(axis=0)
    rows = displacement_jacobian(moved_m - pivot_m).reshape(-1, 6)
    covariance = noise.variance_m2 * np.linalg.inv(rows.T @ rows)
    return Registration(
        rotation=fit.rotation,
        translation_m=fit.translation_m,
        covariance=np.asarray(covariance, dtype=float),
        pivot_m=pivot_m,
        degrees=noise.degrees,
        residual_rms_m=residual_rms_m,
    )


def _estimate_noise(
    squares_m2: float, count: int, std_m: float, *, is_std_known: bool
) -> _Noise:
    """Return how far landmarks are off, by the residuals.

    Where these are larger than good landmarks leave, one landmark is taken to be off:
    its three coordinates decide, so the region grows as Student's law with three
    degrees of freedom does.

    Args:
        squares_m2: Sum of the squared residuals.
        count: Landmarks.
        std_m: Stated deviation along each axis.
        is_std_known: It counts, too.
    """
    degrees_of_one = 3.0  # degrees of freedom of one landmark that is off
    # Residuals that good landmarks exceed more seldom are taken for those of one
    # landmark that is off.
    doubtful_fit = 0.05
    # Residuals for which a known deviation counts: all but those of the landmarks, or
    # one of them that is off would leave the stated error as it is.
    stated_degrees = 0.5
    degrees = 3.0 * count - 6.0
    if count == 3 and not is_std_known:
        return _Noise(np.nan, degrees)
    if chdtrc(degrees, squares_m2 / std_m**2) < doubtful_fit:
        return _Noise(squares_m2 / degrees, degrees_of_one)
    if count == 3:
        return _Noise(std_m**2, np.inf)
    stated = stated_degrees if is_std_known else 0.0
    variance_m2 = (squares_m2 + stated * std_m**2) / (degrees + stated)
    return _Noise(variance_m2, degrees + stated)


def _require_one_order(landmarks: _Landmarks, std_m: float) -> None:
    """Refuse landmarks that fit as well in another order."""
    order = find_equal_order(landmarks.model_m, landmarks.robot_m, std_m)
    if order is not None:
        numbers = ", ".join(str(number + 1) for number in order)
        raise RegistrationError(
            f"the landmarks fit as well in another order ({numbers}): they lie "
            "symmetrically; touch one more, off the symmetry",
            TOUCH_LANDMARKS,
        )


def _checked_landmarks(model_m: ArrayLike, robot_m: ArrayLike) -> _Landmarks:
    """Return landmarks that could register."""
    # Keeps the ratio of extents finite where all landmarks are at one place.
    min_extent_m = 1e-12
    model = np.asarray(model_m, dtype=float)
    robot = np.asarray(robot_m, dtype=float)
    if model.ndim != 2 or model.shape[1:] != (3,) or model.shape != robot.shape:
        shapes = f"{model.shape} and {robot.shape}"
        raise RegistrationError(f"landmarks of shapes {shapes}: expected (n, 3) twice")
    if len(model) < 3:
        raise RegistrationError(
            f"too few landmarks: {len(model)}, expected three or more"
        )
    if not np.isfinite([model, robot]).all():
        raise RegistrationError("a landmark is not finite")
    model_length_m, model_width_m, _ = rms_extents_m(model)
    robot_length_m, robot_width_m, _ = rms_extents_m(robot)
    ratio = robot_length_m / max(model_length_m, min_extent_m)
    if not 1.0 / MAX_LENGTH_RATIO < ratio < MAX_LENGTH_RATIO:
        raise RegistrationError(
            f"the touched landmarks are {ratio:.3g} times as far apart as those of the "
            "model: millimetres for metres?"
        )
    if min(model_width_m, robot_width_m) < MIN_WIDTH_m:
        raise RegistrationError(
            "the landmarks are collinear: the model could turn about their line"
        )
    return _Landmarks(model, robot)


def _find_cause(landmarks: _Landmarks, std_m: float, residual_rms_m: float) -> str:
    """Return why landmarks do not fit: the first explanation without which they do."""
    for cause, corrected in _explanations(landmarks):
        if corrected.fit(std_m):
            return cause
    order = find_order(*landmarks, std_m, landmarks.max_squares_m2(std_m))
    if order is not None:
        numbers = ", ".join(str(number + 1) for number in order)
        return (
            f"the touched landmarks fit in the order {numbers}; touch them in the "
            "model's order"
        )
    return (
        f"the landmarks do not fit: {1e3 * residual_rms_m:.1f} mm rms are left with "
        f"{1e3 * std_m:g} mm per axis expected; are they the same points, in the same "
        "order?"
    )


def _explanations(landmarks: _Landmarks) -> Iterator[_Explanation]:
    """Yield what may be wrong: order, mirror, scale, one landmark, in this order.

    In another order the scale would take the blame.
    """
    model_m, robot_m = landmarks
    count = len(model_m)
    for i, j in combinations(range(count), 2):
        order = np.arange(count)
        order[[i, j]] = j, i
        yield _Explanation(
            f"landmarks {i + 1} and {j + 1} are swapped; touch them in the model's "
            "order",
            _Landmarks(model_m, robot_m[order]),
        )
    yield _Explanation(
        "the touched landmarks are the mirror image of the model's: left for right?",
        _Landmarks(-model_m, robot_m),
    )
    robot_size_m = rms_length(robot_m - robot_m.mean(axis=0))
    scale = robot_size_m / rms_length(model_m - model_m.mean(axis=0))
    yield _Explanation(
        f"the touched landmarks fit with a scale of {scale:.3f}: is the spacing right?",
        _Landmarks(scale * model_m, robot_m),
    )
    for k in range(count if count > 4 else 0):
        yield _Explanation(
            f"landmark {k + 1} lies elsewhere than in the model; touch it again",
            _Landmarks(np.delete(model_m, k, axis=0), np.delete(robot_m, k, axis=0)),
        )
