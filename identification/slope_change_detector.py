"""Detection of changes of the force's slope, at six time scales, with thresholds it learns itself.

A filter pair per scale measures how far the newest block departs from the line through the blocks
before. The standard deviation of each scale is learned from its own output, so the noise spectrum,
sensor lag and the roughness of tissue all set their own threshold.
"""

import math
from functools import cache
from typing import NamedTuple

import numpy as np

from identification.config import MultilayerConfig
from identification.estimate import Array
from identification.resampling import Block
from needleforce.jit import Matrix, Vector, compiled

SCALES = (2, 4, 8, 16, 32, 64)
"""Blocks after the supposed change. At 5 ms a block: 10 ms to 0.32 s, the releases of 0.1 mm at
surgical speeds to 2 mm in real liver. Never one block: a single odd value is not a rupture."""
BASE_RATIO = 3
"""Blocks before the change, as a multiple of those after it: enough for a line to be predicted."""
BASE_LEAST = 6
_CLIP = 4.0
_CLIPPED_MEAN = 0.920
"""Mean of min(x^2, 4) for a standard normal x."""
_EVENT = 25.0
_FALL = 3.0
"""Standard deviations by which the force must itself fall, not only leave its line."""
_SLACK = 3.0
"""The loss of speed may be larger than it looks by so many standard deviations of its noise."""
_SLOWED = 0.5
"""Least fraction of its usual speed at which the needle's friction is evaluated."""
_LEAST_INDEPENDENT = 5.0
_LEAST_VARIANCE = 1e-18
_SLOWEST = 16
"""Longest scale noise is taken from: beyond 80 ms tissue, not the sensor, is what varies."""


class FilterBank(NamedTuple):
    """Least-squares filters of f = a + b t + c max(t - t_change, 0) over the last blocks."""

    # Of all scales, s rows each, newest block last, shape (5 s, length): departure at the newest
    # block from the line through the base; rise of that line over the scale; rise over the blocks
    # after the change alone; mean over the blocks before; value of the line through them at the
    # newest block
    filters: Array
    blocks: Array  # Of each scale, as the next three: blocks after the change
    spans: Array  # Blocks its filters need
    gains: Array  # Sum of squares of its first filter: variance under white noise of variance 1
    trend_gains: Array  # The same of the third filter

    @property
    def length(self) -> int:
        """Blocks that the longest filter needs."""
        return self.filters.shape[1]


@cache
def filter_bank() -> FilterBank:
    """The filters at all `SCALES`."""
    scales = np.array(SCALES)
    bases = np.maximum(BASE_RATIO * scales, BASE_LEAST)
    spans = scales + bases
    length = int(spans.max())
    filters = np.zeros((5, len(scales), length))
    change, rise, trend, mean, ahead = filters
    for i, (scale, base) in enumerate(zip(scales, bases, strict=True)):
        time = np.arange(scale + base) - (base - 0.5)
        columns = np.column_stack([np.ones_like(time), time, np.maximum(time, 0.0)])
        inverse = np.linalg.pinv(columns)
        change[i, length - len(time) :] = inverse[2] * scale
        rise[i, length - len(time) :] = inverse[1] * scale
        trend[i, length - scale :] = np.linalg.pinv(columns[base:, :2])[1] * scale
        mean[i, length - len(time) : length - scale] = 1.0 / base
        line = np.linalg.pinv(columns[:base, :2])
        ahead[i, length - len(time) : length - scale] = line[0] + line[1] * time[-1]
    gains = np.sum(change**2, axis=1), np.sum(trend**2, axis=1)
    bank = (filters.reshape(-1, length), scales.astype(float), spans.astype(float), *gains)
    for array in bank:
        array.setflags(write=False)
    return FilterBank(*bank)


# The arithmetic of one block at all scales.

Learned = tuple[Vector, Vector, Vector]
"""Of each scale, shape (s,): variance, how many blocks it rests on, and variance of the speed."""
Scales = tuple[Vector, Vector, Vector, Vector]
"""Blocks, spans, gains and trend gains of the scales, shape (s,) each."""
Limits = tuple[float, float, float, float]
"""Length of the block [s], required time between false alarms [s], relative error of the law of
friction, blocks that a variance rests on at the most."""


