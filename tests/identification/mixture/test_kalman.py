"""Steps of the Kalman filter of one hypothesis."""

import numpy as np
import pytest

from identification.mixture.force_model import UNKNOWNS
from identification.mixture.kalman import update_to_zero


def test_unknowns_whose_sum_is_zero_are_led_there():
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(UNKNOWNS, UNKNOWNS))
    covariance = factor @ factor.T
    mean = rng.normal(size=UNKNOWNS)
    row = np.zeros(UNKNOWNS)
    row[[1, 4, 7]] = 1.0, -2.0, 0.5
    before = mean.copy()
    gain = covariance @ row / (row @ covariance @ row)
    update_to_zero(mean, covariance, row, 0.0)

    assert row @ before != pytest.approx(0.0, abs=0.1)
    assert row @ mean == pytest.approx(0.0, abs=1e-9)
    assert row @ covariance @ row == pytest.approx(0.0, abs=1e-9)
    assert mean == pytest.approx(before - gain * (row @ before))
