"""Means over a few milliseconds: the clock of detection, whatever the sample rate."""

from typing import NamedTuple

from identification.default_tick import DefaultTick

_ROUNDING = 1e-6


class Block(NamedTuple):
    """Mean of the samples of one short interval.

    Attributes:
        time_s: End of the interval.
        dt_s: Length of the interval.
        depth_m: Mean depth.
        speed_m_s: Mean speed.
        force_N: Mean force.
        bristle: Presliding deflection at its end, -1 to 1.
    """

    time_s: float
    dt_s: float
    depth_m: float
    speed_m_s: float
    force_N: float
    bristle: float

    def less(self, offset_N: float) -> "Block":
        """With an offset taken out of the force."""
        time_s, dt_s, depth_m, speed_m_s, force_N, bristle = self
        return Block(time_s, dt_s, depth_m, speed_m_s, force_N - offset_N, bristle)


def is_block_full(filled_s: float, block_s: float) -> bool:
    """Whether a block is long enough; sparse samples make blocks of one sample each."""
    return filled_s >= least_block_s(block_s)


def least_block_s(block_s: float) -> float:
    """Length from which on a block is full: a hair less than wanted, for sums round."""
    return block_s * (1.0 - _ROUNDING)


def mean_block(tick: DefaultTick, time_s: float) -> Block:
    """The block that has been filled."""
    length = tick.filled_s
    means = (tick.depth_sum / length, tick.speed_sum / length, tick.force_sum / length)
    return Block(time_s, length, *means, tick.bristle)


def emptied(tick: DefaultTick) -> DefaultTick:
    """To begin the next block with."""
    return DefaultTick(0.0, 0.0, 0.0, 0.0, *tick[4:])
