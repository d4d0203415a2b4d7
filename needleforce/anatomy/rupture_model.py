"""How boundaries of a plan rupture, and what ruptures say about where it lies.

Bayes over two unknowns: the offset of the plan along the needle, on a grid, and the
boundary that the last rupture was, by the forward recursion over assignments that keep
the order. Arrays of shape (boundaries + 1, offsets) have a row for each boundary that
may have been the last one matched, the first row for none.
"""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import ndtr

from foundation.arrays import Array
from needleforce.anatomy.errors import PlanError
from needleforce.anatomy.structures import words_of

GRID_m = 0.1e-3
"""Distance of the offsets on their grid: that of the ruptures' own deviation."""


MISSED = 0.2
"""Probability that a boundary ruptures unnoticed."""


LATE = 0.25
"""Probability that a boundary is a membrane, which ruptures late."""


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

TOGETHER = 0.5
"""Probability that the surface is off by the plan's offset: so it is where registration
errs, and not where organs have moved beneath the skin. Nobody knows beforehand which it
is."""


_SQRT_TWO_PI = np.sqrt(2.0 * np.pi)

ArrayOrFloat = TypeVar("ArrayOrFloat", Array, float)


class Chances(NamedTuple):
    """How boundaries rupture, arrays of shape (boundaries,).

    Attributes:
        missed: Probability that a boundary ruptures unnoticed.
        late: Probability that it is a membrane, which ruptures late.
    """

    missed: Array
    late: Array


class Expectation(NamedTuple):
    """What is expected before the first rupture, for each offset (columns).

    Attributes:
        weight: Of each offset, shape (boundaries + 1, offsets).
        rupture_m: Where a boundary ruptures at once, and late, shape (2, boundaries,
            offsets).
        std_m: Standard deviation of that, shape (2, boundaries, 1).
    """

    weight: Array
    rupture_m: Array
    std_m: Array


class Weights(NamedTuple):
    """What ruptures say, arrays of shape (boundaries + 1, offsets).

    Attributes:
        all: Probability of each assignment and offset.
        false_alarm: The part of it in which the last rupture was a false alarm.
    """

    all: Array
    false_alarm: Array


class Ahead(NamedTuple):
    """What the tip's depth says of boundaries, arrays of shape (boundaries, offsets).

    Attributes:
        waiting: Probability that a boundary has not ruptured yet.
        unnoticed: Probability that it was passed unnoticed.
    """

    waiting: Array
    unnoticed: Array


