"""How well the friction along a channel is known."""

import numpy as np
import pytest

from identification.channel import ChannelFriction


def test_friction_at_a_speed_is_as_uncertain_as_its_parts_together():
    rng = np.random.default_rng(0)
    covariance = [[0.04, -0.008], [-0.008, 0.0025]]  # Coulomb and viscous
    coulomb_N, viscous = rng.multivariate_normal((0.5, 0.1), covariance, 100_000).T
    offset_N = rng.normal(0.0, 0.05, 100_000)
    friction = ChannelFriction(0.04, -0.008, 0.0025, 0.05**2)

    for speed_mm_s in (0.0, 2.0, 6.0):
        drawn_N = coulomb_N + viscous * speed_mm_s + offset_N
        variance_N2 = friction.variance_at(1e-3 * speed_mm_s)
        assert variance_N2 == pytest.approx(np.var(drawn_N), rel=0.03)
