"""Friction of the joint bearings: it holds at rest and opposes motion."""

from dataclasses import replace

import numpy as np
import pytest

from groundtruth import PLANT_MODELS
from groundtruth.bearing_friction import (
    STRIBECK_PEAK,
    BearingFriction,
    PRESLIDING_rad,
    STRIBECK_SPEED_rad_s,
)

IDEAL = PLANT_MODELS["ideal"]
LIMIT_Nm = np.array([176.0, 176.0, 100.0, 100.0, 100.0, 38.0, 38.0])
COULOMB = 1e-3
LEVEL_Nm = COULOMB * LIMIT_Nm
STEP_s = 2.5e-4


def bearings(**change):
    model = replace(IDEAL, joint_coulomb=COULOMB, **change)
    return BearingFriction(model, LIMIT_Nm, np.random.default_rng(0))


def pushed(friction, push_Nm, inertia, seconds):
    """Angles of free joints under a constant torque, Euler steps as long as the plant's."""
    q, dq, angles = np.zeros(7), np.zeros(7), []
    for _ in range(round(seconds / STEP_s)):
        # a little damping of the tissue's kind, so that the bristle does not ring for ever
        torque = push_Nm + friction.step(dq, STEP_s) - 0.5 * inertia * 40.0 * dq
        dq = dq + STEP_s * torque / inertia
        q = q + STEP_s * dq
        angles.append(q)
    return np.array(angles)


def test_a_joint_at_rest_holds_below_the_peak_without_creeping_and_breaks_loose_above_it():
    for share in (0.5, 0.95, 1.4):
        angles = pushed(bearings(), share * LEVEL_Nm, inertia=1.0, seconds=20.0)
        assert np.abs(angles).max() < 20.0 * PRESLIDING_rad
        middle = angles[len(angles) // 2]
        np.testing.assert_allclose(angles[-1], middle, atol=1e-3 * PRESLIDING_rad)
    angles = pushed(bearings(), 1.6 * LEVEL_Nm, inertia=0.01, seconds=2.0)
    assert (angles[-1] > 100.0 * PRESLIDING_rad).all()


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(
    ("speed", "level"),
    [(1e-3, STRIBECK_PEAK), (STRIBECK_SPEED_rad_s, 1.0 + 0.5 / np.e), (1.0, 1.0)],
)
def test_sliding_friction_is_against_the_motion_at_the_level_of_its_speed(speed, level, direction):
    friction, dq = bearings(), np.full(7, direction * speed)
    for _ in range(round(20.0 * PRESLIDING_rad / (speed * STEP_s)) + 2):
        torque = friction.step(dq, STEP_s)
    np.testing.assert_allclose(torque, -direction * level * LEVEL_Nm, rtol=1e-3)


def test_sizes_of_single_joints_are_drawn_within_the_stated_factor():
    dq = np.ones(7)  # fast sliding, at once beyond presliding
    drawn = replace(IDEAL, joint_coulomb=COULOMB, size_spread=2.0)
    friction = (BearingFriction(drawn, LIMIT_Nm, np.random.default_rng(k)) for k in range(60))
    share = np.array([-one.step(dq, 1.0) / LEVEL_Nm for one in friction])
    assert 0.5 <= share.min() < 0.55
    assert 1.9 < share.max() <= 2.0
    assert np.median(share) == pytest.approx(1.0, rel=0.1)