@compiled
def _threshold(blocks: float, count: int, seen: float, dt_s: float, interval_s: float) -> float:
    """Deviations exceeded by chance once per `interval_s`, over all scales.

    Gaussian tail for one independent trial per scale length, widened (as Student's t is) while
    the variance rests on few independent values.
    """
    trials = interval_s * count / (blocks * dt_s)
    squared = 2.0 * math.log(max(trials, math.e))
    independent = max(seen / blocks, 1e-9)
    return math.sqrt(squared * (1.0 + squared / (2.0 * independent)))


@compiled
def _standardised_fall(
    force: Matrix, speed: Matrix, k: int, variance: float, speed_variance: float, law_error: float
) -> float:
    """Fall of the force beyond what the loss of speed explains, were all the force viscous."""
    usual = max(abs(speed[3, k]), 1e-6)
    # Damping as it was, or as it is with more shaft inside.
    now = force[4, k] / max(speed[4, k], _SLOWED * usual)
    damping = max(force[3, k] / usual, now, 0.0)
    lost = min((speed[0, k] - _SLACK * math.sqrt(speed_variance)) * damping, 0.0)
    law = law_error * lost
    deviation = math.sqrt(variance + law * law)
    return -min(force[0, k] - lost, 0.0) / deviation


@compiled
def _detect(
    force: Matrix, speed: Matrix, filled: int, learned: Learned, scales: Scales, limits: Limits
) -> tuple[float, float, float, float, float]:
    """Compare one block with the line through the blocks before; fields of `Detection`."""
    variance, seen, speed_variance = learned
    blocks, spans, gains, trend_gains = scales
    dt_s, interval_s, law_error, _ = limits
    fall = rise = deviations = fall_scale = rise_scale = 0.0
    count = len(variance)
    for k in range(count):
        if filled < spans[k] or seen[k] <= _LEAST_INDEPENDENT * blocks[k]:
            continue
        threshold = _threshold(blocks[k], count, seen[k], dt_s, interval_s)
        known = max(variance[k], _LEAST_VARIANCE)
        rise_now = force[0, k] / math.sqrt(known) / threshold
        if rise_now > rise:
            rise, rise_scale = rise_now, blocks[k]
        chance = _FALL * math.sqrt(known * trend_gains[k] / gains[k])
        if force[2, k] < -max(0.5 * force[1, k], chance):
            deviation = _standardised_fall(force, speed, k, known, speed_variance[k], law_error)
            if deviation / threshold > fall:
                fall, deviations, fall_scale = deviation / threshold, deviation, blocks[k]
    return fall, rise, deviations, fall_scale, rise_scale


@compiled
def _mean_square(known: float, output: float, rate: float, is_known: bool) -> float:
    square = output * output
    if not is_known:
        return known + rate * (square - known)
    if square > _EVENT * known:
        rate *= 0.1
    return known + rate * (min(square, _CLIP * known) / _CLIPPED_MEAN - known)


@compiled
def _learn(
    force: Matrix, speed: Matrix, filled: int, learned: Learned, scales: Scales, limits: Limits
) -> Learned:
    """Mean square of each scale's output.

    Outputs beyond two deviations are clipped there (and the Gaussian mean square so lost is given
    back); those beyond five are events rather than noise and count a tenth, so that ruptures do
    not raise the threshold but a sensor that has become noisier does. A slower scale is at least
    as noisy as white noise would make it.
    """
    variance, seen, speed_variance = learned
    blocks, spans, gains, _ = scales
    variance, seen, speed_variance = variance.copy(), seen.copy(), speed_variance.copy()
    fastest = 0.0
    for k in range(len(variance)):
        if filled < spans[k]:
            break
        is_known = seen[k] > 10.0 * blocks[k]
        seen[k] = min(seen[k] + 1.0, limits[3])
        rate = 1.0 / max(seen[k], 1.0)
        now = _mean_square(variance[k], force[0, k], rate, is_known)
        if k == 0:
            fastest = now
        speed_variance[k] = _mean_square(speed_variance[k], speed[0, k], rate, is_known)
        variance[k] = max(now, min(fastest / gains[0] * gains[k], fastest))
    return variance, seen, speed_variance


