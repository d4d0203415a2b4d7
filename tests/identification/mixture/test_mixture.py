"""The mixture: what time and travel change, and what a force teaches."""

from dataclasses import asdict

import numpy as np
import pytest

from foundation.records import read_element
from identification.mixture.force_model import (
    COLOURED_NOISE,
    HEARTBEAT,
    LAYER,
    MODEL_ERROR,
    Assumptions,
    regressor,
)
from identification.mixture.mixture import (
    LIKELIHOOD_EXPONENT,
    MixtureMemory,
    ProcessNoise,
    correct,
    predict,
)
from tests.identification.mixture.mixtures import BLOCK, component, forces

NOISE = ProcessNoise(
    duration_s=0.02,
    fresh_travel_mm=0.08,
    held_variance=0.0,
    coloured_variance=1e-4,
    heartbeat_variance=2e-4,
    breathing_variance=3e-4,
    model_error_variance=4e-4,
)


def later(mixture, duration_s, travel_mm):
    """The mixture moved on by a time and a travel."""
    memory = MixtureMemory(mixture)
    noise = NOISE._replace(duration_s=duration_s, fresh_travel_mm=travel_mm)
    predict(memory.store, 1, noise)
    return memory.mixture


def test_two_steps_of_time_and_travel_are_one():
    mixture = component(1, LAYER)
    whole = later(mixture, 0.02, 0.08)
    halves = later(later(mixture, 0.01, 0.04), 0.01, 0.04)

    assert whole.means == pytest.approx(halves.means, abs=1e-12)
    assert whole.covariances == pytest.approx(halves.covariances, abs=1e-12)
    assert whole.state.assumptions == pytest.approx(halves.state.assumptions)


def test_disturbances_reach_their_stationary_variances():
    covariances = later(component(1, LAYER), 60.0, 300.0).covariances
    variances = np.diag(covariances[0])[[COLOURED_NOISE, HEARTBEAT, MODEL_ERROR]]

    assert variances == pytest.approx([1e-4, 2e-4, 4e-4])


def learned(mixture, force_N):
    """The mixture after a force at `BLOCK`."""
    memory = MixtureMemory(mixture)
    correct(memory.store, 1, BLOCK._replace(force_N=force_N), 4e-4)
    return memory.mixture


def test_an_expected_force_teaches_as_kalman_says():
    mixture = component(2, LAYER)
    row = regressor(mixture.assumptions[0], BLOCK)
    covariance = mixture.covariances[0]
    expected_N = float(forces(mixture)[0])
    after = learned(mixture, expected_N)

    assert after.means[0] == pytest.approx(mixture.means[0])

    variance = row @ covariance @ row + 4e-4
    # Late in the layer nothing is being released, and no other noise comes on top.
    cross_covariance = covariance @ row
    reduction = np.outer(cross_covariance, cross_covariance) / variance

    assert after.covariances[0] == pytest.approx(covariance - reduction)

    log_weight = -0.5 * LIKELIHOOD_EXPONENT * np.log(variance)

    assert after.log_weights[0] == pytest.approx(log_weight)


def test_an_unexpected_force_moves_the_unknowns_and_costs_weight():
    mixture = component(2, LAYER)
    row = regressor(mixture.assumptions[0], BLOCK)
    expected_N = float(forces(mixture)[0])
    surprised = learned(mixture, expected_N + 1.0)

    assert surprised.log_weights[0] < learned(mixture, expected_N).log_weights[0]
    assert row @ surprised.means[0] > expected_N


def test_a_mixture_is_restored_as_it_was():
    mixture = component(3, LAYER)
    restored = mixture.state.mixture
    for array, restored_array in zip(mixture, restored, strict=True):
        assert (np.asarray(array) == np.asarray(restored_array)).all()
    assumptions = asdict(read_element(Assumptions, restored.assumptions, 0))

    assert assumptions["layer_start_mm"] == 4.0
