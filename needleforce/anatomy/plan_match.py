"""The plan and the ruptures correct each other.

The plan says at which depths boundaries lie, up to an offset along the needle that registration
left; ruptures say where the needle went through one, but not through which. Some boundaries
rupture without being noticed, some alarms are false, and a membrane gives way only after it was
pushed in. Bayes over all of it: the offset on a grid, times which boundary the last rupture was, by
the forward recursion over assignments that keep the order.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from needleforce.anatomy.errors import PlanError
from needleforce.anatomy.path_layers import Layer

Array = NDArray[np.float64]

GRID_m = 0.1e-3
REACH = 5.0
"""Of the grid, in standard deviations of the offset."""
TAIL_DEGREES = 5.0
"""Student's t for the offset: a standard deviation that is stated too small does not deceive."""
MISSED = 0.15
"""Probability that a boundary ruptures unnoticed."""
ENTRY_MISSED = 0.8
"""The same of the surface, which ruptures only where a membrane covers it, and then late."""
FALSE_PER_m = 1.0
"""False alarms per metre of travel."""
LATE = 0.2
"""Probability that a boundary is a membrane, which ruptures late."""
LATE_m, LATE_STD_m = 5e-3, 2.5e-3
"""By so much."""
RUPTURE_STD_m = 0.3e-3
"""Of a rupture's depth."""


class PlanState(NamedTuple):
    """What plan and ruptures say together; depths are those of the ruptures."""

    layer: int  # index of the layer that the tip is in most likely
    name: str  # of that layer
    probability: float  # that the tip is in it
    offset_m: float  # how much deeper everything lies than planned: the posterior's median
    offset_std_m: float
    next_name: str  # of the layer behind the next boundary; empty behind the last
    next_m: float  # depth at which it will be met; nan behind the last
    next_std_m: float
    matched: int  # index of the layer into which the last rupture most likely led; -1: none
    matched_probability: float  # the same, of that boundary or of a false alarm
    is_obstacle_next: bool  # whether bone or cartilage comes next


