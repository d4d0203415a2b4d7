"""How well the friction along a channel is known."""

from functools import cache

import numpy as np
import pytest

from identification import Identifier
from identification.channel import ChannelFriction, continue_channel
from tests.identification.worlds import noisy, rows_of, run

STEP_S = 4e-3
SPEED_M_S = 4e-3


def in_air(zero_N):
    """An identifier after 4 s of free air, with a force of that mean there."""
    depth_m = -16e-3 + SPEED_M_S * STEP_S * np.arange(1000)
    force_N = noisy(np.full(1000, zero_N), 0.003, 0)
    return run(rows_of(depth_m, SPEED_M_S, force_N, STEP_S))[0]


@cache
def channel_of_ten_millimetres():
    """What an identifier knows of a channel that it has cut, with the zero at 0 N."""
    depth_m = SPEED_M_S * STEP_S * np.arange(625)
    rows = rows_of(depth_m, SPEED_M_S, noisy(80.0 * depth_m, 0.003, 1), STEP_S)
    return run(rows, in_air(0.0))[0].snapshot()


def test_friction_at_a_speed_is_as_uncertain_as_its_parts_together():
    rng = np.random.default_rng(0)
    covariance = [[0.04, -0.008], [-0.008, 0.0025]]  # Coulomb and viscous
    parts = rng.multivariate_normal((0.5, 0.1), covariance, 100_000)
    offset_N = rng.normal(0.0, 0.05, 100_000)
    friction = ChannelFriction(0.04, -0.008, 0.0025, 0.05**2)

    for speed_mm_s in (0.0, 2.0, 6.0):
        drawn_N = parts @ [1.0, speed_mm_s] + offset_N
        assert friction.variance_at(1e-3 * speed_mm_s) == pytest.approx(
            np.var(drawn_N), rel=0.03
        )


def in_channel_from(zero_N, moved_m):
    """The channel a minute later, with another zero of force and of depth."""
    present = in_air(zero_N).snapshot()
    return continue_channel(channel_of_ten_millimetres(), present, moved_m, 60.0)


def in_channel(zero_N):
    """The last estimate, 2.2 mm in the channel, with a force of that mean in air."""
    identifier = Identifier()
    identifier.restore(in_channel_from(zero_N, 0.0))
    depth_m = -1e-3 + SPEED_M_S * STEP_S * np.arange(200)
    force_N = zero_N + 40.0 * np.maximum(depth_m, 0.0)
    rows = rows_of(depth_m, SPEED_M_S, force_N, STEP_S)
    return run(rows, identifier)[1][-1]


@pytest.mark.parametrize("zero_N", [0.3, -0.3])
def test_a_zero_that_has_drifted_changes_no_friction_in_the_channel(zero_N):
    drifted = in_channel(zero_N)
    as_before = in_channel(0.0)
    forces_N = drifted.shaft_friction_N, drifted.predicted_force_N - zero_N

    assert drifted.layer == as_before.layer == 1
    assert forces_N == pytest.approx(
        (as_before.shaft_friction_N, as_before.predicted_force_N), abs=0.01
    )


def test_a_channel_is_where_it_was_when_depth_counts_from_elsewhere():
    identifier = Identifier()
    identifier.restore(channel_of_ten_millimetres())
    entry_m = 0.02 + identifier.contact_depth_m
    identifier.restore(in_channel_from(0.0, 0.02))

    assert identifier.contact_depth_m == pytest.approx(entry_m, abs=1e-9)

    depths_m = entry_m + SPEED_M_S * STEP_S * np.arange(-60, 61)
    _, estimates = run(rows_of(depths_m, SPEED_M_S, 0.0, STEP_S), identifier)

    assert (estimates[30].layer, estimates[-1].layer) == (0, 1)
