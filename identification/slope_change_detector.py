"""Detection of kinks of the force that carries its own scale."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.errors import InvalidSnapshotError
from identification.input_validation import packed
from identification.multilayer_config import MultilayerConfig
from identification.resampling import Block
from needleforce.jit import COMPILER, Matrix, Vector, compiled

# The arithmetic of the kink detector at all scales, for one block.


BLOCKS, SPAN, GAIN, TREND_GAIN = range(4)
"""Places of the figures of one scale, see `kink_kernels.Scale`."""
_FIGURES = 4
_CLIP = 4.0
_CLIPPED_MEAN = 0.920
"""Mean of min(x^2, 4) for a standard normal x."""
_EVENT = 25.0
_TREND = 3.0
"""Standard deviations by which the force must itself fall, not only leave its line."""
_SLOWED = 0.5
"""Least share of its usual speed at which the needle's friction is judged."""
LEAST_INDEPENDENT = 5.0
_LEAST_VARIANCE = 1e-18

Verdict = tuple[float, float, float, float, float]
"""The fields of `slope_change_detector.Verdict`, plain."""
Outputs = tuple[float, float, float, float, float]
"""Kink, rise, trend, base and ahead of one scale, see `kink_kernels.FilterBank`."""


Learned = tuple[Vector, Vector, Vector]
"""Of each scale: variance, shape (s,), and how many blocks it rests on, shape (s,); variance of
the speed at the fastest scale, shape (1,)."""
Limits = tuple[float, float, float, float]
"""Length of the block [s], wanted time between false alarms [s], relative error of the law of
friction, blocks that a variance rests on at the most."""


@compiled
def _of_scale(outputs: Vector, k: int) -> Outputs:
    """What the filters of one scale say; `outputs` holds all scales, filter by filter."""
    count = len(outputs) // 5
    kink, rise, trend = outputs[k], outputs[count + k], outputs[2 * count + k]
    return kink, rise, trend, outputs[3 * count + k], outputs[4 * count + k]


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
def _damping(force: Outputs, speed: Outputs) -> float:
    """Force per speed, were all the force viscous: as it was, or as it is with more shaft in."""
    _, _, _, force_base, force_ahead = force
    _, _, _, speed_base, speed_ahead = speed
    usual = max(abs(speed_base), 1e-6)
    now = force_ahead / max(speed_ahead, _SLOWED * usual)
    return max(force_base / usual, now, 0.0)


@compiled
def _fall(
    force: Outputs, speed: Outputs, variance: float, speed_variance: float, error_share: float
) -> float:
    """Standardised fall of the force beyond what the loss of speed explains."""
    damping = _damping(force, speed)
    lost = min(speed[0] * damping, 0.0)
    law = error_share * lost
    deviation = math.sqrt(variance + damping * damping * speed_variance + law * law)
    return -min(force[0] - lost, 0.0) / deviation


