"""Depth and speed of the tip from noisy samples: a Kalman filter that learns their noise.

Its state is depth and speed; the speed changes as white acceleration makes it. Every sample
measures the depth, and the speed where the robot reports it. How noisy either is shows in how far a
sample lies from the line between its neighbours, which no needle's motion does within a few
milliseconds. A speed that was itself made from positions is late, and its noise is smooth: what its
means over 16 ms scatter says how little it knows.
"""

import math
from typing import NamedTuple

from needleforce.jit import compiled

_ACCELERATION_M2_PER_S3 = 2e-7
"""Spectral density of the acceleration: the speed changes by half a millimetre per second in 0.1 s,
one standard deviation. Starts and stops are quicker, see `_haste`."""
_MEMORY_S = 2.0
"""Over which noise is learned."""
_FIRST, _CLIP = 50.0, 9.0
"""After so many values a square counts at most so many times the known one: no noise, but motion
or a slip."""
_LEAST_DEPTH_VARIANCE, _LEAST_SPEED_VARIANCE = 1e-16, 1e-14
"""0.01 um and 0.1 um/s: what rounding leaves of exact samples."""
_BLOCK_S = 0.016
_ENOUGH_BLOCKS = 12.0
_HASTE_S = 0.05
_SIGNIFICANT = 4.0
_MOST_SURPRISE = 5.0
"""Standard deviations that one innovation counts: a single odd depth is not a needle that turns."""
_GAP_S = 0.25
"""After a longer step the filter starts anew."""
_UNKNOWN_DEPTH_VARIANCE, _UNKNOWN_SPEED_VARIANCE = 1e-8, 1e-2
"""At its first sample: 0.1 mm, and a tenth of a metre per second."""


Noise = tuple[float, float, float, float, float]
"""Variance of single samples, learned from distances to the line between two neighbours; on how
many values it rests; the last value, the one before, and the time between them, 0 while there are
none."""
NO_NOISE: Noise = (0.0, 0.0, 0.0, 0.0, 0.0)
Memory = tuple[
    float, float, float, float, float, float, float, float, float, float,
    Noise, Noise, Noise, float, float, float,
]  # fmt: skip
"""The fields of `TravelState`."""
Belief = tuple[float, float, float, float, float, float, float, float]
"""Its first eight."""
Motion = tuple[float, float, float, float]
"""Depth [m], speed [m/s] and the standard deviation that noise of the samples leaves in each."""


class TravelState(NamedTuple):
    """All that the filter remembers; compiled code takes and gives plain tuples."""

    depth_m: float = 0.0
    speed_m_s: float = 0.0
    var_depth: float = 0.0  # 0 before the first sample
    covariance: float = 0.0
    var_speed: float = 0.0
    # The same, of what noise of the samples alone has left in the answer
    noise_depth: float = 0.0
    noise_both: float = 0.0
    noise_speed: float = 0.0
    surprise: float = 0.0  # Mean of the latest standardised innovations of the depth
    speed_surprise: float = 0.0  # The same of a measured speed
    of_depth: Noise = NO_NOISE
    of_speed: Noise = NO_NOISE
    of_blocks: Noise = NO_NOISE  # Of means of the speed
    filled_s: float = 0.0  # Length of the block being filled
    samples: float = 0.0  # Number of samples in it
    speed_sum: float = 0.0  # Sum of their speeds


@compiled
def learn_noise(known: Noise, value: float, dt_s: float, least: float) -> Noise:
    """Use one value, `dt_s` after the last one.

    With weights a, 1 - a of its neighbours the middle of three values is off their line by a
    variance of 1 + a^2 + (1 - a)^2 single ones. A value that has not changed at all is one of a
    needle at rest or rounded: it says nothing.
    """
    variance, seen, before, before_that, last_dt = known
    if last_dt > 0.0 and not (value == before and before == before_that):
        a = last_dt / (last_dt + dt_s)
        off = before - (a * value + (1.0 - a) * before_that)
        square = off * off / (1.0 + a * a + (1.0 - a) * (1.0 - a))
        if seen >= _FIRST:
            square = min(square, _CLIP * variance)
        seen = min(seen + 1.0, max(_MEMORY_S / dt_s, _FIRST))
        variance = max(variance + (square - variance) / seen, least)
    return variance, seen, value, before, dt_s


@compiled
def _haste(surprise: float, gain: float) -> float:
    """How many times more the speed changes just now.

    Innovations of a filter that keeps up have no mean: one that chance does not explain shows a
    needle that starts, stops or turns.
    """
    return max(surprise * surprise * (2.0 - gain) / gain / _SIGNIFICANT, 1.0) ** 2


