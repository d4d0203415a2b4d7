"""The plan and the ruptures correct each other.

The plan says at which depths boundaries lie, up to an offset along the needle that
registration left; ruptures say where the needle went through one, but not through
which, and contact where the first one lies. Some boundaries rupture without being
noticed, some alarms are false, and a membrane gives way only after it was pushed in.
Bayes over all of it: the offset on a grid, times which boundary the last rupture was,
by the forward recursion over assignments that keep the order.
"""

from collections.abc import Sequence
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from needleforce.anatomy.errors import Array, PlanError, require_deviation
from needleforce.anatomy.volume import UNLABELLED, Layer, words

GRID_m = 0.1e-3
REACH = 5.0  # Of the grid, in standard deviations of the offset
MISSED = 0.2
SOFT_MISSED = 0.6
ENTRY_MISSED = 0.8
"""Probability that a boundary ruptures unnoticed; where fat ends, which holds little
force; of the surface, which ruptures only where a membrane covers it, and then late."""
FALSE_PER_m = 0.5  # False alarms per metre of travel
LATE = 0.25
CAPSULE_LATE = 0.8
"""Probability that a boundary is a membrane, which ruptures late; where an organ's
name says so."""
SKIN = frozenset(("body", "skin", "lean", "fat"))
"""Words in the names of what begins at the skin: what nothing covers in front of it
is air."""
CAPSULES = frozenset(("liver", "spleen", "kidney"))
"""Words in the names of organs in a capsule (liver: Okamura 2004, doi
10.1109/TBME.2004.831542)."""
# By so much
LATE_m = 5e-3
LATE_STD_m = 2.5e-3
RUPTURE_STD_m = 0.1e-3
"""Of a rupture's depth: 0.03 mm, and 0.06 too high, in random stacks behind the
virtual sensor."""
CONTACT_STD_m = 0.15e-3
"""Of the depth of contact: 0.15 mm in 59 of 60 random stacks behind the virtual sensor;
in the last it was found 4.8 mm too high, in the air."""
TOGETHER = 0.5
"""Probability that the surface is off by the plan's offset: so it is where registration
errs, and not where organs have moved beneath the skin. Nobody knows beforehand which it
is."""
ALARM_m = 0.5e-3
"""Travel from a rupture to its alarm: of random stacks behind the virtual sensor
0.15 to 0.9 mm."""
MOST_m = 1.0  # Depth of a boundary; beyond it the unit is not the metre
BACK_m = 1e-3  # A tip so far above the deepest point is being withdrawn
OUTSIDE = "outside"
FALSE_ALARM = "a false alarm"
"""Where the tip is before the first boundary; what a rupture is that belongs to
none."""
NOTHING = Layer("", *[np.nan] * 4, is_obstacle=False)  # Behind the last boundary


class PlanState(NamedTuple):
    """What plan and ruptures say together; depths are those of the ruptures.

    Attributes:
        name: Of that layer, or `OUTSIDE` before the first tissue.
        probability: That the tip is in it.
        next_name: Of the layer behind the next boundary; empty behind the last.
        next_m: Depth at which it will be met; nan behind the last.
        matched_name: Of that layer; `FALSE_ALARM`; empty without ruptures.
        matched_probability: Of that.
        is_obstacle_next: Whether bone or cartilage comes next.
    """

    layer: (
        int  # index of the layer that the tip is in most likely; -1: before the first
    )
    name: str
    probability: float
    offset_m: (
        float  # how much deeper everything lies than planned: the posterior's median
    )
    offset_std_m: float
    next_name: str
    next_m: float
    next_std_m: float
    matched: (
        int  # index of the layer into which the last rupture most likely led; -1: none
    )
    matched_name: str
    matched_probability: float
    is_obstacle_next: bool


