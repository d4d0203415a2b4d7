"""From raw samples to depth and speed of the tip: a check, then a Kalman filter.

The filter's state is depth and speed, driven by white acceleration. Every sample
measures the depth, and the speed where the robot reports it. The noise of either is
learnt from the distance of a sample to the line between its neighbours: a needle does
not leave that line within milliseconds. Noise of filtered positions, or of a coarse
encoder, is smooth, and so is that of a speed made from them: it is learnt from the
scatter of means over 16 ms.
"""

import math
from dataclasses import astuple
from typing import Any

import numpy as np

from foundation.arrays import WrittenVector
from foundation.jit import compiled
from identification.config import CheckConfig
from identification.estimate import SampleStatus

_NO_NUMBERS = (str, bytes, bool, np.bool_, complex, np.complexfloating, np.timedelta64)
"""Types that Python or numpy would convert to a float although they are no
measurements."""
LEAST_DT_S = 1e-12
LARGEST_DT_S = 1e6
"""Time steps outside this range are wrong units or garbage; quotients or sums would
overflow."""
LARGEST_MOTION = (
    1e3  # no needle is as deep [m] or as fast [m/s]; powers of larger numbers overflow
)
_ACCELERATION_M2_PER_S3 = 2e-7
"""Spectral density of the acceleration: the speed changes by half a millimetre per
second in 0.1 s, one standard deviation. Starts and stops are quicker, see `_density`."""
_MEMORY_S = 2.0  # memory of the learnt noise
_FIRST = 50.0
_CLIP = 9.0
"""After so many values a square is clipped to so many times the learnt variance: more
is motion or a slip, not noise."""
_LEAST_DEPTH_VARIANCE = 1e-16
_LEAST_SPEED_VARIANCE = 1e-14
"""0.01 um and 0.1 um/s: what rounding leaves of exact samples."""
_BLOCK_S = 0.016
_ENOUGH_BLOCKS = 12.0
_RISE_S = 8.0
"""Smooth noise: length of a block, blocks before it counts, memory of the least
scatter. Motion of the needle adds to the scatter of means, so the least counts (minimum
statistics, Martin 2001)."""
_HASTE_S = 0.05  # averaging time of the standardised innovations
_SIGNIFICANT = (
    4.0  # squared mean innovation, over its variance, that chance does not explain
)
_MOST_SURPRISE = (
    5.0  # An innovation is clipped to so many deviations: one odd depth is no turn
)
_GAP_S = 0.25  # after a step longer than this, and than ten usual ones, the filter starts anew
_FASTEST_M_S = 0.1  # assumed speed of a needle in a gap, where its motion is not seen
_UNKNOWN_DEPTH_VARIANCE = 1e-8
_UNKNOWN_SPEED_VARIANCE = 1e-2
"""Of the state at the first sample: 0.1 mm, and a tenth of a metre per second,
squared."""

STATUSES = tuple(SampleStatus)  # in the order of their numbers; those used come first
_OK, _TIME_GAP, _NOT_A_SCALAR, _NOT_FINITE, _TIME_NOT_FORWARD = range(5)
_DEPTH_JUMP, _SPEED_SIGN, _FORCE_RANGE, _TIME_RANGE, _MOTION_RANGE = range(5, 10)
LAST_USED = _TIME_GAP

# Indices of the memory. Of the check: time since the start, smoothed time step; last
# finite depth, of a sample used or rejected; sum of all jumps removed; recent travel by
# depth and by speed; time since that last depth, whether there is one, and time from
# the last sample used to it.
(
    TIME,
    _USUAL_DT,
    _RAW_DEPTH,
    SHIFT,
    _BY_DEPTH,
    _BY_SPEED,
    _PENDING,
    _HAS_DEPTH,
    _REJECTED,
) = range(9)
# Of the filter: its state and covariance; the part of the covariance that is due to
# noise of the samples alone; means of the latest standardised innovations of depth and
# of a measured speed.
_DEPTH, _SPEED, _VAR_DEPTH, _COVARIANCE, _VAR_SPEED = range(9, 14)
_NOISE_DEPTH, _NOISE_BOTH, _NOISE_SPEED, _SURPRISE, _SPEED_SURPRISE = range(14, 19)
# Noise of depth and speed, and of their means: five numbers each. Block of means being
# filled: its length, the number of its samples, the sums of depth and speed. Least
# variances of the means.
OF_DEPTH = 19
_OF_SPEED = 24
_OF_DEPTHS = 29
_OF_SPEEDS = 34
_FILLED = 39
_SAMPLES = 40
_DEPTH_SUM = 41
_SPEED_SUM = 42
LEAST_DEPTHS = 43
_LEAST_SPEEDS = 44
SAMPLE_MEMORY = 45
# The five numbers of a noise: variance of single samples, number of values it rests on;
# the last value, the one before, and the time between them, 0 while there are none.
_VARIANCE, _SEEN, _LAST, _BEFORE, _LAST_DT = range(5)

