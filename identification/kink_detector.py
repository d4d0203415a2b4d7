"""Detection of kinks of the force that carries its own scale."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.block import Block
from identification.default_config import DefaultConfig
from identification.kink_kernels import Scale, kink_kernels, kink_scales

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
    """What the filters of `KinkKernels` of one scale make of one signal."""

    kink: float
    rise: float
    trend: float
    base: float
    ahead: float


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
    rows = zip(kink_scales(), state.variance.tolist(), state.seen.tolist(), strict=True)
    return max(
        (
            variance / scale.gain
            for scale, variance, seen in rows
            if scale.blocks <= _SLOWEST and seen > _LEAST_INDEPENDENT * scale.blocks
        ),
        default=0.0,
    )


def _threshold(scale: Scale, seen: float, dt_s: float, config: DefaultConfig) -> float:
    """Deviations exceeded by chance once per `false_alarm_interval_s`, over all scales.

    Gaussian tail for one independent trial per scale length, widened (as Student's t is) while
    the variance rests on few independent values.
    """
    trials = config.false_alarm_interval_s * len(kink_scales()) / (scale.blocks * dt_s)
    squared = 2.0 * math.log(max(trials, math.e))
    independent = max(seen / scale.blocks, 1e-9)
    return math.sqrt(squared * (1.0 + squared / (2.0 * independent)))


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
    of_force = [Outputs(*row) for row in (kernels.all @ force).reshape(5, -1).T.tolist()]
    of_speed = [Outputs(*row) for row in (kernels.all @ speed).reshape(5, -1).T.tolist()]
    moved = state._replace(force_N=force, speed_m_s=speed, filled=filled)
    verdict = _judge(moved, of_force, of_speed, block.dt_s, config)
    return _learn(moved, of_force, of_speed, block.dt_s, config), verdict


def _judge(
    state: DetectorState,
    force: list[Outputs],
    speed: list[Outputs],
    dt_s: float,
    config: DefaultConfig,
) -> Verdict:
    verdict, scales = CALM, kink_scales()
    white = float(state.speed_variance[0]) / scales[0].gain
    rows = zip(scales, force, speed, state.variance.tolist(), state.seen.tolist(), strict=True)
    for scale, of_force, of_speed, variance, seen in rows:
        if state.filled < scale.span or seen <= _LEAST_INDEPENDENT * scale.blocks:
            continue
        threshold = _threshold(scale, seen, dt_s, config)
        known = max(variance, 1e-18)
        rise = of_force.kink / math.sqrt(known) / threshold
        if rise > verdict.rise:
            verdict = verdict._replace(rise=rise, rise_scale=scale.blocks)
        chance = _TREND * math.sqrt(known * scale.trend_gain / scale.gain)
        if of_force.trend < -max(0.5 * of_force.rise, chance):
            deviations = _fall(of_force, of_speed, known, white * scale.gain, config)
            if deviations / threshold > verdict.fall:
                verdict = verdict._replace(
                    fall=deviations / threshold, deviations=deviations, scale=scale.blocks
                )
    return verdict


def _fall(
    force: Outputs, speed: Outputs, variance: float, speed_variance: float, config: DefaultConfig
) -> float:
    """Standardised fall of the force beyond what the loss of speed explains."""
    damping = _damping(force, speed)
    lost = min(speed.kink * damping, 0.0)
    law = config.model_error_share * lost
    deviation = math.sqrt(variance + damping * damping * speed_variance + law * law)
    return -min(force.kink - lost, 0.0) / deviation


def _damping(force: Outputs, speed: Outputs) -> float:
    """Force per speed, were all the force viscous: as it was, or as it is with more shaft in."""
    usual = max(abs(speed.base), 1e-6)
    now = force.ahead / max(speed.ahead, _SLOWED * usual)
    return max(force.base / usual, now, 0.0)


def _learn(
    state: DetectorState,
    force: list[Outputs],
    speed: list[Outputs],
    dt_s: float,
    config: DefaultConfig,
) -> DetectorState:
    """Mean square of each scale's output.

    Outputs beyond two deviations are clipped there (and the Gaussian mean square so lost is given
    back); those beyond five are events rather than noise and count a tenth, so that ruptures do
    not raise the threshold but a sensor that has become noisier does. A slower scale is at least
    as noisy as white noise would make it.
    """
    scales, variances, seen = kink_scales(), state.variance.tolist(), state.seen.tolist()
    of_speed, fastest, most = float(state.speed_variance[0]), 0.0, config.noise_memory_s / dt_s
    for k, scale in enumerate(scales):
        if state.filled < scale.span:
            break
        is_known = seen[k] > 10.0 * scale.blocks
        seen[k] = min(seen[k] + 1.0, most)
        rate = 1.0 / max(seen[k], 1.0)
        variance = _mean_square(variances[k], force[k].kink, rate, is_known=is_known)
        if k == 0:
            fastest = variance
            of_speed = _mean_square(of_speed, speed[0].kink, rate, is_known=is_known)
        white = min(fastest / scales[0].gain * scale.gain, fastest)
        variances[k] = max(variance, white)
    return state._replace(
        variance=np.array(variances), speed_variance=np.array([of_speed]), seen=np.array(seen)
    )


def _mean_square(known: float, output: float, rate: float, *, is_known: bool) -> float:
    square = output * output
    if not is_known:
        return known + rate * (square - known)
    if square > _EVENT * known:
        rate *= 0.1
    return known + rate * (min(square, _CLIP * known) / _CLIPPED_MEAN - known)