class PlanMatch:
    """Matches ruptures, in the order in which they came, with a plan.

    It remembers nothing: the same depths give the same answer, so
    `InsertionSession.follow` can take a false alarm back and go on from a snapshot.

    Args:
        layers: From `layers_along`, the first where the needle starts. `UNLABELLED` in
            front of ``body``, ``skin``, ``lean`` or ``fat`` is air: the surface is
            where that begins.
        offset_std_m: Standard deviation of the plan's error along the needle, as
            `Registration.std_along_m` gives it.

    Attributes:
        fingerprint: Identifies the plan: equal for equal plans.

    Raises:
        PlanError: No boundary in the plan, depths or deviations that cannot be, or not
            in metres.
    """

    def __init__(self, layers: Sequence[Layer], offset_std_m: float) -> None:
        if len(layers) < 2:
            raise PlanError(f"the plan has {len(layers)} layers: expected two or more")
        require_deviation("offset_std_m", offset_std_m, PlanError)
        self.layers = tuple(layers)
        # Air in front of the skin is no layer: boundaries lie in front of each from the
        # first tissue on, the first is the surface. Without a body among the labels it
        # is tissue, too.
        is_air = layers[0].name == UNLABELLED and SKIN & words(layers[1].name)
        self._first = 1 if is_air else 0
        bounds = [(float(layer.entry_m), float(layer.entry_std_m)) for layer in layers]
        names = [(layer.name, layer.is_obstacle) for layer in layers]
        made_of = repr((names, bounds, float(offset_std_m)))
        self.fingerprint = sha256(made_of.encode()).hexdigest()[:16]
        bound_m, bound_std_m = np.array(bounds).T
        depths_m = np.append(bound_m, layers[-1].exit_m)
        is_plan = np.all(np.abs(depths_m) < MOST_m) and np.all(np.diff(depths_m) >= 0.0)
        if not is_plan or not np.all((bound_std_m >= 0.0) & (bound_std_m < MOST_m)):
            raise PlanError(
                f"boundaries at {depths_m.tolist()} m, deviations {bound_std_m.tolist()}: expected "
                f"depths that grow, in metres and below {MOST_m:g}, and no negative deviation"
            )
        self._offset_std_m = float(offset_std_m)
        tissue = self.layers[self._first :]
        self._bound_m = bound_m[self._first :]
        bound_std_m = bound_std_m[self._first :]
        self._contact_std_m = float(np.hypot(bound_std_m[0], CONTACT_STD_m))
        missed, late = _chances([layer.name.lower() for layer in tissue])
        self._kind = np.array([1.0 - late, late])[:, :, None]
        self._missed = missed[:, None]
        half = round(REACH * offset_std_m / GRID_m)
        self._offset_m = GRID_m * np.arange(-half, half + 1)
        at_once_m = self._bound_m[:, None] + self._offset_m
        std_m = np.hypot(bound_std_m, RUPTURE_STD_m)
        std_m[0] = np.hypot(std_m[0], offset_std_m)  # the surface, see `TOGETHER`
        first = np.zeros((len(tissue) + 1, len(self._offset_m)))
        first[0] = _student(self._offset_m / offset_std_m)
        self._untouched = _Expected(
            first / first.sum(), *_at_once_and_late(at_once_m, std_m)
        )

    def state(
        self,
        depth_m: float,
        ruptures_m: Sequence[float] = (),
        *,
        contact_m: float | None = None,
        deepest_m: float | None = None,
        entry_depth_m: float = 0.0,
    ) -> PlanState:
        """What is known with the tip at a depth: also that nothing ruptured there
        counts.

        A boundary that should have ruptured long ago has been missed, or lies deeper.

        Args:
            depth_m: Of the tip.
            ruptures_m: Depths of all ruptures so far, in the order in which they came.
            contact_m: At which the tip met the surface; None where that is not known.
            deepest_m: Where the tip has been before it was withdrawn; by default
                ``depth_m``.
            entry_depth_m: Depth, from where the others count, of the plan's entry
                point.

        Raises:
            PlanError: A depth that is not finite, or of a rupture more than 1 mm above
                the one before.
        """
        if not np.isfinite(
            [depth_m, deepest_m or 0.0, contact_m or 0.0, entry_depth_m]
        ).all():
            given = f"tip at {depth_m!r} m, deepest {deepest_m!r} m, contact at {contact_m!r} m"
            raise PlanError(
                f"{given}, entry at {entry_depth_m!r} m: expected finite depths"
            )
        ruptures = [float(one_m) - entry_depth_m for one_m in ruptures_m]
        first = self._first
        depth = float(depth_m) - entry_depth_m
        names = [OUTSIDE] * first + [one.name for one in self.layers[first:]]
        deepest = (
            depth if deepest_m is None else max(float(deepest_m) - entry_depth_m, depth)
        )
        expected = self._expected(
            None if contact_m is None else contact_m - entry_depth_m
        )
        ahead = self._ahead(expected, deepest)
        weight, false = self._after(expected, ruptures)
        joint = _joint(ahead, weight)
        is_back = depth < deepest - BACK_m
        by_layer = self._withdrawn(joint, depth) if is_back else joint.sum(axis=1)
        layer = int(np.argmax(by_layer)) + first - 1
        # The median: where two assignments compete, their mean is what neither says.
        middle = self._quantile_m(joint, 0.5)
        variance = float((joint @ (self._offset_m - middle) ** 2).sum())
        after = (*self.layers, NOTHING)[layer + 1]
        matched, likely = _matched(ahead, weight, false, first)
        return PlanState(
            layer=layer,
            name=[OUTSIDE, *names][layer + 1],
            probability=float(by_layer.max()),
            offset_m=middle,
            offset_std_m=float(np.sqrt(variance)),
            next_name=after.name,
            next_m=float(after.entry_m + middle + entry_depth_m),
            next_std_m=float(np.sqrt(variance + after.entry_std_m**2)),
            matched=matched,
            matched_name=[FALSE_ALARM, *names][matched + 1] if ruptures else "",
            matched_probability=likely,
            is_obstacle_next=after.is_obstacle,
        )

    def interval_m(
        self,
        depth_m: float,
        ruptures_m: Sequence[float] = (),
        level: float = 0.95,
        *,
        contact_m: float | None = None,
    ) -> tuple[float, float]:
        """Offsets between which the true one lies with that probability, see `state`.

        Raises:
            PlanError: As `state`, or a level that is not between 0 and 1.
        """
        if not np.isfinite([depth_m, contact_m or 0.0]).all() or not 0.0 < level < 1.0:
            given = f"tip at {depth_m!r} m, contact at {contact_m!r} m, level {level!r}"
            raise PlanError(
                f"{given}: expected finite depths, and a level between 0 and 1"
            )
        expected = self._expected(contact_m)
        beyond = 0.5 - 0.5 * level
        joint = _joint(
            self._ahead(expected, depth_m), self._after(expected, ruptures_m)[0]
        )
        return self._quantile_m(joint, beyond), self._quantile_m(joint, 1.0 - beyond)

    def _quantile_m(self, joint: Array, part: float) -> float:
        """Offset below which so much of the probability lies."""
        each = joint.sum(axis=0)
        return float(np.interp(part, np.cumsum(each) - 0.5 * each, self._offset_m))

    def _withdrawn(self, joint: Array, depth_m: float) -> Array:
        """How likely so many boundaries lie above a tip that comes back from further
        below.
        """
        passed = np.arange(len(joint))[:, None]
        above = np.searchsorted(self._bound_m, depth_m - self._offset_m, "right")
        counts = np.bincount(
            np.minimum(passed, above).ravel(), joint.ravel(), len(joint)
        )
        return counts.astype(float, copy=False)

    def _expected(self, contact_m: float | None) -> "_Expected":
        """What is expected of the ruptures, with the surface met there, or not
        known.
        """
        weight, rupture_m, std_m = self._untouched
        if contact_m is None:
            return self._untouched
        off_m = contact_m - self._bound_m[0]
        std = self._contact_std_m
        together = (
            np.exp(-0.5 * ((off_m - self._offset_m) / std) ** 2)
            / std
            / np.sqrt(2.0 * np.pi)
        )
        alone_m = np.hypot(std, self._offset_std_m)
        alone = _student(off_m / alone_m) / alone_m
        weight = weight * (TOGETHER * together + (1.0 - TOGETHER) * alone)
        # A membrane on it, where there is one, is pushed in from there, wherever it was
        # planned.
        rupture_m = rupture_m.copy()
        std_m = std_m.copy()
        met_m, met_std_m = _at_once_and_late(contact_m, CONTACT_STD_m)
        rupture_m[:, 0] = met_m[:, None]
        std_m[:, 0] = met_std_m
        return _Expected(weight / weight.sum(), rupture_m, std_m)

    def _after(
        self, expected: "_Expected", ruptures_m: Sequence[float]
    ) -> tuple[Array, Array]:
        """Weights after ruptures, and the part of them in which the last one was a
        false alarm.
        """
        weight, rupture_m, std_m = expected
        false = weight
        last_m = -np.inf
        for depth_m in ruptures_m:
            if not np.isfinite(depth_m) or depth_m < last_m - 1e-3:
                raise PlanError(f"rupture at {depth_m!r} m after one at {last_m:.4f} m")
            last_m = max(last_m, depth_m)
            false = FALSE_PER_m * weight
            here = -0.5 * ((depth_m - rupture_m) / std_m) ** 2
            density = (self._kind * np.exp(here) / (np.sqrt(2.0 * np.pi) * std_m)).sum(
                axis=0
            )
            came = _arriving(weight, self._missed)[:-1] * (1.0 - self._missed) * density
            weight = false + np.vstack((np.zeros_like(came[:1]), came))
            total = weight.sum()
            weight = weight / total
            false = false / total
        return weight, false

    def _ahead(self, expected: "_Expected", depth_m: float) -> tuple[Array, Array]:
        """How likely a boundary is not felt yet, or was passed unnoticed, with the
        tip there.
        """
        later = ndtr((expected.rupture_m - depth_m + ALARM_m) / expected.std_m)
        waiting = (self._kind * later).sum(axis=0)
        passed = self._missed * (expected.rupture_m[0] <= depth_m)
        return (1.0 - self._missed) * waiting + self._missed - passed, passed


