"""Means over a few milliseconds: the clock of detection, whatever the sample rate."""

from typing import NamedTuple

from identification.sample import Sample


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


class BlockSums(NamedTuple):
    """Time-weighted sums of the block being filled."""

    dt_s: float = 0.0
    depth: float = 0.0
    speed: float = 0.0
    force: float = 0.0


EMPTY = BlockSums()


def block_step(
    sums: BlockSums, sample: Sample, bristle: float, block_s: float
) -> tuple[BlockSums, Block | None]:
    """Add one sample; hand out the block once it spans `block_s`.

    Sparse samples make blocks of one sample each.

    Args:
        sums: Block being filled.
        sample: New sample.
        bristle: Presliding deflection at the sample.
        block_s: Least length of a block.
    """
    time, dt, depth, speed, force = sample
    total = sums.dt_s + dt
    depth = sums.depth + dt * depth
    speed = sums.speed + dt * speed
    force = sums.force + dt * force
    if total < block_s * (1.0 - 1e-6):
        return BlockSums(total, depth, speed, force), None
    return EMPTY, Block(time, total, depth / total, speed / total, force / total, bristle)
