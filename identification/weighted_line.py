"""A line through weighted points, in closed form: three sums need no matrices."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Line(NamedTuple):
    """Level at zero offset and slope, with their covariance.

    Attributes:
        level: Value at zero.
        slope: Growth per offset.
        level_var: Variance of the level.
        both: Covariance of the two.
        slope_var: Variance of the slope.
    """

    level: float
    slope: float
    level_var: float
    both: float
    slope_var: float


def fit_line(
    offset: NDArray[np.float64], value: NDArray[np.float64], weight: NDArray[np.float64]
) -> Line:
    """Weighted least squares.

    Args:
        offset: Shape (n,), at least two different ones.
        value: Shape (n,).
        weight: Inverse variances, shape (n,).
    """
    leaning = weight * offset
    s, x, y = float(weight.sum()), float(leaning.sum()), float(weight @ value)
    xx, xy = float(leaning @ offset), float(leaning @ value)
    determinant = s * xx - x * x
    return Line(
        level=(xx * y - x * xy) / determinant,
        slope=(s * xy - x * y) / determinant,
        level_var=xx / determinant,
        both=-x / determinant,
        slope_var=s / determinant,
    )