class PlanMatch:
    """Matches ruptures, in the order in which they come, with a plan.

    Args:
        layers: From `layers_along`, the first where the needle starts.
        offset_std_m: Standard deviation of the plan's error along the needle, as
            `Registration.std_along_m` gives it.
        entry_depth_m: Depth, as the ruptures count it, of the plan's entry point.

    Raises:
        PlanError: No boundary in the plan, or a deviation that is not positive.
    """

    def __init__(
        self, layers: Sequence[Layer], offset_std_m: float, *, entry_depth_m: float = 0.0
    ) -> None:
        if len(layers) < 2:
            raise PlanError(f"the plan has {len(layers)} layers: expected two or more")
        if not 0.0 < offset_std_m < 0.1:
            raise PlanError(
                f"offset_std_m={offset_std_m!r}: expected a positive standard deviation in metres"
            )
        self.layers = tuple(layers)
        self._entry_m = float(entry_depth_m)
        self._std_m = float(offset_std_m)
        # Boundary k is the one in front of layer k: the first is the surface.
        self._bound_m = np.array([layer.entry_m for layer in layers]) + self._entry_m
        self._bound_std_m = np.array([layer.entry_std_m for layer in layers])
        self._missed = np.full(len(layers), MISSED)
        self._late = np.full(len(layers), LATE)
        self._missed[0], self._late[0] = ENTRY_MISSED, 1.0
        half = round(REACH * self._std_m / GRID_m)
        self._offset_m = GRID_m * np.arange(-half, half + 1)
        self.reset()

    def reset(self) -> None:
        """Forget the ruptures: the needle begins again."""
        prior = student.pdf(self._offset_m / self._std_m, TAIL_DEGREES)
        # Rows: offsets. Columns: the last boundary matched, the first for none.
        self._weight = np.zeros((len(self._offset_m), len(self._bound_m) + 1))
        self._weight[:, 0] = prior / prior.sum()
        self._last_m = -np.inf
        self._matched = (-1, 1.0)

    def add(self, rupture_m: float) -> PlanState:
        """Take a rupture; see `state`.

        Args:
            rupture_m: Its depth, not less than that of the one before.

        Raises:
            PlanError: A depth that is not finite, or above the last rupture.
        """
        if not np.isfinite(rupture_m) or rupture_m < self._last_m - 1e-3:
            raise PlanError(f"rupture at {rupture_m!r} m after one at {self._last_m:.4f} m")
        likelihood = self._likelihood(rupture_m)
        count = len(self._bound_m)
        moved = FALSE_PER_m * self._weight
        by_boundary = np.zeros(count + 1)
        by_boundary[0] = moved.sum()
        for boundary in range(count):
            # From any earlier one, with those between missed.
            missed = [self._missed[last:boundary].prod() for last in range(boundary + 1)]
            came = self._weight[:, : boundary + 1] @ missed
            arrived = (1.0 - self._missed[boundary]) * came * likelihood[:, boundary]
            moved[:, boundary + 1] += arrived
            by_boundary[boundary + 1] = arrived.sum()
        total = moved.sum()
        self._weight = moved / total
        self._last_m = max(self._last_m, float(rupture_m))
        best = int(np.argmax(by_boundary))
        self._matched = best - 1, float(by_boundary[best] / total)
        return self.state(rupture_m)

    def _likelihood(self, depth_m: float) -> Array:
        """Density of a rupture at a depth, for each offset and boundary [1/m]."""
        error = depth_m - self._bound_m - self._offset_m[:, None]
        std = np.hypot(self._bound_std_m, RUPTURE_STD_m)
        late = norm.pdf(error, LATE_m, np.hypot(std, LATE_STD_m))
        return (1.0 - self._late) * norm.pdf(error, 0.0, std) + self._late * late

    def _unruptured(self, depth_m: float) -> Array:
        """Probability that a boundary has not ruptured by a depth, though it will; (n, k)."""
        error = depth_m - self._bound_m - self._offset_m[:, None]
        std = np.hypot(self._bound_std_m, RUPTURE_STD_m)
        late = norm.sf(error, LATE_m, np.hypot(std, LATE_STD_m))
        return (1.0 - self._late) * norm.sf(error, 0.0, std) + self._late * late

    def state(self, depth_m: float) -> PlanState:
        """What is known with the tip at a depth: also that nothing ruptured there counts.

        A boundary that should have ruptured long ago has been missed, or lies deeper.
        """
        weight, passed = self._at(depth_m)
        count = len(self._bound_m)
        # Before the surface the tip is counted as in front of the first layer.
        layer = max(int(np.argmax(passed)) - 1, 0)
        offset = weight.sum(axis=1)
        # The median: where two assignments compete, their mean is what neither says.
        middle = float(np.interp(0.5, np.cumsum(offset), self._offset_m))
        std = float(np.sqrt(offset @ (self._offset_m - middle) ** 2))
        is_last = layer == count - 1
        following = float("nan") if is_last else self._bound_m[layer + 1] + middle
        spread = float("nan") if is_last else np.hypot(std, self._bound_std_m[layer + 1])
        after = None if is_last else self.layers[layer + 1]
        return PlanState(
            layer=layer,
            name=self.layers[layer].name,
            probability=float(passed[layer + 1] + (passed[0] if layer == 0 else 0.0)),
            offset_m=middle,
            offset_std_m=std,
            next_name="" if after is None else after.name,
            next_m=float(following),
            next_std_m=float(spread),
            matched=self._matched[0],
            matched_probability=self._matched[1],
            is_obstacle_next=after is not None and after.is_obstacle,
        )

    def interval_m(self, depth_m: float, level: float = 0.95) -> tuple[float, float]:
        """Offsets between which the true one lies with that probability."""
        total = np.cumsum(self._at(depth_m)[0].sum(axis=1))
        low, high = np.interp([0.5 - 0.5 * level, 0.5 + 0.5 * level], total, self._offset_m)
        return float(low), float(high)

    def _at(self, depth_m: float) -> tuple[Array, NDArray[np.float64]]:
        """Weights with the tip at a depth, and how likely it is in each layer."""
        count = len(self._bound_m)
        waiting = self._unruptured(depth_m)
        weight, passed = np.zeros_like(self._weight), np.zeros(count + 1)
        for last in range(count + 1):
            column = self._weight[:, last].copy()
            stays = np.ones_like(column)
            for boundary in range(last, count):
                # Either it still stands, or it has been passed unnoticed.
                missed, lies_here = self._missed[boundary], self._deeper(boundary) <= depth_m
                stands = stays * (1.0 - missed) * waiting[:, boundary]
                lies_ahead = stays * missed * ~lies_here
                here = column * (stands + lies_ahead)
                weight[:, last] += here
                passed[boundary] += here.sum()
                stays = stays * missed * lies_here
            weight[:, last] += column * stays
            passed[count] += (column * stays).sum()
        total = weight.sum()
        if total <= 0.0:  # nothing explains it: what was known before stays
            return self._weight, self._weight.sum(axis=0)
        return weight / total, passed / total

    def _deeper(self, boundary: int) -> Array:
        return self._bound_m[boundary] + self._offset_m
