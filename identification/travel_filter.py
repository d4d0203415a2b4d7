"""Depth and speed of the tip from noisy samples: a Kalman filter that learns their noise.

Its state is depth and speed; the speed wanders as white acceleration would make it. Every sample
measures the depth, and the speed too where the robot tells it. How noisy either is shows in how far
a sample lies from the line between its neighbours, which no needle's motion does within a few
milliseconds. A speed that was itself made from positions is late, and its noise is smooth: what its
means over 16 ms scatter says how little it knows.
"""

import math
from typing import NamedTuple

from needleforce.jit import compiled

_WANDER_M2_PER_S3 = 2e-7
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
_UNKNOWN_SPEED_VARIANCE = 1e-2
"""At the first sample: a tenth of a metre per second."""


class Noise(NamedTuple):
    """Variance of single samples, learned from distances to the line between two neighbours."""

    variance: float = 0.0  # Learned so far
    seen: float = 0.0  # How many values it rests on
    before: float = 0.0  # Last value
    before_that: float = 0.0  # The one before
    dt_s: float = 0.0  # Time between the two; 0 while there are none


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
    of_depth: Noise = Noise()
    of_speed: Noise = Noise()
    of_blocks: Noise = Noise()  # Of means of the speed
    filled_s: float = 0.0  # Length of the block being filled
    samples: float = 0.0  # Number of samples in it
    speed_sum: float = 0.0  # Sum of their speeds

    @property
    def plain(self) -> "Memory":
        """As `filter_travel` takes it."""
        nested = (tuple(part) if isinstance(part, Noise) else part for part in self)
        return tuple(nested)  # type: ignore[return-value]

    @staticmethod
    def of(plain: "Memory") -> "TravelState":
        """From what `filter_travel` gave."""
        parts = (Noise(*part) if isinstance(part, tuple) else part for part in plain)
        return TravelState(*parts)


PlainNoise = tuple[float, float, float, float, float]
"""The fields of `Noise`."""
Memory = tuple[
    float, float, float, float, float, float, float, float, float,
    PlainNoise, PlainNoise, PlainNoise, float, float, float,
]  # fmt: skip
"""The fields of `TravelState`, plain."""
Motion = tuple[float, float, float, float]
"""Depth [m], speed [m/s] and the standard deviation that noise of the samples leaves in each."""


@compiled
def learn_noise(known: PlainNoise, value: float, dt_s: float, least: float) -> PlainNoise:
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
    """How many times more the speed wanders just now.

    Innovations of a filter that keeps up have no mean: one that chance does not explain shows a
    needle that starts, stops or turns.
    """
    return max(surprise * surprise * (2.0 - gain) / gain / _SIGNIFICANT, 1.0) ** 2


@compiled
def filter_travel(
    depth_m: float, speed_m_s: float, dt_s: float, memory: Memory
) -> tuple[Motion, Memory]:
    """Use one checked sample; `speed_m_s` is nan where nobody measures it.

    Time steps may differ from sample to sample; the filter is exact for each.
    """
    z, v, pzz, pzv, pvv, nzz, nzv, nvv, surprise = memory[:9]
    of_depth, of_speed, of_blocks, filled, samples, speed_sum = memory[9:]
    is_told = not math.isnan(speed_m_s)
    of_depth = learn_noise(of_depth, depth_m, dt_s, _LEAST_DEPTH_VARIANCE)
    noise = max(of_depth[0], _LEAST_DEPTH_VARIANCE)
    if is_told:
        of_speed = learn_noise(of_speed, speed_m_s, dt_s, _LEAST_SPEED_VARIANCE)
        filled, samples, speed_sum = filled + dt_s, samples + 1.0, speed_sum + speed_m_s
    if pzz == 0.0:
        z, v = depth_m, speed_m_s if is_told else 0.0
        pzz, pvv = 1e-8, _UNKNOWN_SPEED_VARIANCE
    else:
        gain = -math.expm1(-dt_s / _HASTE_S)
        wander = _WANDER_M2_PER_S3 * _haste(surprise, gain)
        z += v * dt_s
        pzz += dt_s * (2.0 * pzv + dt_s * pvv) + wander * dt_s**3 / 3.0
        pzv += dt_s * pvv + wander * dt_s * dt_s / 2.0
        pvv += wander * dt_s
        nzz += dt_s * (2.0 * nzv + dt_s * nvv)
        nzv += dt_s * nvv
        total = pzz + noise
        error = depth_m - z
        surprise += gain * (error / math.sqrt(total) - surprise)
        gz, gv = pzz / total, pzv / total
        z, v = z + gz * error, v + gv * error
        pzz, pzv, pvv = (1.0 - gz) * pzz, (1.0 - gz) * pzv, pvv - gv * pzv
        nvv += gv * (gv * (nzz + noise) - 2.0 * nzv)
        nzv = (1.0 - gz) * (nzv - gv * nzz) + gz * gv * noise
        nzz = (1.0 - gz) * (1.0 - gz) * nzz + gz * gz * noise
    if is_told and of_speed[1] > 0.0:
        # Of a smooth noise samples of one block are as good as one.
        noise = of_speed[0]
        if of_blocks[1] >= _ENOUGH_BLOCKS:
            noise = max(noise, of_blocks[0] * _BLOCK_S / dt_s)
        total = pvv + noise
        error = speed_m_s - v
        gz, gv = pzv / total, pvv / total
        z, v = z + gz * error, v + gv * error
        pzz, pzv, pvv = pzz - gz * pzv, (1.0 - gv) * pzv, (1.0 - gv) * pvv
        nzz += gz * (gz * (nvv + noise) - 2.0 * nzv)
        nzv = (1.0 - gv) * (nzv - gz * nvv) + gz * gv * noise
        nvv = (1.0 - gv) * (1.0 - gv) * nvv + gv * gv * noise
    if filled >= _BLOCK_S:
        mean = speed_sum / samples
        of_blocks = learn_noise(of_blocks, mean, filled, _LEAST_SPEED_VARIANCE)
        filled = samples = speed_sum = 0.0
    state = (z, v, pzz, pzv, pvv, nzz, nzv, nvv, surprise)
    motion = (z, v, math.sqrt(max(nzz, 0.0)), math.sqrt(max(nvv, 0.0)))
    more = (of_depth, of_speed, of_blocks, filled, samples, speed_sum)
    return motion, state + more
