"""What realistic tissue remembers of the needle, and how one sample changes it."""

from dataclasses import dataclass
from typing import NamedTuple

from groundtruth.interface import Interface
from groundtruth.layer import Layer
from groundtruth.relaxation import bristle_step, relaxation_step
from groundtruth.sample import NeedleSample


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueStack:
    """Layers and the boundaries between them, worked out once.

    Attributes:
        layers: First the one the needle meets first.
        interfaces: From the surface to the exit, one more than layers; empty without layers.
    """

    layers: tuple[Layer, ...]
    interfaces: tuple[Interface, ...]


class TissueState(NamedTuple):
    """The memory of the tissue.

    Attributes:
        depth_m: Depth of the tip at the last step; None before the first.
        deepest_m: Deepest point reached: the end of the channel.
        broken: Interfaces given way so far, the surface included.
        relaxed: Relaxation of the tip force, 0 (fresh) to 1 (a long rest).
        bristles: Presliding deflection per layer, -1 to 1.
    """

    depth_m: float | None
    deepest_m: float
    broken: int
    relaxed: float
    bristles: tuple[float, ...]


def fresh_tissue(stack: TissueStack) -> TissueState:
    """The memory of tissue no needle has touched."""
    return TissueState(None, 0.0, 0, 0.0, (0.0,) * len(stack.layers))


def tissue_step(state: TissueState, sample: NeedleSample, stack: TissueStack) -> TissueState:
    """Advance the tissue by one sample.

    Args:
        state: The tissue before.
        sample: Where the needle is now.
        stack: What it is pushed into.
    """
    depth, speed, dt = sample
    travel = 0.0 if state.depth_m is None else depth - state.depth_m
    deepest = max(state.deepest_m, depth)
    broken = state.broken
    boundaries = stack.interfaces
    while broken < len(boundaries) and deepest >= boundaries[broken].onset_m:
        broken += 1
    bristles = tuple(
        [
            bristle_step(w, travel, dt, layer.friction.presliding_m, layer.relaxed_share)
            for w, layer in zip(state.bristles, stack.layers, strict=True)
        ]
    )
    return TissueState(depth, deepest, broken, relaxation_step(state.relaxed, speed, dt), bristles)