class _Expected(NamedTuple):
    """What is known before the first rupture, for each offset (columns).

    Attributes:
        weight: rows: the last boundary matched, the first for none.
        std_m: Of those (2, boundaries, 1).
    """

    weight: Array
    rupture_m: (
        Array  # where a boundary ruptures at once, and late (2, boundaries, offsets)
    )
    std_m: Array


def _student(x: Any) -> Any:
    """Density of Student's t, 3 degrees: a deviation stated too small does not
    deceive.
    """
    return 6.0 * np.sqrt(3.0) / np.pi / (3.0 + x * x) ** 2


def _at_once_and_late(place_m: Any, std_m: Any) -> tuple[Array, Array]:
    """Where boundaries rupture, at once and as membranes (rows), and the deviations
    of that.
    """
    both_m = np.array([std_m, np.hypot(std_m, LATE_STD_m)])[..., None]
    return np.array([place_m, place_m + LATE_m]), both_m


def _chances(names: list[str]) -> tuple[Array, Array]:
    """Of each boundary how likely it ruptures unnoticed, and how likely it ruptures
    late.
    """
    missed = np.full(len(names), MISSED)
    late = np.full(len(names), LATE)
    for k, name in enumerate(names):
        if name not in names[:k] and CAPSULES & words(name):
            late[k] = CAPSULE_LATE
        elif k and "fat" in words(names[k - 1]):
            missed[k] = SOFT_MISSED
    missed[0] = ENTRY_MISSED
    late[0] = 1.0
    return missed, late


