"""The arithmetic of the kink detector at all scales, for one block."""

import math

import numpy as np

from speedup import COMPILER, Matrix, Vector, compiled

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
"""The fields of `kink_detector.Verdict`, plain."""
Outputs = tuple[float, float, float, float, float]
"""Kink, rise, trend, base and ahead of one scale, see `kink_kernels.KinkKernels`."""


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
    """Judge one block by what was known, then learn from it; see `kink_detector.detector_step`.

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