class Match(NamedTuple):
    """The boundary that the last rupture most likely was.

    Attributes:
        boundary: Its index; -1 for a false alarm.
        probability: Of that.
    """

    boundary: int
    probability: float


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
        chances = find_chances([name.lower() for name in names])
        self._at_once_and_late = np.array([1.0 - chances.late, chances.late])[
            :, :, None
        ]
        self._missed = chances.missed[:, None]
        self._bound_m = bound_m
        self._contact_std_m = float(np.hypot(bound_std_m[0], CONTACT_STD_m))
        self._offset_std_m = offset_std_m
        half = round(reach * offset_std_m / GRID_m)
        steps = np.arange(-half, half + 1).astype(np.float64)
        self.offset_m: Array = np.multiply(GRID_m, steps)
        std_m = np.hypot(bound_std_m, rupture_std_m)
        std_m[0] = np.hypot(std_m[0], offset_std_m)  # the surface, see `TOGETHER`
        weight = np.zeros((len(names) + 1, len(self.offset_m)))
        weight[0] = _student_density(self.offset_m / offset_std_m)
        at_once_m = bound_m[:, None] + self.offset_m
        self._without_contact = Expectation(
            weight / weight.sum(), _with_late_m(at_once_m), _with_late_std_m(std_m)
        )

    def expect(self, contact_m: float | None) -> Expectation:
        """Return what is expected of the ruptures.

        Args:
            contact_m: Depth at which the surface was met; None where not known.
        """
        weight, rupture_m, std_m = self._without_contact
        if contact_m is None:
            return self._without_contact
        surface_m = contact_m - self._bound_m[0]
        contact_std_m = self._contact_std_m
        together = (
            np.exp(-0.5 * ((surface_m - self.offset_m) / contact_std_m) ** 2)
            / contact_std_m
            / _SQRT_TWO_PI
        )
        alone_std_m = np.hypot(contact_std_m, self._offset_std_m)
        alone = _student_density(surface_m / alone_std_m) / alone_std_m
        weight = weight * (TOGETHER * together + (1.0 - TOGETHER) * alone)
        # A membrane on the surface is pushed in from there, wherever it was planned.
        rupture_m = rupture_m.copy()
        rupture_m[:, 0] = np.array([contact_m, contact_m + LATE_m])[:, None]
        std_m = std_m.copy()
        std_m[:, 0] = np.array([CONTACT_STD_m, np.hypot(CONTACT_STD_m, LATE_STD_m)])[
            :, None
        ]
        return Expectation(weight / weight.sum(), rupture_m, std_m)

    def weigh(self, expected: Expectation, ruptures_m: Sequence[float]) -> Weights:
        """Return the probabilities after ruptures at depths, in their order.

        Raises:
            PlanError: A depth is not finite, or above the one before.
        """
        # A rupture may lie so far above the one before it: depths of ruptures are
        # estimates.
        order_tolerance_m = 1e-3
        false_per_m = 0.5  # false alarms per metre of travel
        weight = expected.weight
        false_alarm = weight
        deepest_m = -np.inf
        for depth_m in ruptures_m:
            if not np.isfinite(depth_m) or depth_m < deepest_m - order_tolerance_m:
                raise PlanError(
                    f"rupture at {depth_m!r} m after one at {deepest_m:.4f} m"
                )
            deepest_m = max(deepest_m, depth_m)
            false_alarm = false_per_m * weight
            density = self._rupture_density_1_m(expected, depth_m)
            in_front = _sum_in_front(weight, self._missed)[:-1]
            matched = in_front * (1.0 - self._missed) * density
            weight = false_alarm + np.vstack((np.zeros_like(matched[:1]), matched))
            total = weight.sum()
            weight = weight / total
            false_alarm = false_alarm / total
        return Weights(weight, false_alarm)

    def _rupture_density_1_m(self, expected: Expectation, depth_m: float) -> Array:
        """Return the density of each boundary's rupture at a depth, per metre."""
        exponent = -0.5 * ((depth_m - expected.rupture_m) / expected.std_m) ** 2
        densities = (
            self._at_once_and_late * np.exp(exponent) / (_SQRT_TWO_PI * expected.std_m)
        )
        return densities.sum(axis=0)

    def look_ahead(self, expected: Expectation, depth_m: float) -> Ahead:
        """Return how likely boundaries wait or were passed, with the tip at a depth."""
        # Travel from a rupture to its alarm: of random stacks behind the virtual sensor
        # 0.15 to 0.9 mm.
        alarm_m = 0.5e-3
        later = ndtr((expected.rupture_m - depth_m + alarm_m) / expected.std_m)
        waiting = (self._at_once_and_late * later).sum(axis=0)
        unnoticed = self._missed * (expected.rupture_m[0] <= depth_m)
        return Ahead(
            (1.0 - self._missed) * waiting + self._missed - unnoticed, unnoticed
        )

    def quantile_m(self, joint: Array, level: float) -> float:
        """Return the offset below which a probability lies.

        Args:
            joint: Probabilities by boundaries passed and offset.
            level: The probability.
        """
        marginal = joint.sum(axis=0)
        cumulative = np.cumsum(marginal) - 0.5 * marginal
        return float(np.interp(level, cumulative, self.offset_m))

    def variance_m2(self, joint: Array, centre_m: float) -> float:
        """Return the variance of the offset about a centre."""
        return float((joint @ (self.offset_m - centre_m) ** 2).sum())

    def withdraw(self, joint: Array, depth_m: float) -> Array:
        """Return how likely each number of boundaries lies above a withdrawn tip.

        Args:
            joint: Probabilities by boundaries passed and offset.
            depth_m: Of the tip, which has been deeper.
        """
        passed = np.arange(len(joint))[:, None]
        above = np.searchsorted(self._bound_m, depth_m - self.offset_m, "right")
        counts = np.bincount(
            np.minimum(passed, above).ravel(), joint.ravel(), len(joint)
        )
        return counts.astype(float, copy=False)