Limits = tuple[float, float, float, float, float]  # The fields of `CheckConfig`
Motion = tuple[float, float, float, float]
"""Depth [m], speed [m/s] and the standard deviation that noise of the samples leaves
in each."""


def check_limits(config: CheckConfig) -> Limits:
    """The limits as `take_sample` takes them."""
    gap_s, jump_m, memory_s, travel_m, force_N = map(float, astuple(config))
    return gap_s, jump_m, memory_s, travel_m, force_N


def as_scalar(value: Any) -> float | None:
    """As a float, or None if it is not a single real number."""
    if isinstance(value, float):
        return float(value)
    try:
        if isinstance(value, np.ndarray) and value.ndim == 0:
            value = value[()]
        if isinstance(value, _NO_NUMBERS) or value is np.ma.masked:
            return None
        return None if np.ndim(value) > 0 else float(value)
    except OverflowError:
        return math.inf
    except (
        Exception
    ):  # foreign objects convert by code of their own, which may raise anything
        return None


@compiled
def _check_motion(
    depth: float,
    speed: float,
    dt_s: float,
    is_measured: bool,
    m: WrittenVector,
    limits: Limits,
) -> tuple[int, float]:
    """Compare depth with speed; returns the status and the time since the last
    sample used.
    """
    gap_s, jump_m, sign_memory_s, sign_travel_m, _ = limits
    # Of the time since the last depth, and since the last sample that was used.
    dt = dt_s + m[_PENDING]
    elapsed = dt + m[_REJECTED]
    gap = max(gap_s, 10.0 * m[_USUAL_DT])
    has_depth = m[_HAS_DEPTH] > 0.0
    change = depth - m[_RAW_DEPTH] if has_depth else 0.0
    surprise = change - speed * dt
    keep = math.exp(-dt / sign_memory_s)
    # A needle that stands still after a gap may have moved during it.
    fastest = max(abs(speed), abs(m[_SPEED]), _FASTEST_M_S if dt > gap else 0.0)
    is_jump = abs(surprise) > jump_m + fastest * dt
    by_depth = keep * m[_BY_DEPTH]
    by_speed = keep * m[_BY_SPEED]
    if is_jump:
        m[SHIFT] += surprise
    elif has_depth and dt <= gap and is_measured:
        # The speed now says nothing about travel during a gap, or before the first
        # depth.
        by_depth = by_depth + change
        by_speed = by_speed + speed * dt
    is_contrary = (
        by_depth * by_speed < 0.0 and min(abs(by_depth), abs(by_speed)) > sign_travel_m
    )
    m[_BY_DEPTH] = by_depth
    m[_BY_SPEED] = by_speed
    m[_RAW_DEPTH] = depth
    m[_HAS_DEPTH] = 1.0
    m[_PENDING] = 0.0
    m[_REJECTED] = 0.0
    status = _OK
    if is_jump or is_contrary:
        status = _DEPTH_JUMP if is_jump else _SPEED_SIGN
        m[_REJECTED] = elapsed
    elif has_depth and elapsed > gap:
        status = _TIME_GAP
    usual = m[_USUAL_DT] if m[_USUAL_DT] != 0.0 else dt_s
    if dt_s <= gap:
        m[_USUAL_DT] = usual + 0.05 * (dt_s - usual)
    m[TIME] += dt_s
    return status, elapsed


@compiled
def _check_numbers(
    depth_m: float, speed_m_s: float, force_N: float, dt_s: float, most_N: float
) -> int:
    """Status of a raw sample whose motion is not checked yet."""
    if not math.isfinite(dt_s):
        return _NOT_FINITE
    if dt_s <= 0.0:
        return _TIME_NOT_FORWARD
    if dt_s < LEAST_DT_S or dt_s > LARGEST_DT_S:
        return _TIME_RANGE
    if not math.isfinite(depth_m + speed_m_s + force_N):
        return _NOT_FINITE
    if max(abs(depth_m), abs(speed_m_s)) > LARGEST_MOTION:
        return _MOTION_RANGE
    return _FORCE_RANGE if abs(force_N) > most_N else _OK


