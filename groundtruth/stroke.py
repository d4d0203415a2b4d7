"""One stroke of a motion: a travel in a time, with a named profile of speed."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from groundtruth.checks import require_positive
from groundtruth.errors import MotionError

Profile = Literal["rest", "quintic", "cruise", "cosine"]
Array = NDArray[np.float64]

RAMP_SHARE_MAX = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Stroke:
    """A stroke from rest to rest; position and speed are continuous, acceleration is bounded.

    Attributes:
        profile: `rest`; `quintic` (minimum jerk); `cruise` (constant speed between smooth ramps);
            `cosine` (half a period of a sinusoid).
        start_s: When it begins.
        duration_s: How long it takes.
        start_m: Where it begins.
        travel_m: Signed travel.
        ramp_share: Share of the duration each ramp of a `cruise` takes, up to one half.
    """

    profile: Profile
    start_s: float
    duration_s: float
    start_m: float
    travel_m: float
    ramp_share: float = 0.1

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            MotionError: The duration or the ramp share is out of range.
        """
        require_positive(MotionError, duration_s=self.duration_s, ramp_share=self.ramp_share)
        if self.ramp_share > RAMP_SHARE_MAX:
            raise MotionError(f"ramp_share is {self.ramp_share!r}; two ramps need at most 0.5 each")

    @property
    def end_s(self) -> float:
        """When it ends."""
        return self.start_s + self.duration_s

    @property
    def end_m(self) -> float:
        """Where it ends."""
        return self.start_m + self.travel_m

    def evaluate(self, t_s: Array) -> tuple[Array, Array]:
        """Position [m] and speed [m/s] at the given times; outside the stroke its ends, at rest.

        Args:
            t_s: Times, any shape.
        """
        s = np.clip((t_s - self.start_s) / self.duration_s, 0.0, 1.0)
        if self.profile == "quintic":
            done, rate = s**3 * (10.0 + s * (6.0 * s - 15.0)), 30.0 * (s * (1.0 - s)) ** 2
        elif self.profile == "cosine":
            done, rate = 0.5 - 0.5 * np.cos(np.pi * s), 0.5 * np.pi * np.sin(np.pi * s)
        elif self.profile == "cruise":
            done, rate = _cruise(s, self.ramp_share)
        else:
            done, rate = np.zeros_like(s), np.zeros_like(s)
        return self.start_m + self.travel_m * done, self.travel_m / self.duration_s * rate


def _cruise(s: Array, ramp: float) -> tuple[Array, Array]:
    """Share of the travel done and its rate: speed rises as 3q² - 2q³, holds, falls alike."""
    mirrored = np.minimum(s, 1.0 - s)
    q = np.minimum(mirrored / ramp, 1.0)
    full = 1.0 / (1.0 - ramp)
    half = full * (ramp * q**3 * (1.0 - 0.5 * q) + np.maximum(mirrored - ramp, 0.0))
    return np.where(s <= 0.5, half, 1.0 - half), full * q * q * (3.0 - 2.0 * q)