def find_chances(names: Sequence[str]) -> Chances:
    """Return how boundaries rupture, by the names of the layers behind them.

    Inside an organ that was entered before there is no capsule.
    """
    soft_missed = 0.6  # `MISSED` where fat ends, which holds little force
    entry_missed = 0.8  # of the surface, which ruptures only where a membrane covers it
    capsule_late = 0.8  # `LATE` where an organ's name says that it has a capsule
    entry_late = 1.0  # of the surface: what ruptures there is a membrane
    missed = np.full(len(names), MISSED)
    late = np.full(len(names), LATE)
    for k, name in enumerate(names):
        if name not in names[:k] and CAPSULES & words_of(name):
            late[k] = capsule_late
        elif k and "fat" in words_of(names[k - 1]):
            missed[k] = soft_missed
    missed[0] = entry_missed
    late[0] = entry_late
    return Chances(missed, late)


def join(ahead: Ahead, weights: Weights) -> Array:
    """Return the probability of each number of boundaries passed (rows) and offset."""
    joint = _sum_in_front(weights.all, ahead.unnoticed)
    joint[:-1] *= ahead.waiting
    total = joint.sum()
    # Where nothing explains the depth, what was known before stays.
    return joint / total if total > 0.0 else weights.all


def match_last_rupture(ahead: Ahead, weights: Weights) -> Match:
    """Return the boundary that the last rupture most likely was.

    Whichever it was: what lies behind it was passed without another rupture.
    """
    # Keeps a probability finite where nothing explains a rupture.
    min_likelihood = 1e-300
    unnoticed_behind = np.ones_like(weights.all)
    for boundary in reversed(range(len(ahead.waiting))):
        unnoticed_behind[boundary] = (
            ahead.waiting[boundary]
            + ahead.unnoticed[boundary] * unnoticed_behind[boundary + 1]
        )
    true_alarm = weights.all - weights.false_alarm
    likelihood = (true_alarm * unnoticed_behind).sum(axis=1)
    likelihood[0] = (weights.false_alarm * unnoticed_behind).sum()
    best = int(np.argmax(likelihood))
    total = max(likelihood.sum(), min_likelihood)
    return Match(best - 1, float(likelihood[best] / total))


def _student_density(x: ArrayOrFloat) -> ArrayOrFloat:
    """Return the density of Student's t with 3 degrees of freedom.

    Its tails are heavy: a deviation that is stated too small does not deceive.
    """
    return 6.0 * np.sqrt(3.0) / np.pi / (3.0 + x * x) ** 2


def _with_late_m(at_once_m: Array) -> Array:
    """Return where boundaries rupture, at once and as membranes (rows)."""
    return np.array([at_once_m, at_once_m + LATE_m])


def _with_late_std_m(std_m: Array) -> Array:
    """Return the deviations of where boundaries rupture, (2, boundaries, 1)."""
    return np.array([std_m, np.hypot(std_m, LATE_STD_m)])[..., None]


def _sum_in_front(weight: Array, unnoticed: Array) -> Array:
    """Return the weight in front of each boundary, the last row behind all.

    It includes what passed others unnoticed.
    """
    total = weight.copy()
    for boundary, fraction in enumerate(unnoticed):
        total[boundary + 1] += fraction * total[boundary]
    return total