@compiled
def _judge(
    force: Vector,
    speed: Vector,
    filled: int,
    learned: Learned,
    scales: Vector,
    limits: Limits,
) -> Verdict:
    """Hold one block against the line through the blocks before, at every scale."""
    variance, seen, speed_variance = learned
    dt_s, interval_s, error_share, _ = limits
    fall = rise = deviations = fall_scale = rise_scale = 0.0
    white = speed_variance[0] / scales[GAIN]
    count = len(variance)
    for k in range(count):
        at = _FIGURES * k
        blocks, gain = scales[at + BLOCKS], scales[at + GAIN]
        if filled < scales[at + SPAN] or seen[k] <= LEAST_INDEPENDENT * blocks:
            continue
        threshold = _threshold(blocks, count, seen[k], dt_s, interval_s)
        known = max(variance[k], _LEAST_VARIANCE)
        of_force, of_speed = _of_scale(force, k), _of_scale(speed, k)
        rise_now = of_force[0] / math.sqrt(known) / threshold
        if rise_now > rise:
            rise, rise_scale = rise_now, blocks
        chance = _TREND * math.sqrt(known * scales[at + TREND_GAIN] / gain)
        if of_force[2] < -max(0.5 * of_force[1], chance):
            deviation = _fall(of_force, of_speed, known, white * gain, error_share)
            if deviation / threshold > fall:
                fall, deviations, fall_scale = deviation / threshold, deviation, blocks
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
    force: Vector,
    speed: Vector,
    filled: int,
    learned: Learned,
    scales: Vector,
    limits: Limits,
) -> Learned:
    """Mean square of each scale's output.

    Outputs beyond two deviations are clipped there (and the Gaussian mean square so lost is given
    back); those beyond five are events rather than noise and count a tenth, so that ruptures do
    not raise the threshold but a sensor that has become noisier does. A slower scale is at least
    as noisy as white noise would make it.
    """
    variance, seen, speed_variance = learned
    variance, seen, speed_variance = variance.copy(), seen.copy(), speed_variance.copy()
    fastest = 0.0
    for k in range(len(variance)):
        at = _FIGURES * k
        if filled < scales[at + SPAN]:
            break
        is_known = seen[k] > 10.0 * scales[at + BLOCKS]
        seen[k] = min(seen[k] + 1.0, limits[3])
        rate = 1.0 / max(seen[k], 1.0)
        now = _mean_square(variance[k], force[k], rate, is_known)
        if k == 0:
            fastest = now
            speed_variance[0] = _mean_square(speed_variance[0], speed[0], rate, is_known)
        variance[k] = max(now, min(fastest / scales[GAIN] * scales[at + GAIN], fastest))
    return variance, seen, speed_variance


@compiled
def _as_it_is(numbers: Vector) -> Vector:
    return numbers


_readable = _as_it_is if COMPILER else np.ndarray.tolist
"""Plain Python reads a list in half the time of an array, compiled code an array."""


@compiled
def _shifted(values: Vector, newest: float) -> Vector:
    """Without the oldest, with the newest."""
    moved = np.empty_like(values)
    moved[:-1] = values[1:]
    moved[-1] = newest
    return moved


@compiled
def kink_step(
    signals: tuple[Vector, Vector],
    newest: tuple[float, float],
    filled: int,
    learned: Learned,
    kernels: Matrix,
    scales: Vector,
    limits: Limits,
) -> tuple[tuple[Vector, Vector], Verdict, Learned]:
    """Judge one block by what was known, then learn from it; see `detector_step`.

    Args:
        signals: Last blocks' forces and speeds, newest last, shape (length,) each.
        newest: Force and speed of the new block.
        filled: Blocks since the last restart, the new one included.
        learned: What is known of the noise.
        kernels: The filters, filter by filter, shape (5 s, length).
        scales: Figures of the scales, one scale after the other, shape (4 s,).
        limits: Of the block and the settings.

    Returns:
        The signals with the new block, the verdict on it, and what is known now.
    """
    force, speed = _shifted(signals[0], newest[0]), _shifted(signals[1], newest[1])
    of_force, of_speed = _readable(np.dot(kernels, force)), _readable(np.dot(kernels, speed))
    known = (_readable(learned[0]), _readable(learned[1]), _readable(learned[2]))
    verdict = _judge(of_force, of_speed, filled, known, scales, limits)
    variance, seen, of_speeds = _learn(of_force, of_speed, filled, known, scales, limits)
    learned = (np.asarray(variance), np.asarray(seen), np.asarray(of_speeds))
    return (force, speed), verdict, learned


# Linear filters that measure a kink of the force at several time scales.


SCALES = (2, 4, 8, 16, 32, 64)
"""Blocks after the supposed kink. At 5 ms a block: 10 ms to 0.32 s, the releases of 0.1 mm at
surgical speeds to 2 mm in real liver. Never one block: a single odd value is not a rupture."""
BASE_RATIO = 3
"""Blocks before the kink, as a multiple of those after it: enough for a line to be predicted."""
BASE_LEAST = 6


