"""Detection of kinks of the force that carries its own scale."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.block import Block
from identification.default_config import DefaultConfig
from identification.kink_kernels import kink_kernels

_CLIP = 4.0
_CLIPPED_MEAN = 0.920
"""Mean of min(x^2, 4) for a standard normal x."""
_EVENT = 25.0
_TREND = 3.0
"""Standard deviations by which the force must itself fall, not only leave its line."""
_SLOWED = 0.5
"""Least share of its usual speed at which the needle's friction is judged."""
_SLOWEST = 16
"""Longest scale noise is judged by: beyond 80 ms tissue, not the sensor, is what varies."""
_LEAST_INDEPENDENT = 5.0


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


class Verdict(NamedTuple):
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


class Outputs(NamedTuple):
    """What the filters of `KinkKernels` make of one signal, each of shape (s,)."""

    kink: NDArray[np.float64]
    rise: NDArray[np.float64]
    trend: NDArray[np.float64]
    base: NDArray[np.float64]
    ahead: NDArray[np.float64]


CALM = Verdict(0.0, 0.0, 0.0, 0, 0)


def initial_detector() -> DetectorState:
    """Nothing seen, nothing learned."""
    kernels = kink_kernels()
    empty = np.zeros(kernels.length)
    zeros = np.zeros(len(kernels.scales))
    return DetectorState(empty, empty, 0, zeros, zeros[:1], zeros)


def restart_detector(state: DetectorState) -> DetectorState:
    """Forget the signal's past but not its noise: after a rupture, a rest or a gap."""
    return state._replace(filled=0)


def block_noise_N2(state: DetectorState) -> float:
    """Variance one block would need if its noise were white, to explain the slowest scale.

    For coloured noise this is the long-run variance that means over many blocks obey.
    """
    kernels = kink_kernels()
    ready = (state.seen > _LEAST_INDEPENDENT * kernels.scales) & (kernels.scales <= _SLOWEST)
    if not ready.any():
        return 0.0
    return float(np.max(state.variance[ready] / kernels.gain[ready]))


def _thresholds(state: DetectorState, dt_s: float, config: DefaultConfig) -> NDArray[np.float64]:
    """Deviations exceeded by chance once per `false_alarm_interval_s`, over all scales.

    Gaussian tail for one independent trial per scale length, widened (as Student's t is) while
    the variance rests on few independent values.
    """
    kernels = kink_kernels()
    trials = config.false_alarm_interval_s * len(kernels.scales) / (kernels.scales * dt_s)
    squared = 2.0 * np.log(np.maximum(trials, math.e))
    independent = np.maximum(state.seen / kernels.scales, 1e-9)
    return np.sqrt(squared * (1.0 + squared / (2.0 * independent)))


def detector_step(
    state: DetectorState, block: Block, config: DefaultConfig
) -> tuple[DetectorState, Verdict]:
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
    force = np.append(state.force_N[1:], block.force_N)
    speed = np.append(state.speed_m_s[1:], block.speed_m_s)
    filled = min(state.filled + 1, kernels.length)
    of_force = Outputs(*(kernels.all @ force).reshape(5, -1))
    of_speed = Outputs(*(kernels.all @ speed).reshape(5, -1))
    is_full = filled >= kernels.spans
    moved = state._replace(force_N=force, speed_m_s=speed, filled=filled)
    is_ready = is_full & (state.seen > _LEAST_INDEPENDENT * kernels.scales)
    verdict = CALM
    if is_ready.any():
        verdict = _judge(moved, of_force, of_speed, is_ready, block.dt_s, config)
    return _learn(moved, of_force, of_speed, is_full, block.dt_s, config), verdict


def _judge(
    state: DetectorState,
    force: Outputs,
    speed: Outputs,
    is_ready: NDArray[np.bool_],
    dt_s: float,
    config: DefaultConfig,
) -> Verdict:
    kernels = kink_kernels()
    threshold = _thresholds(state, dt_s, config)
    damping = _damping(force, speed)
    lost = np.minimum(speed.kink * damping, 0.0)
    known = np.maximum(state.variance, 1e-18)
    speed_variance = state.speed_variance / kernels.gain[0] * kernels.gain
    law = config.model_error_share * lost
    deviation = np.sqrt(known + damping * damping * speed_variance + law * law)
    fall = -np.minimum(force.kink - lost, 0.0) / deviation
    chance = _TREND * np.sqrt(known * kernels.trend_gain / kernels.gain)
    is_falling = force.trend < -np.maximum(0.5 * force.rise, chance)
    scores = np.where(is_ready & is_falling, fall / threshold, 0.0)
    best = int(np.argmax(scores))
    rises = np.where(is_ready, force.kink / np.sqrt(known) / threshold, 0.0)
    most = int(np.argmax(rises))
    return Verdict(
        float(scores[best]),
        float(rises[most]),
        float(fall[best]),
        int(kernels.scales[best]),
        int(kernels.scales[most]),
    )


def _damping(force: Outputs, speed: Outputs) -> NDArray[np.float64]:
    """Force per speed, were all the force viscous: as it was, or as it is with more shaft in."""
    usual = np.maximum(np.abs(speed.base), 1e-6)
    now = force.ahead / np.maximum(speed.ahead, _SLOWED * usual)
    return np.maximum(np.maximum(force.base / usual, now), 0.0)


def _learn(
    state: DetectorState,
    force: Outputs,
    speed: Outputs,
    is_full: NDArray[np.bool_],
    dt_s: float,
    config: DefaultConfig,
) -> DetectorState:
    """Mean square of each scale's output.

    Outputs beyond two deviations are clipped there (and the Gaussian mean square so lost is given
    back); those beyond five are events rather than noise and count a tenth, so that ruptures do
    not raise the threshold but a sensor that has become noisier does. A slower scale is at least
    as noisy as white noise would make it.
    """
    kernels = kink_kernels()
    seen = np.where(is_full, np.minimum(state.seen + 1.0, config.noise_memory_s / dt_s), state.seen)
    rate = np.where(is_full, 1.0 / np.maximum(seen, 1.0), 0.0)
    is_known = state.seen > 10.0 * kernels.scales
    variance = _mean_square(state.variance, force.kink, rate, is_known)
    white = np.minimum(variance[0] / kernels.gain[0] * kernels.gain, variance[0])
    variance = np.where(is_full, np.maximum(variance, white), variance)
    speed_variance = _mean_square(state.speed_variance, speed.kink[:1], rate[:1], is_known[:1])
    return state._replace(variance=variance, speed_variance=speed_variance, seen=seen)


def _mean_square(
    known: NDArray[np.float64],
    output: NDArray[np.float64],
    rate: NDArray[np.float64],
    is_known: NDArray[np.bool_],
) -> NDArray[np.float64]:
    square = output * output
    is_event = is_known & (square > _EVENT * known)
    clipped = np.minimum(square, _CLIP * known) / _CLIPPED_MEAN
    rate = np.where(is_event, 0.1 * rate, rate)
    return known + rate * (np.where(is_known, clipped, square) - known)
