"""How boundaries of a plan rupture, and what ruptures say about where it lies.

Bayes over two unknowns: the offset of the plan along the needle, on a grid, and the
boundary that the last rupture was, by the forward recursion over assignments that keep
the order. Arrays of shape (boundaries + 1, offsets) have a row for each boundary that
may have been the last one matched, the first row for none.
"""

from collections.abc import Sequence
from copy import copy
from typing import Any

import numpy as np
from scipy.special import ndtr

from foundation.arrays import Array
from needleforce.anatomy.errors import PlanError
from needleforce.anatomy.structures import words_of

GRID_m = 0.1e-3
"""Distance of the offsets on their grid: that of the ruptures' own deviation."""

CAPSULES = frozenset(("liver", "spleen", "kidney"))
"""Words in the names of organs in a capsule (liver: Okamura 2004, doi
10.1109/TBME.2004.831542)."""

LATE_m = 5e-3
"""By so much a membrane ruptures late: it is pushed in first."""

LATE_STD_m = 2.5e-3
"""Standard deviation of that."""

CONTACT_STD_m = 0.15e-3
"""Of the depth of contact: 0.15 mm in 59 of 60 random stacks behind the virtual sensor;
in the last it was found 4.8 mm too high, in the air."""


class RuptureModel:
    """The probabilities of boundaries and offsets; see the module.

    Args:
        names: Of the layers behind each boundary.
        bound_m: Planned depths of the boundaries, shape (boundaries,).
        bound_std_m: Their standard deviations.
        offset_std_m: Of the plan's error along the needle.

    Attributes:
        offset_m: The grid of offsets, shape (offsets,).
    """

    def __init__(
        self,
        names: Sequence[str],
        bound_m: Array,
        bound_std_m: Array,
        offset_std_m: float,
    ) -> None:
        # Of a rupture's depth: 0.03 mm, and 0.06 too high, in random stacks behind the
        # virtual sensor.
        rupture_std_m = 0.1e-3
        reach = 5.0  # of the grid, in standard deviations of the offset
        missed, late = _chances([name.lower() for name in names])
        self._at_once_and_late = np.array([1.0 - late, late])[:, :, None]
        self._missed = missed[:, None]
        self._bound_m = bound_m
        self._contact_std_m = float(np.hypot(bound_std_m[0], CONTACT_STD_m))
        self._offset_std_m = offset_std_m
        half = round(reach * offset_std_m / GRID_m)
        self.offset_m: Array = GRID_m * np.arange(-half, half + 1.0)
        std_m = np.hypot(bound_std_m, rupture_std_m)
        std_m[0] = np.hypot(std_m[0], offset_std_m)  # of the surface, see `met_at`
        # Of each offset, before the first rupture.
        self._weight = np.zeros((len(names) + 1, len(self.offset_m)))
        self._weight[0] = _student_density(self.offset_m / offset_std_m)
        self._weight /= self._weight.sum()
        # Where a boundary ruptures at once, and late: (2, boundaries, offsets).
        at_once_m = bound_m[:, None] + self.offset_m
        self._rupture_m = np.array([at_once_m, at_once_m + LATE_m])
        self._std_m = np.array([std_m, np.hypot(std_m, LATE_STD_m)])[..., None]

    def met_at(self, contact_m: float) -> "RuptureModel":
        """Return the model where the surface was met at a depth."""
        # Probability that the surface is off by the plan's offset: so it is where
        # registration errs, and not where organs have moved beneath the skin. Nobody
        # knows beforehand which it is.
        together = 0.5
        surface_m = contact_m - self._bound_m[0]
        alone_std_m = np.hypot(self._contact_std_m, self._offset_std_m)
        alone = _student_density(surface_m / alone_std_m) / alone_std_m
        off = _normal_density(surface_m - self.offset_m, self._contact_std_m)
        model = copy(self)
        weight = self._weight * (together * off + (1.0 - together) * alone)
        model._weight = weight / weight.sum()
        # A membrane on the surface is pushed in from there, wherever it was planned.
        model._rupture_m = self._rupture_m.copy()
        model._rupture_m[:, 0] = np.array([[contact_m], [contact_m + LATE_m]])
        model._std_m = self._std_m.copy()
        model._std_m[:, 0, 0] = CONTACT_STD_m, np.hypot(CONTACT_STD_m, LATE_STD_m)
        return model

    def infer(
        self, deepest_m: float, ruptures_m: Sequence[float]
    ) -> tuple[Array, Array]:
        """Return what is known with the tip as deep as it has been.

        Args:
            deepest_m: Of the tip.
            ruptures_m: In their order.

        Returns:
            Probability of each number of boundaries passed (rows) and offset; and of
            what the last rupture was: a false alarm, or each boundary.

        Raises:
            PlanError: A rupture is not finite, or above the one before.
        """
        # Travel from a rupture to its alarm: of random stacks behind the virtual sensor
        # 0.15 to 0.9 mm.
        alarm_m = 0.5e-3
        # Where the tip is, boundaries wait, or were passed unnoticed.
        later = ndtr((self._rupture_m - deepest_m + alarm_m) / self._std_m)
        passed = self._missed * (self._rupture_m[0] <= deepest_m)
        waiting = (1.0 - self._missed) * (self._at_once_and_late * later).sum(axis=0)
        waiting = waiting + self._missed - passed
        weight, false_alarm = self._weigh(ruptures_m)
        joint = _sum_in_front(weight, passed)
        joint[:-1] *= waiting
        # Where nothing explains the depth, what was known before stays.
        joint = joint / joint.sum() if joint.sum() > 0.0 else weight
        # Whichever the last one was: what lies behind it was passed without another.
        behind = np.ones_like(weight)
        for row in reversed(range(len(waiting))):
            behind[row] = waiting[row] + passed[row] * behind[row + 1]
        likelihood = ((weight - false_alarm) * behind).sum(axis=1)
        likelihood[0] = (false_alarm * behind).sum()
        return joint, likelihood / max(likelihood.sum(), 1e-300)

    def _weigh(self, ruptures_m: Sequence[float]) -> tuple[Array, Array]:
        """Return the probabilities of each assignment and offset after ruptures.

        The second array is the part in which the last rupture was a false alarm.
        """
        # A rupture may lie so far above the one before it: depths are estimates.
        order_tolerance_m = 1e-3
        false_per_m = 0.5  # false alarms per metre of travel
        weight = false_alarm = self._weight
        deepest_m = -np.inf
        for depth_m in ruptures_m:
            if not deepest_m - order_tolerance_m <= depth_m < np.inf:
                raise PlanError(
                    f"rupture at {depth_m!r} m after one at {deepest_m:.4f} m"
                )
            deepest_m = max(deepest_m, depth_m)
            off_m = depth_m - self._rupture_m
            densities = self._at_once_and_late * _normal_density(off_m, self._std_m)
            in_front = _sum_in_front(weight, self._missed)[:-1]
            matched = in_front * (1.0 - self._missed) * densities.sum(axis=0)
            false_alarm = false_per_m * weight
            weight = false_alarm + np.pad(matched, ((1, 0), (0, 0)))
            false_alarm = false_alarm / weight.sum()
            weight = weight / weight.sum()
        return weight, false_alarm

    def median_m(self, joint: Array) -> float:
        """Return the median of the offset.

        Args:
            joint: Probabilities by boundaries passed and offset.
        """
        marginal = joint.sum(axis=0)
        cumulative = np.cumsum(marginal) - 0.5 * marginal
        return float(np.interp(0.5, cumulative, self.offset_m))

    def withdraw(self, joint: Array, depth_m: float) -> Array:
        """Return how likely each number of boundaries lies above a withdrawn tip.

        Args:
            joint: Probabilities by boundaries passed and offset.
            depth_m: Of the tip, which has been deeper.
        """
        above = np.searchsorted(self._bound_m, depth_m - self.offset_m, "right")
        counted = np.minimum(np.arange(len(joint))[:, None], above)
        counts = np.bincount(counted.ravel(), joint.ravel(), len(joint))
        return np.asarray(counts, dtype=np.float64)


