"""Whiteness of innovations: what is measured of noise that is known."""

import numpy as np
import pytest

from benchmarks.insertion.innovations import measure_whiteness
from groundtruth.plant_model import coloured


@pytest.mark.parametrize("correlation_s", [0.0, 20e-3])
def test_variance_and_correlation_are_those_of_the_noise(correlation_s):
    times_s = 0.01 * np.arange(20_000)
    # A gap in time, as in a rest, joins no pair.
    times_s[10_000:] += 3.0
    white = np.random.default_rng(0).standard_normal(len(times_s))
    values = measure_whiteness(times_s, 2.0 * coloured(white, 0.01, correlation_s))

    assert values["innovation_mean"] == pytest.approx(0.0, abs=0.1)
    assert values["innovation_variance"] == pytest.approx(4.0, rel=0.1)
    for lag_ms in (10, 20, 50):
        expected = np.exp(-1e-3 * lag_ms / correlation_s) if correlation_s else 0.0
        found = values[f"innovation_correlation_{lag_ms}ms"]
        assert found == pytest.approx(expected, abs=0.03)