def _joint(ahead: tuple[Array, Array], weight: Array) -> Array:
    """Probability of so many boundaries passed (rows) and each offset."""
    stands, slips = ahead
    joint = _arriving(weight, slips)
    joint[:-1] *= stands
    total = joint.sum()
    # Where nothing explains it, what was known before stays.
    return joint / total if total > 0.0 else weight


def _matched(
    ahead: tuple[Array, Array], weight: Array, false: Array, first: int
) -> tuple[int, float]:
    """Into which layer the last rupture led, -1 for a false alarm, and how likely."""
    # Whichever it was: what lies behind it was passed without another rupture.
    unfelt = np.ones_like(weight)
    for boundary, (stands, slips) in reversed(
        list(enumerate(zip(*ahead, strict=True)))
    ):
        unfelt[boundary] = stands + slips * unfelt[boundary + 1]
    likely = ((weight - false) * unfelt).sum(axis=1)
    likely[0] = (false * unfelt).sum()
    best = int(np.argmax(likely))
    return best - 1 + first * (best > 0), float(
        likely[best] / max(likely.sum(), 1e-300)
    )


def _arriving(weight: Array, slips: Array) -> Array:
    """Weight in front of each boundary, the last row behind all: also what slipped
    past others.
    """
    came = weight.copy()
    for boundary, slip in enumerate(slips):
        came[boundary + 1] += slip * came[boundary]
    return came
