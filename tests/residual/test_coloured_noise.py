"""Noise of one joint that is correlated along its position becomes white."""

import numpy as np
import pytest

from foundation.steps import finish
from residual.bias.coloured_noise import NoiseRoot

WHITE_NM = 0.003
WAVE_NM = 0.02
WAVE_RAD = 0.02
STROKE_RAD = np.concatenate((np.linspace(0.0, 0.3, 100), np.linspace(0.3, 0.0, 100)))
"""There and back: the sensor's waviness is met twice, the white noise is not."""


def waviness(rng):
    """A sum of sines, whose correlation falls with exp(-((q - q') / l)^2 / 2)."""
    sines = 400
    per_rad = rng.standard_normal(sines) / WAVE_RAD
    phases = per_rad * STROKE_RAD[:, None] + rng.uniform(0.0, 2.0 * np.pi, sines)
    return np.sqrt(2.0 / sines) * np.cos(phases).sum(axis=1)


def test_whitened_noise_is_white():
    rng = np.random.default_rng(0)
    noise_Nm = [
        WHITE_NM * rng.standard_normal(len(STROKE_RAD)) + WAVE_NM * waviness(rng)
        for _ in range(60)
    ]
    root = NoiseRoot(WHITE_NM**2, WAVE_NM**2, STROKE_RAD, WAVE_RAD)
    finish(root.compute())
    white = finish(root.whiten(np.transpose(noise_Nm)))
    one = pytest.approx(1.0, abs=0.05)
    none = pytest.approx(0.0, abs=0.05)

    assert np.mean(white**2) == one
    assert np.mean(white[:100] * white[:99:-1]) == none  # there and back
    for step in (1, 2, 5):
        assert np.mean(white[step:] * white[:-step]) == none