@compiled
def learn_noise(
    memory: WrittenVector, at: int, value: float, dt_s: float, least: float
) -> None:
    """Learn from one value, `dt_s` after the last one, the noise whose numbers begin at
    `at`.

    With weights a, 1 - a of its neighbours the middle of three values is off their line
    by 1 + a^2 + (1 - a)^2 times the variance of one. Three equal values are those of a
    needle at rest, or rounded: they say nothing.
    """
    variance = memory[at + _VARIANCE]
    seen = memory[at + _SEEN]
    last = memory[at + _LAST]
    before = memory[at + _BEFORE]
    last_dt = memory[at + _LAST_DT]
    if last_dt > 0.0 and not (value == last and last == before):
        a = last_dt / (last_dt + dt_s)
        off = last - (a * value + (1.0 - a) * before)
        square = off * off / (1.0 + a * a + (1.0 - a) * (1.0 - a))
        if seen >= _FIRST:
            square = min(square, _CLIP * variance)
        seen = min(seen + 1.0, max(_MEMORY_S / dt_s, _FIRST))
        memory[at + _SEEN] = seen
        memory[at + _VARIANCE] = max(variance + (square - variance) / seen, least)
    memory[at + _LAST] = value
    memory[at + _BEFORE] = last
    memory[at + _LAST_DT] = dt_s


@compiled
def _density(memory: WrittenVector, gain: float) -> float:
    """Spectral density of the acceleration: larger where innovations show a start or
    a stop.
    """
    surprise = max(abs(memory[_SURPRISE]), abs(memory[_SPEED_SURPRISE]))
    haste = max(surprise * surprise * (2.0 - gain) / gain / _SIGNIFICANT, 1.0) ** 2
    return haste * _ACCELERATION_M2_PER_S3


@compiled
def _measure(m: WrittenVector, k: int, value: float, noise: float) -> float:
    """Use a measurement of depth (k = 0) or speed (1); returns the standardised
    innovation.
    """
    own = _VAR_DEPTH + 2 * k
    other = _VAR_SPEED - 2 * k
    n_own = _NOISE_DEPTH
    n_other = _NOISE_SPEED
    if k == 1:
        n_own = _NOISE_SPEED
        n_other = _NOISE_DEPTH
    total = m[own] + noise
    error = value - m[_DEPTH + k]
    gain = m[own] / total
    cross = m[_COVARIANCE] / total
    left = 1.0 - gain
    of_own = m[n_own]
    of_both = m[_NOISE_BOTH]
    m[_DEPTH + k] += gain * error
    m[_SPEED - k] += cross * error
    m[other] -= cross * m[_COVARIANCE]
    m[own] *= left
    m[_COVARIANCE] *= left
    m[n_own] = left * left * of_own + gain * gain * noise
    m[_NOISE_BOTH] = left * (of_both - cross * of_own) + gain * cross * noise
    m[n_other] += cross * (cross * (of_own + noise) - 2.0 * of_both)
    return min(max(error / math.sqrt(total), -_MOST_SURPRISE), _MOST_SURPRISE)


@compiled
def _noise(memory: WrittenVector, single: int, least: int, dt_s: float) -> float:
    """Variance of white noise as strong as this one: of smooth noise a block is one
    sample.
    """
    return max(memory[single + _VARIANCE], memory[least] * _BLOCK_S / dt_s)


@compiled
def _learn_smooth_noise(
    memory: WrittenVector, at: int, least: int, value: float, dt_s: float, floor: float
) -> None:
    """Learn from a block's mean the noise whose numbers begin at `at`, and its least
    variance.
    """
    learn_noise(memory, at, value, dt_s, floor)
    variance = memory[at + _VARIANCE]
    last = memory[least] * math.exp(min(dt_s / _RISE_S, 50.0))
    if memory[at + _SEEN] < _ENOUGH_BLOCKS:
        return
    is_mean = memory[at + _SEEN] >= _FIRST  # of few blocks the least is too small
    memory[least] = min(variance, last) if is_mean else variance


@compiled
def _fill_block(
    m: WrittenVector, depth_m: float, speed_m_s: float, dt_s: float, is_measured: bool
) -> None:
    """Add a sample to the block of means, and learn smooth noise from a full one."""
    m[_FILLED] += dt_s
    m[_SAMPLES] += 1.0
    m[_DEPTH_SUM] += depth_m
    m[_SPEED_SUM] += speed_m_s
    if m[_FILLED] < _BLOCK_S:
        return
    depth = m[_DEPTH_SUM] / m[_SAMPLES]
    speed = m[_SPEED_SUM] / m[_SAMPLES]
    length_s = m[_FILLED]
    _learn_smooth_noise(
        m, _OF_DEPTHS, LEAST_DEPTHS, depth, length_s, _LEAST_DEPTH_VARIANCE
    )
    if is_measured:
        _learn_smooth_noise(
            m, _OF_SPEEDS, _LEAST_SPEEDS, speed, length_s, _LEAST_SPEED_VARIANCE
        )
    for k in range(_FILLED, LEAST_DEPTHS):
        m[k] = 0.0


