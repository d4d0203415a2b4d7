"""The plan and the ruptures correct each other.

The plan says at which depths boundaries lie, up to an offset along the needle that
registration left; ruptures say where the needle went through one, but not through
which, and contact where the first one lies. Some boundaries rupture without being
noticed, some alarms are false, and a membrane ruptures only after it was pushed in.

Bayes over two unknowns: the offset of the plan along the needle, on a grid, and the
boundary that the last rupture was, by the forward recursion over assignments that keep
the order. Arrays of shape (boundaries + 1, offsets) have a row for each boundary that
may have been the last one matched, the first row for none.
"""

from collections.abc import Iterable, Sequence
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from foundation.arrays import Array
from needleforce.anatomy.errors import (
    OTHER_PATH,
    PlanError,
    require_deviation,
)
from needleforce.anatomy.path_layers import UNLABELLED, Layer
from needleforce.anatomy.volume import words_of

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


SKIN = frozenset(("body", "skin", "lean", "fat"))
"""Words in the names of what begins at the skin: what nothing covers in front of it
is air."""


OUTSIDE = "outside"
"""Where the tip is before the first boundary."""

FALSE_ALARM = "a false alarm"
"""What a rupture is that belongs to no boundary."""

OFF_PLAN = "off plan"
"""Name while the needle is beside the planned path."""

OFF_PLAN_LAYER = -2
"""Index of the layer while the needle is beside the planned path."""


class PlanState(NamedTuple):
    """What plan and ruptures say together; depths are those of the ruptures.

    Attributes:
        layer: Index of the layer that the tip is in most likely; -1 before the first,
            -2 where the needle is off the plan, and nothing else counts.
        name: Of that layer, `OUTSIDE` before the first tissue, or `OFF_PLAN`.
        probability: That the tip is in it.
        offset_m: How much deeper everything lies than planned: the posterior's median.
        offset_std_m: Its standard deviation.
        next_name: Of the layer behind the next boundary; empty behind the last.
        next_m: Depth at which it will be met; nan behind the last.
        next_std_m: Its standard deviation.
        matched: Index of the layer into which the last rupture most likely led; -1 for
            none.
        matched_name: Of that layer; `FALSE_ALARM`; empty without ruptures.
        matched_probability: Of that.
        is_obstacle_next: Whether bone or cartilage comes next.
    """

    layer: int
    name: str
    probability: float
    offset_m: float
    offset_std_m: float
    next_name: str
    next_m: float
    next_std_m: float
    matched: int
    matched_name: str
    matched_probability: float
    is_obstacle_next: bool


class _Expected(NamedTuple):
    """Where ruptures are expected, and how likely offsets are, before the first one.

    Attributes:
        weight: Of each offset, in the first row, (boundaries + 1, offsets).
        rupture_m: Where a boundary ruptures at once, and late, (2, boundaries,
            offsets).
        std_m: Of these depths, (2, boundaries, 1).
    """

    weight: Array
    rupture_m: Array
    std_m: Array


