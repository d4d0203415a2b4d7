"""Linear filters that measure a kink of the force at several time scales."""

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

SCALES = (2, 4, 8, 16, 32, 64)
"""Blocks after the supposed kink. At 5 ms a block: 10 ms to 0.32 s, the releases of 0.1 mm at
surgical speeds to 2 mm in real liver. Never one block: a single odd value is not a rupture."""
BASE_RATIO = 3
"""Blocks before the kink, as a multiple of those after it: enough for a line to be predicted."""
BASE_LEAST = 6


@dataclass(frozen=True, slots=True, eq=False)
class KinkKernels:
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
        gain: See `KinkKernels`.
        trend_gain: See `KinkKernels`.
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
def kink_kernels() -> KinkKernels:
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
    return KinkKernels(kink, rise, trend, mean, ahead, together, *gains, spans, scales, length)
