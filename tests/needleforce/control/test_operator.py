"""The emulated operator at a haptic device."""

import numpy as np
import pytest

from groundtruth import HapticMaster, Operator


def held(at_m=(0.0, 0.0, 0.0), **hand):
    return HapticMaster(Operator(wish_m=lambda t_s: at_m, **hand), position_step_m=0.0)


def test_the_hand_is_a_damped_spring():
    """A held force moves the hand as a damped spring does."""
    master = held(stiffness_N_per_m=200.0, mass_kg=1.75, damping_Ns_per_m=8.0)
    decay = 8.0 / 4.0
    rate = np.sqrt(200.0 / 2.0 - decay**2)
    for t_s in 1e-3 * np.arange(1, 1501):
        master.render((1.5, 0.0, 0.0))
        master.read()
        swing = np.cos(rate * t_s) + decay / rate * np.sin(rate * t_s)
        expected_m = 1.5 / 200.0 * (1.0 - np.exp(-decay * t_s) * swing)
        assert master.position_m[0] == pytest.approx(expected_m, abs=1e-12)

    assert master.port_energy_J == pytest.approx(-1.5 * master.position_m[0])
    assert master.least_energy_J <= master.port_energy_J


def test_the_device_reports_encoder_steps():
    """The device reports steps of its encoders and a smoothed velocity."""
    master = HapticMaster(Operator(wish_m=lambda t_s: (0.05 * t_s, 0.0, 0.0)))
    samples = [master.read() for _ in range(3000)]
    place = np.array([sample.position_m[0] for sample in samples])

    np.testing.assert_allclose(place / 1e-5, np.round(place / 1e-5), atol=1e-6)

    speed = np.array([sample.velocity_m_s[0] for sample in samples[2000:]])

    assert speed.mean() == pytest.approx(0.05, rel=0.02)
    assert 0.0 < speed.std() < 5e-3
    assert samples[-1].t_s == pytest.approx(3.0)


def test_a_disconnected_device_reports_and_shows_nothing():
    """A disconnected device reports nothing and shows no force."""
    master = held()
    master.read()
    master.disconnect(0.05)
    for _ in range(50):
        assert master.read() is None
        master.render((5.0, 0.0, 0.0))

    np.testing.assert_array_equal(master.position_m, 0.0)
    assert master.read() is not None

    master.render((np.nan, 0.0, 0.0))

    assert np.isfinite(master.read().position_m).all()