@compiled
def filter_travel(
    depth_m: float,
    speed_m_s: float,
    dt_s: float,
    is_measured: bool,
    memory: WrittenVector,
) -> Motion:
    """Use one checked sample; time steps may differ, the filter is exact for each."""
    m = memory
    gain = -math.expm1(-dt_s / _HASTE_S)
    learn_noise(m, OF_DEPTH, depth_m, dt_s, _LEAST_DEPTH_VARIANCE)
    noise = max(_noise(m, OF_DEPTH, LEAST_DEPTHS, dt_s), _LEAST_DEPTH_VARIANCE)
    if m[_VAR_DEPTH] == 0.0 or dt_s > max(_GAP_S, 10.0 * m[_USUAL_DT]):
        for k in range(_DEPTH, OF_DEPTH):
            m[k] = 0.0
        m[_DEPTH] = depth_m
        m[_SPEED] = speed_m_s if is_measured else 0.0
        m[_VAR_DEPTH] = _UNKNOWN_DEPTH_VARIANCE
        m[_VAR_SPEED] = _UNKNOWN_SPEED_VARIANCE
        m[_NOISE_DEPTH] = noise
    else:
        density = _density(m, gain)
        m[_DEPTH] += m[_SPEED] * dt_s
        m[_VAR_DEPTH] += dt_s * (2.0 * m[_COVARIANCE] + dt_s * m[_VAR_SPEED])
        m[_VAR_DEPTH] += density * dt_s**3 / 3.0
        m[_COVARIANCE] += dt_s * m[_VAR_SPEED] + density * dt_s * dt_s / 2.0
        m[_VAR_SPEED] += density * dt_s
        m[_NOISE_DEPTH] += dt_s * (2.0 * m[_NOISE_BOTH] + dt_s * m[_NOISE_SPEED])
        m[_NOISE_BOTH] += dt_s * m[_NOISE_SPEED]
        m[_SURPRISE] += gain * (_measure(m, 0, depth_m, noise) - m[_SURPRISE])
    if is_measured:
        learn_noise(m, _OF_SPEED, speed_m_s, dt_s, _LEAST_SPEED_VARIANCE)
    if is_measured and m[_OF_SPEED + _SEEN] > 0.0:
        noise = _noise(m, _OF_SPEED, _LEAST_SPEEDS, dt_s)
        m[_SPEED_SURPRISE] += gain * (
            _measure(m, 1, speed_m_s, noise) - m[_SPEED_SURPRISE]
        )
    _fill_block(m, depth_m, speed_m_s, dt_s, is_measured)
    depth_variance = max(m[_NOISE_DEPTH], 0.0)
    speed_variance = max(m[_NOISE_SPEED], 0.0)
    return m[_DEPTH], m[_SPEED], math.sqrt(depth_variance), math.sqrt(speed_variance)


@compiled
def take_sample(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    dt_s: float,
    is_measured: bool,
    memory: WrittenVector,
    limits: Limits,
) -> tuple[int, float, float, float, Motion]:
    """Check one raw sample and, if it can be used, filter its depth and speed.

    Depth, speed, force and time step are as `Identifier.update` takes them; a speed
    that is not measured is the last estimate, which contradicts no depth. Time runs on
    over a rejected sample as long as its time step is valid: a dropped force does not
    shift the clock.

    Returns the status as index in `STATUSES`; of a valid sample the time since the one
    used before [s]; the time since the start; the depth less the jumps removed; the
    motion.
    """
    speed = speed_m_s if is_measured else memory[_SPEED]
    number = _check_numbers(depth_m, speed, force_N, dt_s, limits[4])
    elapsed_s = 0.0
    if number == _OK:
        number, elapsed_s = _check_motion(
            depth_m, speed, dt_s, is_measured, memory, limits
        )
    elif LEAST_DT_S <= dt_s <= LARGEST_DT_S:
        memory[TIME] += dt_s
        memory[_PENDING] += dt_s
    depth = depth_m - float(memory[SHIFT])
    time_s = float(memory[TIME])
    if number > LAST_USED:
        return number, float(elapsed_s), time_s, depth, (0.0, 0.0, 0.0, 0.0)
    motion = filter_travel(depth, speed, elapsed_s, is_measured, memory)
    return number, float(elapsed_s), time_s, depth, motion
