"""The limit of detection: the law of the matched filter."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.insertion.detection_limit import sum_evidence


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 999), st.floats(0.01, 10.0), st.floats(0.1, 3.0))
def test_a_step_in_white_noise_is_heard_by_the_square_of_its_size(seed, std, step):
    noise = std * np.random.default_rng(seed).standard_normal(20_000)

    evidence = sum_evidence(noise, np.full(100, step * std))

    np.testing.assert_allclose(evidence, step**2 * np.arange(1, 101), rtol=0.15)
