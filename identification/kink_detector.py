"""Detection of kinks of the force that carries its own scale."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.block import Block
from identification.default_config import DefaultConfig
from identification.errors import InvalidSnapshotError
from identification.kink_judge import LEAST_INDEPENDENT, kink_step
from identification.kink_kernels import kink_kernels, kink_scales
from identification.packed import packed

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
    return moved, Verdict(fall, rise, deviations, int(scale), int(rise_scale))


@cache
def _scale_figures() -> Any:
    return packed([figure for scale in kink_scales() for figure in scale])
