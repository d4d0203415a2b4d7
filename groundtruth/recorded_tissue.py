"""A recorded force in the place of simulated tissue, at the tip of a simulated arm."""

from bisect import bisect_left

import numpy as np

from foundation.arrays import Array
from groundtruth.errors import TissueError
from groundtruth.tissue import Tissue, TissueForce

STANDING_M = 1e-4
"""Within so much of its deepest point the needle holds there."""


class RecordedTissue(Tissue):
    """Tissue whose force was recorded, with the needle alone.

    While the needle advances, the force is the recorded one at its depth. Where it
    holds at the deepest point, it is the recorded one as long after arriving there; in
    withdrawal none is known, and there is none. How it divides into tip force and
    friction is not known either: all of it counts as axial force at the tip.

    Attributes:
        deepest_m: Deepest point of the recording; zero is where that begins.
    """

    def __init__(self, t_s: Array, depth_m: Array, force_N: Array) -> None:
        """Take n samples of an insertion and of the hold after it.

        Args:
            t_s: Times, shape (n,).
            depth_m: Depth of the tip, shape (n,).
            force_N: Axial force, zero in air, shape (n,).
        """
        super().__init__(())
        depth_m = np.maximum.accumulate(depth_m)
        if len(depth_m) < 2 or not np.isfinite(force_N).all():
            raise TissueError(
                "a recorded tissue needs at least two samples, with finite forces"
            )
        self.deepest_m = float(depth_m[-1])
        arrival = int(np.searchsorted(depth_m, self.deepest_m - STANDING_M))
        self._depths_m: list[float] = depth_m[: arrival + 1].tolist()
        self._forces_N: list[float] = force_N[: arrival + 1].tolist()
        self._held_s: list[float] = (t_s[arrival:] - t_s[arrival]).tolist()
        self._held_N: list[float] = force_N[arrival:].tolist()
        self._standing_s = 0.0
        self._reached_m = -np.inf

    @property
    def is_air(self) -> bool:
        """A recording is no air."""
        return False

    def step(self, depth_m: float, speed_m_s: float, dt_s: float) -> TissueForce:
        """Advance by one step and return the force at its end; see `Tissue.step`."""
        super().step(depth_m, speed_m_s, dt_s)
        self._reached_m = max(self._reached_m, depth_m)
        is_at_end = depth_m >= self.deepest_m - STANDING_M
        self._standing_s += dt_s if is_at_end else 0.0
        force_N = 0.0
        if is_at_end:
            force_N = _interpolate(self._held_s, self._held_N, self._standing_s)
        elif depth_m > 0.0 and depth_m >= self._reached_m - STANDING_M:
            force_N = _interpolate(self._depths_m, self._forces_N, depth_m)
        return TissueForce(force_N, force_N, 0.0, 0, ())


def _interpolate(places: list[float], values: list[float], at: float) -> float:
    """Return the value at a place, interpolated; beyond the ends that of the end."""
    after = bisect_left(places, at)
    if after == 0:
        return values[0]
    if after == len(places):
        return values[-1]
    step = places[after] - places[after - 1]
    fraction = (at - places[after - 1]) / step if step > 0.0 else 1.0
    return values[after - 1] + fraction * (values[after] - values[after - 1])
