"""A line in closed form is the one that matrices give."""

import numpy as np
import pytest

from identification.published_identifier import fit_line


def test_level_slope_and_covariance_are_those_of_weighted_least_squares():
    rng = np.random.default_rng(5)
    offset, weight = rng.uniform(-1.0, 2.0, 40), rng.uniform(1.0, 9.0, 40)
    value = 0.7 - 0.2 * offset + 0.1 * rng.standard_normal(40)
    columns = np.column_stack([np.ones(40), offset])
    covariance = np.linalg.inv(columns.T @ (columns * weight[:, None]))
    level, slope = covariance @ (columns.T @ (weight * value))
    line = fit_line(offset, value, weight)
    assert (line.level, line.slope) == pytest.approx((level, slope))
    found = [[line.level_var, line.both], [line.both, line.slope_var]]
    np.testing.assert_allclose(found, covariance)
