"""Noise of the force, learnt part by part, and the texture of the tissue."""

import numpy as np
import pytest

from identification.mixture.disturbances import smooth_walk_step
from identification.mixture.force_model import MODEL_ERROR_MM
from identification.mixture.noise_levels import NoiseLevels, Texture


def test_noise_is_learned_part_by_part():
    levels = NoiseLevels()
    noise_N = 0.01 * np.random.default_rng(9).standard_normal(2000)
    for k, white_N in enumerate(noise_N.tolist()):
        beat_N = 0.05 * np.sin(2.0 * np.pi * 1.2 * 0.01 * k)
        levels = levels.with_force(beat_N + white_N, 0.01, 2.0)

    assert np.sqrt(levels.variances.white) == pytest.approx(0.01, rel=0.15)
    assert np.sqrt(levels.variances.coloured) < 0.008
    assert 0.02 < np.sqrt(levels.variances.heartbeat) < 0.08
    assert levels.restarted().with_force(1.0, 0.01, 2.0).differences.steps == 1.0


def test_a_slow_bend_is_no_noise_in_long_blocks():
    # Blocks of a swing last about 0.1 s.
    levels = NoiseLevels()
    noise_N = 0.01 * np.random.default_rng(9).standard_normal(400)
    for k, white_N in enumerate(noise_N.tolist()):
        bend_N = 0.5 * np.sin(2.0 * np.pi * 0.1 * k / 10.0)
        levels = levels.with_force(bend_N + white_N, 0.1, 3.0)

    assert 0.01 < levels.noise_std_N < 0.05


def test_a_ramp_is_no_noise():
    levels = NoiseLevels()
    for k in range(2000):
        levels = levels.with_force(0.001 * k, 0.01, 2.0)

    assert np.sqrt(levels.variances).max() < 1e-6


def test_chance_is_seldom_a_motion():
    levels = NoiseLevels()
    has_motion = []
    for white_N in (0.01 * np.random.default_rng(9).standard_normal(2000)).tolist():
        levels = levels.with_force(white_N, 0.01, 2.0)
        variances = levels.variances
        has_motion.append(variances.heartbeat > 0.0 or variances.breathing > 0.0)

    assert np.mean(has_motion) < 0.1


def test_texture_shows_an_error_but_no_noise_and_no_bend():
    smooth = Texture()
    rough = Texture()
    rng = np.random.default_rng(2)
    state = np.zeros(2)  # the error of the force model and its slope
    step = smooth_walk_step(0.05, MODEL_ERROR_MM, 0.2**2)
    transition = np.reshape(step.transition, (2, 2))
    covariance = np.array(
        [
            [step.value_variance, step.covariance],
            [step.covariance, step.rate_variance],
        ]
    )
    smooth_errors_N = []
    rough_errors_N = []
    for k, white_N in enumerate((0.005 * rng.standard_normal(4000)).tolist()):
        state = transition @ state + rng.multivariate_normal((0.0, 0.0), covariance)
        bend_N = 0.03 * 0.05 * k + 1e-5 * (0.05 * k) ** 2
        smooth = smooth.with_force(white_N + bend_N, 0.05)
        rough = rough.with_force(white_N + float(state[0]), 0.05)
        smooth_errors_N.append(smooth.model_error(1.0, 0.0))
        rough_errors_N.append(rough.model_error(1.0, 0.0))

    settled = smooth_errors_N[1000:]  # the first 50 mm show how little noise can hide
    assert max(settled) < 0.04
    assert np.mean(rough_errors_N) == pytest.approx(0.2, rel=0.25)
    # A slow error of the sensor may be all that texture shows, and hides as much.
    assert rough.model_error(1.0, 0.3) < 0.1


def texture_behind_noise(noise_N: float) -> Texture:
    texture = Texture()
    rng = np.random.default_rng(3)
    for white_N in (noise_N * rng.standard_normal(1000)).tolist():
        texture = texture.with_force(white_N, 0.05)
    return texture


def test_texture_that_noise_can_hide_counts():
    quiet = texture_behind_noise(0.002).model_error(1.0, 0.0)
    noisy = texture_behind_noise(0.05).model_error(1.0, 0.05)

    assert quiet < 0.02
    assert noisy > 5.0 * quiet


def test_differences_that_overlap_tell_no_more_than_one():
    """A coarse difference takes 3.2 mm of travel. What noise can hide is known no
    better once a second one has begun, and better after six."""
    doubts_N = {4.2: [], 6.2: [], 25.0: []}
    for seed in range(40):
        rng = np.random.default_rng(seed)
        for travel_mm, doubts in doubts_N.items():
            texture = Texture()
            noise_N = 0.05 * rng.standard_normal(round(travel_mm / 0.05))
            for white_N in noise_N.tolist():
                texture = texture.with_force(white_N, 0.05)
            doubts.append(texture.model_error(10.0, 0.05))
    one_N, nearly_two_N, six_N = (np.mean(doubts) for doubts in doubts_N.values())

    assert nearly_two_N == pytest.approx(one_N, rel=0.1)
    assert six_N < 0.75 * one_N


def test_texture_before_it_is_known_is_a_part_of_the_force():
    texture = Texture()

    assert texture.model_error(0.5, 0.0) == pytest.approx(0.1)
    assert texture.model_error(2.0, 0.05) == pytest.approx(0.4)


def test_texture_is_no_more_than_friction_can_be():
    """Friction lies between none and all of the force: half of that, in doubt."""
    rough = Texture(variance_N2=1e3, hidden_N2=0.0)

    assert rough.model_error(0.8, 0.0) == pytest.approx(0.4)
