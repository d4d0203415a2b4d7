"""When the speed of a needle shows a swing, and when it shows none."""

import numpy as np
import pytest

from identification.mixture.needle_swing import NeedleSwing, update_swing

DT_S = 2e-3
MEAN_M_S = 3e-3


def swinging(rate_hz, amplitude_m_s, *, seconds=2.0, noise_m_s=0.0):
    """Whether the needle swings, sample by sample, and how many swings have ended.

    It swings for these seconds about a mean speed, and then for one second no more.
    """
    t_s = DT_S * np.arange(round((seconds + 1.0) / DT_S))
    wave = np.sin(2.0 * np.pi * rate_hz * t_s) * (t_s < seconds)
    noise = noise_m_s * np.random.default_rng(0).normal(size=len(t_s))
    swing = NeedleSwing(mean_m_s=MEAN_M_S, smoothed_m_s=MEAN_M_S)
    ends = 0
    is_swinging = []
    for speed_m_s in (MEAN_M_S + amplitude_m_s * wave + noise).tolist():
        ends += update_swing(swing, speed_m_s, DT_S)
        is_swinging.append(swing.is_swinging)
    return np.array(is_swinging), ends


@pytest.mark.parametrize("rate_hz", [6.0, 9.0, 12.0])
def test_a_tremor_is_a_swing_until_it_ends(rate_hz):
    is_swinging, ends = swinging(rate_hz, 4e-3)

    assert is_swinging[650:1000].all()
    assert not is_swinging[1100:].any()
    assert ends == pytest.approx(2.0 * rate_hz, abs=1)


@pytest.mark.parametrize(
    ("rate_hz", "amplitude_m_s"),
    [
        (2.0, 4e-3),  # a motion of its own
        (35.0, 9e-3),  # vibration
        (9.0, 0.4e-3),  # noise of a measured speed
    ],
)
def test_what_is_no_tremor_is_no_swing(rate_hz, amplitude_m_s):
    is_swinging, _ = swinging(rate_hz, amplitude_m_s)

    assert not is_swinging.any()


def test_a_tremor_that_hardly_slows_the_needle_is_a_swing():
    is_swinging, _ = swinging(9.0, 1.2e-3)

    assert is_swinging[650:1000].all()


def test_noise_of_single_speeds_neither_hides_a_tremor_nor_makes_one():
    is_swinging, _ = swinging(9.0, 4e-3, noise_m_s=0.7e-3)
    is_noise_swinging, _ = swinging(9.0, 0.0, noise_m_s=0.7e-3)

    assert is_swinging[500:1000].mean() > 0.9
    assert not is_noise_swinging.any()


def swings_after(halves_s):
    """Whether a needle swings whose speed is high and low in turn, each for a time."""
    swing = NeedleSwing(mean_m_s=MEAN_M_S, smoothed_m_s=MEAN_M_S)
    for number, half_s in enumerate(halves_s):
        speed_m_s = MEAN_M_S + (-4e-3 if number % 2 else 4e-3)
        for _ in range(round(half_s / DT_S)):
            update_swing(swing, speed_m_s, DT_S)
    return swing.is_swinging


def test_twelve_turns_in_a_row_are_a_swing_and_one_that_is_vibration_begins_anew():
    assert swings_after([0.05] * 12 + [0.03])
    assert not swings_after([0.05] * 11 + [0.03])
    assert not swings_after([0.05] * 11 + [0.014] + [0.05] * 11 + [0.03])
    assert swings_after([0.05] * 2 + [0.014] + [0.05] * 13 + [0.03])


def test_a_pause_of_more_than_0_12_s_begins_anew():
    assert swings_after([0.05] * 11 + [0.11, 0.03])
    assert not swings_after([0.05] * 11 + [0.13, 0.03])
