"""Swings of the needle: the tremor of a hand, as the speed of the needle shows it.

Physiological tremor has 6 to 12 Hz. While the needle swings, friction turns and the tip
unloads several times a second; over a whole swing they average out. So does viscous
friction where the needle only goes faster and slower: filters of the speed take that
for noise. So one block of samples then holds one swing, from front to front.
"""

import math
from dataclasses import dataclass

from foundation.jit import compiled_inside

MIN_HALF_S = 0.02
"""Length of half a swing, at least: what is quicker is vibration."""

MAX_HALF_S = 0.12
"""Length of half a swing, at most: what is slower is a motion of its own."""


@dataclass(slots=True)
class NeedleSwing:
    """Whether the needle swings, and where in a swing it is.

    Attributes:
        mean_m_s: Mean speed.
        smoothed_m_s: Speed without most of its noise.
        last_m_s: Speed at the last sample.
        change_m_s: Its change at that sample.
        noise_variance: Of single speeds.
        is_fast: Whether this half of the swing is faster than the mean speed.
        half_s: Time since the last turn.
        turns: Turns in a row that lie within half a swing of each other.
        is_swinging: Whether the needle swings.
    """

    mean_m_s: float = 0.0
    smoothed_m_s: float = 0.0
    last_m_s: float = 0.0
    change_m_s: float = 0.0
    noise_variance: float = 0.0
    is_fast: bool = False
    half_s: float = 0.0
    turns: int = 0
    is_swinging: bool = False


@compiled_inside
def learn_speed_noise(swing: NeedleSwing, speed_m_s: float, dt_s: float) -> None:
    """Learn the noise of single speeds, which a second difference shows."""
    change_m_s = speed_m_s - swing.last_m_s
    bend_m_s = change_m_s - swing.change_m_s
    swing.last_m_s = speed_m_s
    swing.change_m_s = change_m_s
    square = bend_m_s * bend_m_s / 6.0  # variance of a second difference of white noise
    gain = dt_s / (1.0 + dt_s)  # it is learnt over a second
    swing.noise_variance += gain * (square - swing.noise_variance)


@compiled_inside
def update_swing(swing: NeedleSwing, measured_m_s: float, dt_s: float) -> bool:
    """Use the measured speed of one sample; return whether a swing ends with it."""
    learn_speed_noise(swing, measured_m_s, dt_s)
    gain = dt_s / (0.008 + dt_s)  # low-pass, short of half a swing
    swing.smoothed_m_s += gain * (measured_m_s - swing.smoothed_m_s)
    speed_m_s = swing.smoothed_m_s
    # The mean speed is taken over a few swings.
    swing.mean_m_s += (speed_m_s - swing.mean_m_s) * dt_s / (0.4 + dt_s)
    swing.half_s += dt_s
    if swing.half_s > MAX_HALF_S:
        swing.turns = 0
        swing.is_swinging = False
    deviation_m_s = speed_m_s - swing.mean_m_s
    # Half a swing begins beyond the noise, and at less than the speed of a tremor of
    # 0.02 mm at 6 Hz, 0.75 mm/s; noise of a measured speed seldom reaches it.
    min_m_s = max(5e-4, 3.0 * math.sqrt(swing.noise_variance))
    is_turn = deviation_m_s < -min_m_s if swing.is_fast else deviation_m_s > min_m_s
    if is_turn:
        is_quick = MIN_HALF_S <= swing.half_s <= MAX_HALF_S
        swing.turns = swing.turns + 1 if is_quick else 0
        swing.half_s = 0.0
        swing.is_fast = not swing.is_fast
        # A hand trembles on; noise of an arm's speed (`fri`) makes as many turns in a
        # row in 0.2 % of the time.
        swing.is_swinging = swing.turns >= 12
    return is_turn and not swing.is_fast