@compiled
def update_slope_change(
    signals: tuple[Vector, Vector],
    newest: tuple[float, float],
    filled: int,
    learned: Learned,
    filters: Matrix,
    scales: Scales,
    limits: Limits,
) -> tuple[tuple[Vector, Vector], tuple[float, float, float, float, float], Learned]:
    """Evaluate one block by what was known, then learn from it; see `update_detector`."""
    force, speed = np.append(signals[0][1:], newest[0]), np.append(signals[1][1:], newest[1])
    of_force, of_speed = np.dot(filters, force), np.dot(filters, speed)
    # The five filters of `FilterBank`, each at all scales.
    of_force, of_speed = of_force.reshape(5, -1), of_speed.reshape(5, -1)
    detection = _detect(of_force, of_speed, filled, learned, scales, limits)
    return (force, speed), detection, _learn(of_force, of_speed, filled, learned, scales, limits)


class DetectorState(NamedTuple):
    """Memory of the detector."""

    force_N: Array  # Last blocks' forces, newest last, shape (length,)
    speed_m_s: Array  # Last blocks' speeds, shape (length,)
    filled: int  # Blocks since the last restart
    variance: Array  # Learned mean square of each scale's change [N^2], shape (s,)
    speed_variance: Array  # The same of the speed's change, shape (s,)
    seen: Array  # Blocks each variance was learned from, shape (s,)


class Detection(NamedTuple):
    """What the detector reports of the newest block."""

    fall: float  # Largest standardised fall over its threshold; above 1 is an alarm
    rise: float  # Largest standardised rise over its threshold
    deviations: float  # Standard deviations behind `fall`
    scale: int  # Blocks between the fall's change point and now
    rise_scale: int  # The same for the rise


def initial_detector() -> DetectorState:
    """Nothing seen, nothing learned."""
    empty, zeros = np.zeros(filter_bank().length), np.zeros(len(SCALES))
    return DetectorState(empty, empty, 0, zeros, zeros, zeros)


def restart_detector(state: DetectorState) -> DetectorState:
    """Forget the signal's past but not its noise: after a rupture, a rest or a gap."""
    return state._replace(filled=0)


def block_noise_N2(state: DetectorState) -> float:
    """Variance one block would need if its noise were white, to explain the slowest scale.

    For noise of any spectrum this is the long-run variance that means over many blocks obey.
    """
    gains = filter_bank().gains.tolist()
    rows = zip(SCALES, gains, state.variance.tolist(), state.seen.tolist(), strict=True)
    return max(
        (
            variance / gain
            for blocks, gain, variance, seen in rows
            if blocks <= _SLOWEST and seen > _LEAST_INDEPENDENT * blocks
        ),
        default=0.0,
    )


def update_detector(
    state: DetectorState, block: Block, config: MultilayerConfig
) -> tuple[DetectorState, Detection]:
    """Compare one block with the line through the blocks before, at every scale.

    A fall that the loss of speed could explain, were all the force viscous, does not count; nor
    does a mere flattening: the force since then must fall, at half the rate it rose or faster.
    """
    bank = filter_bank()
    filled = min(state.filled + 1, bank.length)
    limits = (
        block.dt_s,
        float(config.false_alarm_interval_s),
        float(config.model_error_fraction),
        float(config.noise_memory_s) / block.dt_s,
    )
    (force, speed), detection, (variance, seen, speed_variance) = update_slope_change(
        (state.force_N, state.speed_m_s),
        (block.force_N, block.speed_m_s),
        filled,
        (state.variance, state.seen, state.speed_variance),
        bank.filters,
        bank[1:],
        limits,
    )
    fall, rise, deviations, scale, rise_scale = map(float, detection)
    state = DetectorState(force, speed, filled, variance, speed_variance, seen)
    return state, Detection(fall, rise, deviations, int(scale), int(rise_scale))


# Estimates the change point after the alarm.

_EDGE = 3


@cache
def _change_columns(length: int) -> Array:
    """Unit columns max(t - k, 0) with their line removed, shape (candidates, length)."""
    time = np.arange(length, dtype=float)
    line = np.column_stack([np.ones(length), time])
    starts = np.arange(_EDGE, length - 1)
    columns = np.maximum(time[None, :] - starts[:, None], 0.0)
    columns = columns - (columns @ np.linalg.pinv(line).T) @ line.T
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    columns.setflags(write=False)
    return columns


def blocks_since_change(force_N: Array, sign: float) -> int:
    """Most likely number of blocks since the force left its line.

    Maximises the likelihood of f = a + b t + c max(t - k, 0) over k: the argmax of the detector's
    own statistic, so the change point is earlier than the alarm. At least one.
    """
    evidence = sign * (_change_columns(len(force_N)) @ force_N)
    return len(force_N) - 1 - (_EDGE + int(np.argmax(evidence)))
