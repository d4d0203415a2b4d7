"""Joint friction models."""

import numpy as np
import pytest

from residual import ConfigurationError, JointFriction, SigmoidFriction


def test_smooth_friction_opposes_motion_and_reaches_coulomb_plus_viscous():
    friction = JointFriction(viscous_Nms=[2.0], coulomb_Nm=[1.0], offset_Nm=[0.25])
    assert friction.torque(np.array([0.5]))[0] == pytest.approx(2.0 * 0.5 + 1.0 + 0.25)
    assert friction.torque(np.array([-0.5]))[0] == pytest.approx(-2.0 * 0.5 - 1.0 + 0.25)
    assert friction.torque(np.array([0.0]))[0] == pytest.approx(0.25)


def test_sigmoid_friction_is_zero_at_rest_and_follows_its_formula():
    friction = SigmoidFriction(amplitude_Nm=[0.5], slope_s_rad=[5.0], shift_rad_s=[0.04])
    assert friction.torque(np.array([0.0]))[0] == 0.0
    expected = 0.5 / (1 + np.exp(-5 * (0.3 + 0.04))) - 0.5 / (1 + np.exp(-5 * 0.04))
    assert friction.torque(np.array([0.3]))[0] == pytest.approx(expected)


def test_sigmoid_friction_levels_off_at_any_speed():
    one, ones = np.ones(4), np.array([-1.0, 1.0, -1.0, 1.0])
    friction = SigmoidFriction(amplitude_Nm=one, slope_s_rad=50.0 * ones, shift_rad_s=30.0 * one)
    # A warning is an error in this suite.
    found = friction.torque(np.array([-1e3, -1e3, 1e3, 1e3]))
    np.testing.assert_allclose(found, [1.0, -1.0, 0.0, 0.0], atol=1e-300)


def test_parameters_are_read_only_copies():
    coulomb = np.array([1.0])
    friction = JointFriction(viscous_Nms=[0.0], coulomb_Nm=coulomb, offset_Nm=[0.0])
    coulomb[0] = 9.0
    assert friction.coulomb_Nm[0] == 1.0
    assert not friction.coulomb_Nm.flags.writeable


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"viscous_Nms": [-1.0]}, "negative"),
        ({"coulomb_Nm": [1.0, 2.0]}, "differ in length"),
        ({"offset_Nm": [np.nan]}, "offset_Nm"),
        ({"offset_Nm": ["much"]}, "offset_Nm"),
        ({"offset_Nm": [1j]}, "offset_Nm"),
        ({"offset_Nm": None}, "offset_Nm"),
        ({"offset_Nm": [10**400]}, "offset_Nm"),
        ({"reversal_speed_rad_s": 0.0}, "reversal_speed"),
        ({"reversal_speed_rad_s": np.inf}, "reversal_speed"),
        ({"reversal_speed_rad_s": np.nan}, "reversal_speed"),
        ({"reversal_speed_rad_s": None}, "reversal_speed"),
        ({"reversal_speed_rad_s": 10**400}, "reversal_speed"),
    ],
)
def test_parameters_that_cannot_be_are_refused(change, match):
    sound = {"viscous_Nms": [0.1], "coulomb_Nm": [0.1], "offset_Nm": [0.0]}
    with pytest.raises(ConfigurationError, match=match):
        JointFriction(**(sound | change))