@dataclass(frozen=True, slots=True, eq=False)
class FilterBank:
    """Filters over the last `length` blocks, newest last.

    Attributes:
        kink: Departure at the newest block from the line through the base, shape (s, length).
        rise: Rise of that line over the scale, shape (s, length).
        trend: Rise over the blocks after the kink alone, shape (s, length).
        base: Mean over the blocks before the kink, shape (s, length).
        ahead: Value of the line through them at the newest block, shape (s, length).
        all: All of these, shape (5 s, length): one product is faster than five.
        gain: Sum of squares of each kink filter: its variance under white noise of variance 1.
        trend_gain: The same of each trend filter.
        spans: Blocks each filter needs.
        scales: Blocks after the kink.
        length: Longest span.
    """

    kink: NDArray[np.float64]
    rise: NDArray[np.float64]
    trend: NDArray[np.float64]
    base: NDArray[np.float64]
    ahead: NDArray[np.float64]
    all: NDArray[np.float64]
    gain: NDArray[np.float64]
    trend_gain: NDArray[np.float64]
    spans: NDArray[np.int64]
    scales: NDArray[np.int64]
    length: int


class Scale(NamedTuple):
    """Figures of one scale as plain floats: too few for arrays to be worth it.

    Attributes:
        blocks: Blocks after the kink.
        span: Blocks its filters need.
        gain: See `FilterBank`.
        trend_gain: See `FilterBank`.
    """

    blocks: int
    span: int
    gain: float
    trend_gain: float


@cache
def kink_scales() -> tuple[Scale, ...]:
    """One per row of the filters."""
    kernels = kink_kernels()
    columns = (kernels.scales, kernels.spans, kernels.gain, kernels.trend_gain)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return tuple(Scale(*row) for row in rows)


@cache
def kink_kernels() -> FilterBank:
    """Least-squares filters of f = a + b t + c max(t - t_kink, 0), one pair per scale."""
    scales = np.array(SCALES)
    bases = np.maximum(BASE_RATIO * scales, BASE_LEAST)
    spans = scales + bases
    length = int(spans.max())
    together = np.zeros((5, len(scales), length))
    kink, rise, trend, mean, ahead = together
    for i, (scale, base) in enumerate(zip(scales, bases, strict=True)):
        time = np.arange(scale + base) - (base - 0.5)
        columns = np.column_stack([np.ones_like(time), time, np.maximum(time, 0.0)])
        filters = np.linalg.pinv(columns)
        kink[i, length - len(time) :] = filters[2] * scale
        rise[i, length - len(time) :] = filters[1] * scale
        trend[i, length - scale :] = np.linalg.pinv(columns[base:, :2])[1] * scale
        mean[i, length - len(time) : length - scale] = 1.0 / base
        line = np.linalg.pinv(columns[:base, :2])
        ahead[i, length - len(time) : length - scale] = line[0] + line[1] * time[-1]
    together.setflags(write=False)
    gains = np.sum(kink**2, axis=1), np.sum(trend**2, axis=1)
    together = together.reshape(-1, length)
    return FilterBank(kink, rise, trend, mean, ahead, together, *gains, spans, scales, length)


_SLOWEST = 16
"""Longest scale noise is judged by: beyond 80 ms tissue, not the sensor, is what varies."""


class DetectorState(NamedTuple):
    """Memory of the detector.

    Attributes:
        force_N: Last blocks' forces, newest last, shape (length,).
        speed_m_s: Last blocks' speeds, shape (length,).
        filled: Blocks since the last restart.
        variance: Learned mean square of each scale's kink [N^2], shape (s,).
        speed_variance: The same of the speed's kink at the fastest scale, shape (1,): noise of
            the measured speed, which no true acceleration reaches in 10 ms.
        seen: Blocks each variance was learned from, shape (s,).
    """

    force_N: NDArray[np.float64]
    speed_m_s: NDArray[np.float64]
    filled: int
    variance: NDArray[np.float64]
    speed_variance: NDArray[np.float64]
    seen: NDArray[np.float64]


class Verdict_kink_detector(NamedTuple):
    """What the detector says about the newest block.

    Attributes:
        fall: Largest standardised fall over its threshold; above 1 is an alarm.
        rise: Largest standardised rise over its threshold.
        deviations: Standard deviations behind `fall`.
        scale: Blocks between the fall's kink and now.
        rise_scale: The same for the rise.
    """

    fall: float
    rise: float
    deviations: float
    scale: int
    rise_scale: int


def initial_detector() -> DetectorState:
    """Nothing seen, nothing learned."""
    kernels = kink_kernels()
    empty = np.zeros(kernels.length)
    zeros = np.zeros(len(kernels.scales))
    return DetectorState(empty, empty, 0, zeros, zeros[:1], zeros)


