"""Rigid registration by landmarks; each landmark against the others.

Residuals at the landmarks do not say how large the error at the target is (Fitzpatrick
2009); they serve to estimate the touches' deviation, and to refuse.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.distance import cdist
from scipy.special import chdtrc, chdtri

from foundation.arrays import Array
from needleforce.anatomy.errors import RegistrationError, require_deviation
from needleforce.anatomy.registration import (
    MAX_LENGTH_RATIO,
    MIN_WIDTH_m,
    Registration,
    displacement_jacobian,
    fit_rigidly,
    rms_extents_m,
)

MIN_VERIFIED = 5
"""With fewer landmarks the others do not say which of them is off."""

DOUBTFUL = 0.01
"""A landmark whose residual would be exceeded less often is named."""


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
    false_refusal = 1e-6  # probability that good landmarks do not fit
    require_deviation("std_m", std_m, RegistrationError)
    model = np.asarray(model_m, dtype=float)
    robot = np.asarray(robot_m, dtype=float)
    _require_landmarks(model, robot)
    fit = fit_rigidly(model, robot)
    moved_m = fit.carry(model)
    squares_m2 = float(((moved_m - robot) ** 2).sum())
    residual_rms_m = float(np.sqrt(squares_m2 / len(model)))
    degrees = 3.0 * len(model) - 6.0
    if squares_m2 > std_m**2 * chdtri(degrees, false_refusal):
        raise RegistrationError(
            f"the landmarks do not fit: {1e3 * residual_rms_m:.1f} mm rms are left, "
            f"with {1e3 * std_m:g} mm per axis expected: two are swapped, one lies "
            "elsewhere, or they are a mirror image or scaled"
        )
    _require_one_order(model, robot, std_m, squares_m2)
    # Residuals that good landmarks exceed more seldom are taken for those of one
    # landmark that is off: its three coordinates decide.
    is_off = chdtrc(degrees, squares_m2 / std_m**2) < 0.05
    # A known deviation counts as half a residual: as all but those of the landmarks,
    # or one of them that is off would leave the error as it is.
    stated = 0.0 if is_off else 0.5 * is_std_known
    variance_m2 = (squares_m2 + stated * std_m**2) / (degrees + stated)
    degrees = 3.0 if is_off else degrees + stated
    if len(model) == 3 and not (is_std_known and is_off):
        variance_m2 = std_m**2 if is_std_known else np.nan
        degrees = np.inf if is_std_known else 3.0
    pivot_m = moved_m.mean(axis=0)
    rows = displacement_jacobian(moved_m - pivot_m).reshape(-1, 6)
    return Registration(
        rotation=fit.rotation,
        translation_m=fit.translation_m,
        covariance=np.asarray(variance_m2 * np.linalg.inv(rows.T @ rows), dtype=float),
        pivot_m=pivot_m,
        degrees=degrees,
        residual_rms_m=residual_rms_m,
    )


def _require_landmarks(model: Array, robot: Array) -> None:
    """Refuse landmarks that could not register."""
    is_list = model.ndim == 2 and model.shape[1:] == (3,) and model.shape == robot.shape
    if not is_list or len(model) < 3 or not np.isfinite([model, robot]).all():
        raise RegistrationError(
            f"landmarks of shapes {model.shape} and {robot.shape}, too few or one not "
            "finite: expected (n, 3) twice, three or more"
        )
    extents_m = np.array([rms_extents_m(model), rms_extents_m(robot)])
    ratio = extents_m[1, 0] / max(extents_m[0, 0], 1e-12)
    is_narrow = extents_m[:, 1].min() < MIN_WIDTH_m
    if is_narrow or not 1.0 / MAX_LENGTH_RATIO < ratio < MAX_LENGTH_RATIO:
        raise RegistrationError(
            f"the touched landmarks are {ratio:.3g} times as far apart as those of the "
            "model (millimetres for metres?), or collinear: the model could turn about "
            "their line"
        )


def _require_one_order(
    model: Array, robot: Array, std_m: float, squares_m2: float
) -> None:
    """Refuse landmarks that fit as well in another order: they lie symmetrically."""
    # Of more landmarks not all orders are tried.
    max_ordered = 7
    # Distances between landmarks that differ by so many standard deviations rule an
    # order out before it is fitted.
    max_gap_std = 8.0
    # Difference of the squares over the variance below which another order fits as
    # well: the stated one is less than 150 times as likely. Of three landmarks two
    # sides are often nearly equal.
    equal_fit = 10.0 if len(model) > 3 else 2.0
    if len(model) > max_ordered:
        return
    # Without the first one, which is the stated order.
    orders = np.array(list(permutations(range(len(model)))))[1:]
    gaps_m = cdist(robot, robot)[orders[:, :, None], orders[:, None, :]]
    differences_m = np.abs(gaps_m - cdist(model, model)).max(axis=(1, 2))
    for order in orders[differences_m <= max_gap_std * std_m]:
        off_m = fit_rigidly(model, robot[order]).carry(model) - robot[order]
        if (off_m**2).sum() <= squares_m2 + equal_fit * std_m**2:
            raise RegistrationError(
                f"the landmarks fit as well in another order ({order + 1}): they lie "
                "symmetrically; touch one more, off the symmetry"
            )


@dataclass(frozen=True)
class LandmarkResidual:
    """How far a landmark lies from where the others put it.

    Attributes:
        name: Of the landmark.
        left_m: Distance that the fit of all landmarks leaves.
        left_out_m: Distance in the fit of the others; nan where they cannot register.
        probability: Of so large a distance or a larger one where nothing is wrong; nan
            where it cannot be judged.
    """

    name: str
    left_m: float
    left_out_m: float
    probability: float

    @property
    def is_doubtful(self) -> bool:
        """Whether the landmark is probably off."""
        return bool(self.probability < DOUBTFUL)


def judge_landmarks(
    model_m: ArrayLike,
    robot_m: ArrayLike,
    std_m: float,
    names: Sequence[str] = (),
) -> list[LandmarkResidual]:
    """Return the residual of each landmark, also in the fit of the others.

    That is not pulled towards the landmark itself. With n - 1 others of standard
    deviation s, its covariance is s^2 (I + J (J'J)^-1 J'), J the displacement per
    rotation and shift, so its size follows chi squared with three degrees of freedom.

    Args:
        model_m: Landmarks in the CT, (n, 3).
        robot_m: The same in the robot's base.
        std_m: Standard deviation of a landmark along each axis.
        names: Of the landmarks; by default their numbers from 1.
    """
    model = np.asarray(model_m, dtype=float)
    robot = np.asarray(robot_m, dtype=float)
    left_m = fit_rigidly(model, robot).carry(model) - robot
    residuals: list[LandmarkResidual] = []
    for number, name in enumerate(names or map(str, range(1, len(model) + 1))):
        others = np.delete(np.arange(len(model)), number)
        distance_m = probability = np.nan
        if len(model) > 3 and rms_extents_m(model[others])[1] >= MIN_WIDTH_m:
            moved_m = fit_rigidly(model[others], robot[others]).carry(model)
            error_m = moved_m[number] - robot[number]
            distance_m = float(np.linalg.norm(error_m))
            jacobian = displacement_jacobian(moved_m - moved_m[others].mean(axis=0))
            rows = jacobian[others].reshape(-1, 6)
            inner = np.linalg.solve(rows.T @ rows, jacobian[number].T)
            factor = np.eye(3) + jacobian[number] @ inner
            squares = error_m @ np.linalg.solve(factor, error_m) / std_m**2
            if len(model) >= MIN_VERIFIED:
                probability = float(chdtrc(3, squares))
        left = float(np.linalg.norm(left_m[number]))
        residuals.append(LandmarkResidual(name, left, distance_m, probability))
    return residuals
