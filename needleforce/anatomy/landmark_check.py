"""Each landmark against the others: leave-one-out residuals, other orders, mirror.

The residual of a landmark in a fit without it is not pulled towards itself. With n - 1
others of standard deviation s, its covariance is s^2 (I + J (J'J)^-1 J'), J the
displacement per rotation and shift, so its size follows chi squared with three degrees
of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc

from foundation.arrays import Array
from needleforce.anatomy.registration import (
    MIN_WIDTH_m,
    displacement_jacobian,
    fit_rigidly,
    rms_extents_m,
)

MIN_VERIFIED = 5
"""With fewer landmarks the others do not say which of them is off."""

DOUBTFUL = 0.01
"""A landmark whose residual would be exceeded less often is named."""


EQUAL_FIT = 10.0
"""Difference of the squares over the variance, in favour of the stated order, below
which another order fits as well: the stated one is less than 150 times as likely."""


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


class _LeftOut(NamedTuple):
    """A landmark in the fit of the others.

    Attributes:
        distance_m: From where they put it.
        probability: Of so large a distance or a larger one.
    """

    distance_m: float
    probability: float


def judge_landmarks(
    model_m: ArrayLike,
    robot_m: ArrayLike,
    std_m: float,
    names: Sequence[str] = (),
) -> list[LandmarkResidual]:
    """Return the residual of each landmark, also in the fit of the others.

    Args:
        model_m: Landmarks in the CT, (n, 3).
        robot_m: The same in the robot's base.
        std_m: Standard deviation of a landmark along each axis.
        names: Of the landmarks; by default their numbers from 1.
    """
    model = np.asarray(model_m, dtype=float)
    robot = np.asarray(robot_m, dtype=float)
    fit = fit_rigidly(model, robot)
    moved_m = model @ fit.rotation.T + fit.translation_m
    left_m = np.linalg.norm(moved_m - robot, axis=1).tolist()
    chosen = names or tuple(str(number) for number in range(1, len(model) + 1))
    residuals: list[LandmarkResidual] = []
    for number, name in enumerate(chosen):
        left_out = _leave_out(model, robot, number, std_m)
        residuals.append(LandmarkResidual(name, left_m[number], *left_out))
    return residuals


def _leave_out(model: Array, robot: Array, number: int, std_m: float) -> _LeftOut:
    """Return distance and probability of a landmark in the fit of the others."""
    is_other = np.arange(len(model)) != number
    others = model[is_other]
    if len(others) < 3 or rms_extents_m(others)[1] < MIN_WIDTH_m:
        return _LeftOut(np.nan, np.nan)
    fit = fit_rigidly(others, robot[is_other])
    moved_m = model @ fit.rotation.T + fit.translation_m
    error_m = moved_m[number] - robot[number]
    distance_m = float(np.linalg.norm(error_m))
    if len(model) < MIN_VERIFIED:
        return _LeftOut(distance_m, np.nan)
    pivot_m = moved_m[is_other].mean(axis=0)
    rows = displacement_jacobian(moved_m[is_other] - pivot_m).reshape(-1, 6)
    jacobian = displacement_jacobian(moved_m[number] - pivot_m)
    factor = np.eye(3) + jacobian @ np.linalg.solve(rows.T @ rows, jacobian.T)
    squares = error_m @ np.linalg.solve(factor, error_m) / std_m**2
    return _LeftOut(distance_m, float(chdtrc(3, squares)))


def find_equal_order(
    model: Array, robot: Array, std_m: float
) -> tuple[int, ...] | None:
    """Return another order of the touched landmarks that fits as well; None for none.

    Args:
        model: Landmarks in the CT, (n, 3).
        robot: The same in the robot's base.
        std_m: Standard deviation of a landmark along each axis.
    """
    # `EQUAL_FIT` of three landmarks, of which two sides are often nearly equal.
    equal_fit_of_three = 2.0
    equal_fit = EQUAL_FIT if len(model) > 3 else equal_fit_of_three
    max_squares_m2 = fit_rigidly(model, robot).squares_m2 + equal_fit * std_m**2
    return find_order(model, robot, std_m, max_squares_m2)


def find_order(
    model: Array, robot: Array, std_m: float, max_squares_m2: float
) -> tuple[int, ...] | None:
    """Return another order of the touched landmarks that fits; None for none.

    Args:
        model: Landmarks in the CT, (n, 3).
        robot: The same in the robot's base.
        std_m: Standard deviation of a landmark along each axis.
        max_squares_m2: Largest sum of the squares that it may leave.
    """
    # Distances between landmarks that differ by so many standard deviations rule an
    # order out before it is fitted.
    max_gap_std = 8.0
    # Of more landmarks not all orders are tried: pairs are, see `landmarks`.
    max_ordered = 7
    if len(model) > max_ordered:
        return None
    model_gaps_m = _gaps_m(model)
    robot_gaps_m = _gaps_m(robot)
    max_gap_m = max_gap_std * std_m
    # Without the first one, which is the stated order.
    orders = np.array(list(permutations(range(len(model)))))[1:]
    gaps_m = robot_gaps_m[orders[:, :, None], orders[:, None, :]]
    is_possible = np.abs(gaps_m - model_gaps_m).max(axis=(1, 2)) <= max_gap_m
    for order in orders[is_possible]:
        if fit_rigidly(model, robot[order]).squares_m2 <= max_squares_m2:
            return tuple(order.tolist())
    return None


def _gaps_m(points_m: Array) -> Array:
    """Return the distances between all points, (n, n)."""
    return np.linalg.norm(points_m[:, None] - points_m[None], axis=-1)
