"""What a sample guard remembers from one sample to the next."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.noise_probe import NoiseProbe, NoiseState
from residual.repeat_watch import AloneState, AloneWatch, RepeatState


class GuardState(NamedTuple):
    """All that a `SampleGuard` remembers.

    Attributes:
        last: Last accepted sample: position, velocity if there is one, torque; shape (2 n,) or
            (3 n,); zeros before the first.
        velocity: Velocity that it left off with [rad/s], shape (n,).
        noise: Learnt noise of the same signals; None until learnt.
        probe: What is known of the noise so far; None once it is learnt.
        rejected: Last sample held back as a spike, or None.
        missed_s: Time since the last accepted sample [s].
        stayed_s: Time for which samples held back agree with each other [s].
        motion: Of the watch for positions and velocities that repeat.
        torque: Of the watch for torques that repeat.
        alone: Of the watch for single torques that repeat.
        age_s: Time since each torque was looked at by itself [s].
        is_loaded: Whether a torque was near its limit at that look.
        warning: What seemed frozen at that look.
        held_s: Time for which positions have repeated now [s].
        swept: Way that they may owe meanwhile [rad], shape (n,); None if they do not repeat.
    """

    last: NDArray[np.float64]
    velocity: NDArray[np.float64]
    noise: NDArray[np.float64] | None
    probe: NoiseState | None
    rejected: NDArray[np.float64] | None
    missed_s: float
    stayed_s: float
    motion: RepeatState
    torque: RepeatState
    alone: AloneState
    age_s: float
    is_loaded: bool
    warning: str
    held_s: float = 0.0
    swept: NDArray[np.float64] | None = None


def fresh_guard(joints: int, size: int) -> GuardState:
    """Nothing seen yet.

    Args:
        joints: Number of joints.
        size: Length of a sample.
    """
    return GuardState(
        last=np.zeros(size),
        velocity=np.zeros(joints),
        noise=None,
        probe=NoiseProbe(size).state,
        rejected=None,
        missed_s=0.0,
        stayed_s=0.0,
        motion=RepeatState(),
        torque=RepeatState(),
        alone=AloneWatch(joints).state,
        age_s=0.0,
        is_loaded=False,
        warning="",
    )
