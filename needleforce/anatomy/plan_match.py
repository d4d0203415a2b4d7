"""The plan and the ruptures correct each other.

The plan says at which depths boundaries lie, up to an offset along the needle that
registration left; ruptures say where the needle went through one, but not through
which, and contact where the first one lies. Some boundaries rupture without being
noticed, some alarms are false, and a membrane ruptures only after it was pushed in. See
`rupture_model` for the probabilities.
"""

from collections.abc import Iterable, Sequence
from hashlib import sha256
from typing import NamedTuple

import numpy as np

from needleforce.anatomy.errors import (
    OTHER_PATH,
    PlanError,
    require_deviation,
)
from needleforce.anatomy.path_layers import UNLABELLED, Layer
from needleforce.anatomy.rupture_model import RuptureModel
from needleforce.anatomy.structures import words_of

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
        self._model = RuptureModel(
            [layer.name for layer in self.layers[self._first :]],
            bounds_m[self._first :, 0],
            bounds_m[self._first :, 1],
            self.offset_std_m,
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
        model = self._model
        tip_m = float(depth_m) - entry_depth_m
        lowest_tip_m = depth_m if deepest_m is None else float(deepest_m)
        lowest_m = max(lowest_tip_m - entry_depth_m, tip_m)
        if contact_m is not None:
            model = model.met_at(contact_m - entry_depth_m)
        ruptures = [float(rupture_m) - entry_depth_m for rupture_m in ruptures_m]
        joint, by_matched = model.infer(lowest_m, ruptures)
        matched = int(np.argmax(by_matched)) - 1
        is_withdrawn = tip_m < lowest_m - withdrawn_m
        by_passed = model.withdraw(joint, tip_m) if is_withdrawn else joint.sum(axis=1)
        layer = int(np.argmax(by_passed)) + self._first - 1
        # The median: where two assignments compete, their mean is what neither says.
        offset_m = model.median_m(joint)
        variance_m2 = float((joint @ (model.offset_m - offset_m) ** 2).sum())
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