def check_detector(state: DetectorState) -> None:
    """Refuse a damaged state: compiled code would read beyond the ends of its arrays.

    Raises:
        InvalidSnapshotError: An array is of another kind or shape than the detector's.
    """
    for name, known, given in zip(state._fields, initial_detector(), state, strict=True):
        if not isinstance(known, np.ndarray):
            continue
        if not (
            isinstance(given, np.ndarray)
            and given.dtype == known.dtype
            and given.shape == known.shape
            and given.flags.c_contiguous
        ):
            raise InvalidSnapshotError(
                f"{name} of the detector is {given!r}, expected {known.size} floats"
            )


def restart_detector(state: DetectorState) -> DetectorState:
    """Forget the signal's past but not its noise: after a rupture, a rest or a gap."""
    return state._replace(filled=0)


def block_noise_N2(state: DetectorState) -> float:
    """Variance one block would need if its noise were white, to explain the slowest scale.

    For coloured noise this is the long-run variance that means over many blocks obey.
    """
    rows = zip(kink_scales(), state.variance.tolist(), state.seen.tolist(), strict=True)
    return max(
        (
            variance / scale.gain
            for scale, variance, seen in rows
            if scale.blocks <= _SLOWEST and seen > LEAST_INDEPENDENT * scale.blocks
        ),
        default=0.0,
    )


def detector_step(
    state: DetectorState, block: Block, config: MultilayerConfig
) -> tuple[DetectorState, Verdict_kink_detector]:
    """Judge one block against the line through the blocks before, at every scale.

    The standard deviation of each scale is learned from its own output, so coloured noise,
    sensor lag and the roughness of tissue all set their own threshold. A fall that the loss of
    speed could explain, were all the force viscous, does not count, nor one within the noise of
    that speed; nor does a mere flattening: the force since then must fall, at half the rate it
    rose or faster.

    Args:
        state: Memory.
        block: Newest block.
        config: Settings.
    """
    kernels = kink_kernels()
    filled = min(state.filled + 1, kernels.length)
    limits = (
        block.dt_s,
        float(config.false_alarm_interval_s),
        float(config.model_error_share),
        float(config.noise_memory_s) / block.dt_s,
    )
    (force, speed), verdict, (variance, seen, speed_variance) = kink_step(
        (state.force_N, state.speed_m_s),
        (block.force_N, block.speed_m_s),
        filled,
        (state.variance, state.seen, state.speed_variance),
        kernels.all,
        _scale_figures(),
        limits,
    )
    fall, rise, deviations, scale, rise_scale = verdict
    moved = DetectorState(force, speed, filled, variance, speed_variance, seen)
    return moved, Verdict_kink_detector(fall, rise, deviations, int(scale), int(rise_scale))


@cache
def _scale_figures() -> Any:
    return packed([figure for scale in kink_scales() for figure in scale])


# Dates a kink of the force after the alarm.


_EDGE = 3


@cache
def _kink_columns(length: int) -> NDArray[np.float64]:
    """Unit kink columns max(t - k, 0) with their line removed, shape (candidates, length)."""
    time = np.arange(length, dtype=float)
    line = np.column_stack([np.ones(length), time])
    starts = np.arange(_EDGE, length - 1)
    columns = np.maximum(time[None, :] - starts[:, None], 0.0)
    columns = columns - (columns @ np.linalg.pinv(line).T) @ line.T
    columns /= np.linalg.norm(columns, axis=1, keepdims=True)
    columns.setflags(write=False)
    return columns


def blocks_since_kink(force_N: NDArray[np.float64], sign: float) -> int:
    """Most likely number of blocks since the force left its line.

    Maximises the likelihood of f = a + b t + c max(t - k, 0) over k: the argmax of the detector's
    own statistic, so the date is earlier than the alarm.

    Args:
        force_N: Forces of equally long blocks, newest last.
        sign: Direction of the kink, -1 for a fall, +1 for a rise.

    Returns:
        Blocks between the kink and the newest block, at least one.
    """
    evidence = sign * (_kink_columns(len(force_N)) @ force_N)
    return len(force_N) - 1 - (_EDGE + int(np.argmax(evidence)))
