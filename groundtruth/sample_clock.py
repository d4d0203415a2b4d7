"""When samples arrive: jittered stamps and losses on the way."""

import numpy as np
from numpy.typing import NDArray

from groundtruth.arm_level import ArmLevel

_JITTER_LIMIT = 0.4
"""Largest error of a stamp in ticks; below one half, so that stamps keep their order."""


def stamps(
    true_s: NDArray[np.float64], tick_s: float, level: ArmLevel, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Time stamps as written: the true instants with the clock's jitter.

    The samples themselves are taken on the tick; only their stamps are wrong.

    Args:
        true_s: Instants of the samples, shape (n,).
        tick_s: Spacing of the ticks.
        level: Gives the jitter.
        rng: Source of the jitter.
    """
    error = level.clock_jitter_std_s * rng.standard_normal(true_s.shape)
    return true_s + np.clip(error, -_JITTER_LIMIT * tick_s, _JITTER_LIMIT * tick_s)


def received(count: int, level: ArmLevel, rng: np.random.Generator) -> NDArray[np.intp]:
    """Which samples arrive; the first and the last always do.

    Args:
        count: Number of samples sent.
        level: Gives how often and how many are lost.
        rng: Source of the losses.

    Returns:
        Their indices, ascending.
    """
    kept = np.ones(count, dtype=bool)
    starts = np.flatnonzero(rng.random(count) < level.drop_probability)
    lengths = rng.integers(1, level.drop_max_samples, len(starts), endpoint=True)
    for start, length in zip(starts, lengths, strict=True):
        kept[start : start + length] = False
    kept[[0, -1]] = True
    return np.flatnonzero(kept)