class PlanMatch:
    """Matches ruptures, in the order in which they came, with a plan.

    It has no memory: the same depths give the same answer, so
    `InsertionSession.follow` can retract a false alarm and go on from a snapshot.

    Args:
        layers: From `layers_along`, the first where the needle starts. `UNLABELLED` in
            front of ``body``, ``skin``, ``lean`` or ``fat`` is air: the surface is
            where that begins.
        offset_std_m: Standard deviation of the plan's error along the needle, as
            `Registration.std_along_m` gives it.
        accepted_obstacles: Names of bones and cartilages that the needle is meant to
            go through.

    Attributes:
        layers: The same.
        offset_std_m: The same.
        fingerprint: Identifies the plan: equal for equal plans.

    Raises:
        PlanError: No boundary in the plan, depths or deviations that cannot be, or not
            in metres; an obstacle that is not accepted.
    """

    def __init__(
        self,
        layers: Sequence[Layer],
        offset_std_m: float,
        *,
        accepted_obstacles: Iterable[str] = (),
    ) -> None:
        # Of a rupture's depth: 0.03 mm, and 0.06 too high, in random stacks behind the
        # virtual sensor.
        rupture_std_m = 0.1e-3
        # Of the offsets: that of the ruptures' own deviation.
        grid_m = 0.1e-3
        reach = 5.0  # of the grid, in standard deviations of the offset
        require_deviation("offset_std_m", offset_std_m, PlanError)
        _require_layers(layers, frozenset(accepted_obstacles))
        self.offset_std_m = float(offset_std_m)
        self.layers = tuple(layers)
        names = [(layer.name, layer.is_obstacle) for layer in layers]
        bounds_m = np.array([(one.entry_m, one.entry_std_m) for one in layers], float)
        plan = repr((names, [*map(tuple, bounds_m.tolist())], self.offset_std_m))
        self.fingerprint = sha256(plan.encode()).hexdigest()[:16]
        # Air in front of the skin is no layer: boundaries lie in front of each from the
        # first tissue on, the first is the surface. Without a body among the labels it
        # is tissue, too.
        has_air = layers[0].name == UNLABELLED and SKIN & words_of(layers[1].name)
        self._first = 1 if has_air else 0
        self._bound_m, bound_std_m = bounds_m[self._first :].T
        missed, late = _chances([one.name.lower() for one in layers[self._first :]])
        self._missed = missed[:, None]
        self._at_once_and_late = np.array([1.0 - late, late])[:, :, None]
        half = round(reach * self.offset_std_m / grid_m)
        self._offset_m: Array = grid_m * np.arange(-half, half + 1.0)
        std_m = np.hypot(bound_std_m, rupture_std_m)
        # Of the surface, see `_meet`.
        std_m[0] = np.hypot(std_m[0], self.offset_std_m)
        prior = _student_density(self._offset_m / self.offset_std_m)
        # Where a boundary ruptures at once, and late: (2, boundaries, offsets).
        at_once_m = self._bound_m[:, None] + self._offset_m
        self._unmet = _Expected(
            weight=np.pad((prior / prior.sum())[None], ((0, len(missed)), (0, 0))),
            rupture_m=np.array([at_once_m, at_once_m + LATE_m]),
            std_m=np.array([std_m, np.hypot(std_m, LATE_STD_m)])[..., None],
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
        """Return what is known with the tip at a depth.

        It also counts that nothing ruptured there: a boundary that should have ruptured
        long ago has been missed, or lies deeper.

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
        withdrawn_m = 1e-3  # a tip so far above the deepest point is being withdrawn
        # What lies behind the last boundary.
        behind_all = Layer("", *[np.nan] * 4, is_obstacle=False)
        if not np.isfinite(
            [depth_m, deepest_m or 0, contact_m or 0, entry_depth_m]
        ).all():
            raise PlanError(
                f"depths of tip {depth_m}, deepest point {deepest_m}, contact "
                f"{contact_m}, entry {entry_depth_m} m: expected finite ones"
            )
        tip_m = float(depth_m) - entry_depth_m
        lowest_tip_m = depth_m if deepest_m is None else float(deepest_m)
        lowest_m = max(lowest_tip_m - entry_depth_m, tip_m)
        expected = self._unmet
        if contact_m is not None:
            expected = self._meet(contact_m - entry_depth_m)
        ruptures = [float(rupture_m) - entry_depth_m for rupture_m in ruptures_m]
        joint, by_matched = self._infer(expected, lowest_m, ruptures)
        matched = int(np.argmax(by_matched)) - 1
        by_passed = joint.sum(axis=1)
        if tip_m < lowest_m - withdrawn_m:
            by_passed = self._withdraw(joint, tip_m)
        layer = int(np.argmax(by_passed)) + self._first - 1
        # The median: where two assignments compete, their mean is what neither says.
        marginal = joint.sum(axis=0)
        cumulative = np.cumsum(marginal) - 0.5 * marginal
        offset_m = float(np.interp(0.5, cumulative, self._offset_m))
        variance_m2 = float(marginal @ (self._offset_m - offset_m) ** 2)
        next_layer = (*self.layers, behind_all)[layer + 1]
        matched += self._first * (matched >= 0)
        return PlanState(
            layer=layer,
            name=self._name(layer),
            probability=float(by_passed.max()),
            offset_m=offset_m,
            offset_std_m=float(np.sqrt(variance_m2)),
            next_name=next_layer.name,
            next_m=float(next_layer.entry_m + offset_m + entry_depth_m),
            next_std_m=float(np.sqrt(variance_m2 + next_layer.entry_std_m**2)),
            matched=matched,
            matched_name=self._name(matched, FALSE_ALARM) if ruptures else "",
            matched_probability=float(by_matched.max()),
            is_obstacle_next=next_layer.is_obstacle,
        )

    def off_plan_state(self) -> PlanState:
        """Return the state while the needle is off the plan: it names no layer."""
        return PlanState(
            layer=OFF_PLAN_LAYER,
            name=OFF_PLAN,
            probability=0.0,
            offset_m=0.0,
            offset_std_m=self.offset_std_m,
            next_name="",
            next_m=float("nan"),
            next_std_m=self.offset_std_m,
            matched=-1,
            matched_name="",
            matched_probability=0.0,
            is_obstacle_next=False,
        )

    def _name(self, layer: int, none: str = OUTSIDE) -> str:
        """Return the name of a layer; `OUTSIDE` for air, ``none`` for -1."""
        if layer < 0:
            return none
        return OUTSIDE if layer < self._first else self.layers[layer].name

    def _meet(self, contact_m: float) -> "_Expected":
        """Return what is expected where the surface was met at a depth."""
        # Probability that the surface is off by the plan's offset: so it is where
        # registration errs, and not where organs have moved beneath the skin. Nobody
        # knows beforehand which it is.
        together = 0.5
        surface_m = contact_m - self._bound_m[0]
        bound_std_m = self.layers[self._first].entry_std_m
        surface_std_m = float(np.hypot(bound_std_m, CONTACT_STD_m))
        alone_std_m = np.hypot(surface_std_m, self.offset_std_m)
        alone = _student_density(surface_m / alone_std_m) / alone_std_m
        off = _normal_density(surface_m - self._offset_m, surface_std_m)
        weight = self._unmet.weight * (together * off + (1.0 - together) * alone)
        # A membrane on the surface is pushed in from there, wherever it was planned.
        rupture_m = self._unmet.rupture_m.copy()
        rupture_m[:, 0] = np.array([[contact_m], [contact_m + LATE_m]])
        std_m = self._unmet.std_m.copy()
        std_m[:, 0, 0] = CONTACT_STD_m, np.hypot(CONTACT_STD_m, LATE_STD_m)
        return _Expected(weight / weight.sum(), rupture_m, std_m)

    def _infer(
        self, expected: "_Expected", deepest_m: float, ruptures_m: Sequence[float]
    ) -> tuple[Array, Array]:
        """Return what is known with the tip as deep as it has been.

        Args:
            expected: Before the first rupture.
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
        later = ndtr((expected.rupture_m - deepest_m + alarm_m) / expected.std_m)
        passed = self._missed * (expected.rupture_m[0] <= deepest_m)
        waiting = (1.0 - self._missed) * (self._at_once_and_late * later).sum(axis=0)
        waiting = waiting + self._missed - passed
        weight, false_alarm = self._weigh(expected, ruptures_m)
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

    def _weigh(
        self, expected: "_Expected", ruptures_m: Sequence[float]
    ) -> tuple[Array, Array]:
        """Return the probabilities of each assignment and offset after ruptures.

        The second array is the part in which the last rupture was a false alarm.
        """
        # A rupture may lie so far above the one before it: depths are estimates.
        order_tolerance_m = 1e-3
        false_per_m = 0.5  # false alarms per metre of travel
        weight = false_alarm = expected.weight
        deepest_m = -np.inf
        for depth_m in ruptures_m:
            if not deepest_m - order_tolerance_m <= depth_m < np.inf:
                raise PlanError(
                    f"rupture at {depth_m!r} m after one at {deepest_m:.4f} m"
                )
            deepest_m = max(deepest_m, depth_m)
            off_m = depth_m - expected.rupture_m
            densities = self._at_once_and_late * _normal_density(off_m, expected.std_m)
            in_front = _sum_in_front(weight, self._missed)[:-1]
            matched = in_front * (1.0 - self._missed) * densities.sum(axis=0)
            false_alarm = false_per_m * weight
            weight = false_alarm + np.pad(matched, ((1, 0), (0, 0)))
            false_alarm = false_alarm / weight.sum()
            weight = weight / weight.sum()
        return weight, false_alarm

    def _withdraw(self, joint: Array, depth_m: float) -> Array:
        """Return how likely each number of boundaries lies above a withdrawn tip.

        Args:
            joint: Probabilities by boundaries passed and offset.
            depth_m: Of the tip, which has been deeper.
        """
        above = np.searchsorted(self._bound_m, depth_m - self._offset_m, "right")
        counted = np.minimum(np.arange(len(joint))[:, None], above)
        counts = np.bincount(counted.ravel(), joint.ravel(), len(joint))
        return np.asarray(counts, dtype=np.float64)


def _require_layers(layers: Sequence[Layer], accepted: frozenset[str]) -> None:
    """Refuse what is no plan: depths that do not grow or are not in metres, bone.

    Args:
        layers: The plan's.
        accepted: Names of obstacles that the needle may go through.
    """
    max_depth_m = 1.0  # of a boundary; beyond it the unit is not the metre
    if len(layers) < 2:
        raise PlanError(f"the plan has {len(layers)} layers: expected two or more")
    obstacles = [
        f"{layer.name} from {1e3 * layer.entry_m:.1f} to {1e3 * layer.exit_m:.1f} mm"
        for layer in layers
        if layer.is_obstacle and layer.name not in accepted
    ]
    if obstacles:
        raise PlanError(f"the path runs through {', '.join(obstacles)}", OTHER_PATH)
    depths_m = np.array([*(one.entry_m for one in layers), layers[-1].exit_m], float)
    stds_m = np.array([one.entry_std_m for one in layers], float)
    is_ordered = np.abs(depths_m).max() < max_depth_m and np.diff(depths_m).min() >= 0.0
    if not is_ordered or not 0.0 <= stds_m.min() <= stds_m.max() < max_depth_m:
        raise PlanError(
            f"boundaries at {depths_m.tolist()} m, deviations {stds_m.tolist()}: "
            f"expected depths that grow, in metres and below {max_depth_m:g}, and no "
            "negative deviation"
        )


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