@compiled
def _predict(belief: Belief, dt_s: float, density: float) -> Belief:
    """The same `dt_s` later, for a speed under white acceleration."""
    z, v, pzz, pzv, pvv, nzz, nzv, nvv = belief
    return (
        z + v * dt_s,
        v,
        pzz + dt_s * (2.0 * pzv + dt_s * pvv) + density * dt_s**3 / 3.0,
        pzv + dt_s * pvv + density * dt_s * dt_s / 2.0,
        pvv + density * dt_s,
        nzz + dt_s * (2.0 * nzv + dt_s * nvv),
        nzv + dt_s * nvv,
        nvv,
    )


@compiled
def _measure(belief: Belief, value: float, noise: float) -> tuple[Belief, float]:
    """Use a measurement of the first of the two; returns the standardised innovation too."""
    z, v, pzz, pzv, pvv, nzz, nzv, nvv = belief
    total = pzz + noise
    error, gz, gv = value - z, pzz / total, pzv / total
    left = 1.0 - gz
    belief = (
        z + gz * error,
        v + gv * error,
        left * pzz,
        left * pzv,
        pvv - gv * pzv,
        left * left * nzz + gz * gz * noise,
        left * (nzv - gv * nzz) + gz * gv * noise,
        nvv + gv * (gv * (nzz + noise) - 2.0 * nzv),
    )
    off = error / math.sqrt(total)
    return belief, min(max(off, -_MOST_SURPRISE), _MOST_SURPRISE)


@compiled
def _swapped(belief: Belief) -> Belief:
    """Speed first, or depth first again."""
    z, v, pzz, pzv, pvv, nzz, nzv, nvv = belief
    return v, z, pvv, pzv, pzz, nvv, nzv, nzz


@compiled
def filter_travel(
    depth_m: float, speed_m_s: float, dt_s: float, memory: Memory
) -> tuple[Motion, Memory]:
    """Use one checked sample; `speed_m_s` is nan where nobody measures it.

    Time steps may differ from sample to sample; the filter is exact for each.
    """
    belief, (surprise, speed_surprise) = memory[:8], memory[8:10]
    of_depth, of_speed, of_blocks, filled, samples, speed_sum = memory[10:]
    is_measured, gain = not math.isnan(speed_m_s), -math.expm1(-dt_s / _HASTE_S)
    of_depth = learn_noise(of_depth, depth_m, dt_s, _LEAST_DEPTH_VARIANCE)
    noise = max(of_depth[0], _LEAST_DEPTH_VARIANCE)
    if belief[2] == 0.0 or dt_s > _GAP_S:
        speed = speed_m_s if is_measured else 0.0
        variances = (_UNKNOWN_DEPTH_VARIANCE, 0.0, _UNKNOWN_SPEED_VARIANCE)
        belief = (depth_m, speed) + variances + (noise, 0.0, 0.0)  # noqa: RUF005
        surprise = speed_surprise = 0.0
    else:
        haste = _haste(max(abs(surprise), abs(speed_surprise)), gain)
        belief = _predict(belief, dt_s, haste * _ACCELERATION_M2_PER_S3)
        belief, off = _measure(belief, depth_m, noise)
        surprise += gain * (off - surprise)
    if is_measured:
        of_speed = learn_noise(of_speed, speed_m_s, dt_s, _LEAST_SPEED_VARIANCE)
        filled, samples, speed_sum = filled + dt_s, samples + 1.0, speed_sum + speed_m_s
    if is_measured and of_speed[1] > 0.0:
        # Of a smooth noise samples of one block are as good as one.
        is_known = of_blocks[1] >= _ENOUGH_BLOCKS
        noise = max(of_speed[0], of_blocks[0] * _BLOCK_S / dt_s if is_known else 0.0)
        belief, off = _measure(_swapped(belief), speed_m_s, noise)
        belief = _swapped(belief)
        speed_surprise += gain * (off - speed_surprise)
    if filled >= _BLOCK_S:
        mean = speed_sum / samples
        of_blocks = learn_noise(of_blocks, mean, filled, _LEAST_SPEED_VARIANCE)
        filled = samples = speed_sum = 0.0
    motion = (belief[0], belief[1], math.sqrt(max(belief[5], 0.0)), math.sqrt(max(belief[7], 0.0)))
    more = (of_depth, of_speed, of_blocks, filled, samples, speed_sum)
    return motion, belief + (surprise, speed_surprise) + more  # noqa: RUF005
