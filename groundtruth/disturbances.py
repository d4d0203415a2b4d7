"""What reaches arm and tissue from outside: an organ that moves, a force across the needle, a hand.

A scenario has any of them; no estimator learns of one but through the signals.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueMotion:
    """The tissue moves along the needle, as with heart or breath: a sum of waves."""

    waves: tuple[tuple[float, float, float], ...]  # amplitude [m], frequency [Hz], phase [rad]

    def at(self, t_s: ArrayLike) -> tuple[Array, Array]:
        """Place [m] of the undeformed surface, positive away from the robot, and its speed."""
        amplitude, frequency, phase = np.array(self.waves).T
        rate = 2.0 * np.pi * frequency
        angle = np.multiply.outer(np.asarray(t_s, dtype=np.float64), rate) + phase
        return np.sin(angle) @ amplitude, np.cos(angle) @ (rate * amplitude)


@dataclass(frozen=True, slots=True, kw_only=True)
class LateralForce:
    """Tissue pushes the needle aside at its tip: in contact only, across the needle."""

    constant_N: float = 0.0
    growth_N_per_m: float = 0.0  # with depth
    direction_rad: float = 0.0  # at the surface, from the tool's x axis towards its y axis
    turn_rad_per_m: float = 0.0  # of that direction, with depth

    def at(self, depth_m: float) -> tuple[float, float]:
        """Force on the needle along the tool's x and y axes [N]."""
        if depth_m <= 0.0:
            return 0.0, 0.0
        size = self.constant_N + self.growth_N_per_m * depth_m
        angle = self.direction_rad + self.turn_rad_per_m * depth_m
        return size * math.cos(angle), size * math.sin(angle)


@dataclass(frozen=True, slots=True, kw_only=True)
class ElbowPush:
    """A hand pushes the elbow now and then and lets go: half a sine each time."""

    force_N: tuple[float, float, float]  # the largest, in base axes
    start_s: tuple[float, ...]  # of each push
    duration_s: float  # of each

    def at(self, t_s: float) -> Array:
        """Force on the elbow in base axes [N], shape (3,)."""
        done = [(t_s - start) / self.duration_s for start in self.start_s]
        size = sum(math.sin(math.pi * part) for part in done if 0.0 < part < 1.0)
        return size * np.array(self.force_N)
