"""The limit of detection: laws of the matched filter, and a boundary that holds."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.insertion.detection_limit import hold_boundary, sum_evidence
from groundtruth import insert_needle, scenario


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 999), st.floats(0.01, 10.0), st.floats(0.1, 3.0))
def test_a_step_in_white_noise_is_heard_by_the_square_of_its_size(seed, std, step):
    noise = std * np.random.default_rng(seed).standard_normal(20_000)

    evidence = sum_evidence(noise, np.full(100, step * std))

    np.testing.assert_allclose(evidence, step**2 * np.arange(1, 101), rtol=0.15)


@pytest.mark.parametrize(
    ("name", "number"), [("stack-constant", 1), ("liver-constant", 0)]
)
def test_a_boundary_that_holds_changes_nothing_before_and_releases_little(name, number):
    run = insert_needle(name, seed=1)
    rupture = run.truth.ruptures[number]
    held = insert_needle(hold_boundary(scenario(name), rupture), seed=1)

    difference_N = held.force_N - run.force_N
    before = run.t_s < rupture.onset_s
    after = (run.t_s > rupture.end_s) & (run.t_s < rupture.onset_s + 0.25)
    assert not difference_N[before].any()
    assert difference_N[after].max() == pytest.approx(rupture.drop_N, rel=0.2)