def _chances(names: Sequence[str]) -> tuple[Array, Array]:
    """Return how likely boundaries rupture unnoticed, and late, (boundaries,) each.

    Inside an organ that was entered before there is no capsule.

    Args:
        names: Of the layers behind them.
    """
    # Unnoticed one in five, but where fat ends, which holds little force; late, as
    # membranes do, one in four, but of an organ with a capsule. The surface ruptures
    # only where a membrane covers it.
    missed = np.full(len(names), 0.2)
    late = np.full(len(names), 0.25)
    for k, name in enumerate(names):
        if name not in names[:k] and CAPSULES & words_of(name):
            late[k] = 0.8
        elif k and "fat" in words_of(names[k - 1]):
            missed[k] = 0.6
    missed[0] = 0.8
    late[0] = 1.0
    return missed, late


def _student_density(x: Any) -> Any:
    """Return the density of Student's t with 3 degrees of freedom.

    Its tails are heavy: a deviation that is stated too small does not deceive.
    """
    return 6.0 * np.sqrt(3.0) / np.pi / (3.0 + x * x) ** 2


def _normal_density(x_m: Array, std_m: Array | float) -> Array:
    """Return the density of a normal law with mean 0, per metre."""
    return np.asarray(
        np.exp(-0.5 * (x_m / std_m) ** 2) / (np.sqrt(2.0 * np.pi) * std_m)
    )


def _sum_in_front(weight: Array, unnoticed: Array) -> Array:
    """Return the weight in front of each boundary, the last row behind all.

    It includes what passed others unnoticed.
    """
    total = weight.copy()
    for boundary, fraction in enumerate(unnoticed):
        total[boundary + 1] += fraction * total[boundary]
    return total
