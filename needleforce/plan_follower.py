"""The plan beside a session: the ruptures of the session are matched with it."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from identification import Estimate, Rupture
from needleforce.insertion_events import SessionEvent
from needleforce.needle_on_plan import (
    PlanDeviation,
    PlannedPath,
    describe_to_target,
    describe_too_near,
)
from needleforce.tip_travel import TravelZero
from residual.tool_kinematics import ToolKinematics

if TYPE_CHECKING:
    from needleforce.anatomy import (
        NeedleClearance,
        NeedleSurroundings,
        PlanMatch,
        PlanState,
    )


class PlanMemory(NamedTuple):
    """State of a `PlanFollower`: the depths of its last evaluation.

    Attributes:
        fingerprint: Of plan and entry; empty without a plan.
        entry_depth_m: Depth of the plan's entry.
        ruptures: Ruptures that were not retracted, in the order in which they came.
        depth_m: Depth of the tip; None where the plan was not evaluated yet.
        deepest_m: Largest depth of the tip so far.
        contact_m: Depth of first contact; None where the surface has not been met.
        is_past_target: Whether it was reported that the tip is past the target.
        near: Names of the structures that were reported to be too near.
    """

    fingerprint: str
    entry_depth_m: float = 0.0
    ruptures: tuple[Rupture, ...] = ()
    depth_m: float | None = None
    deepest_m: float = 0.0
    contact_m: float | None = None
    is_past_target: bool = False
    near: frozenset[str] = frozenset()


class PlanFollower:
    """Brings the events of a session to a plan; without a plan it does nothing.

    Args:
        plan: The plan; None for none.
        path: The planned path in the robot's base; None where the plan's depths count
            from where the session's do.
        surroundings: The structures at risk around the path, if they are known.

    Attributes:
        memory: Immutable.
        state: Result of the last evaluation; None without a plan, or before the first.
        deviation: The needle against the planned path; None without a path.
        clearances: How near the needle and its way ahead come to structures at risk.
    """

    def __init__(
        self,
        plan: "PlanMatch | None",
        path: PlannedPath | None,
        surroundings: "NeedleSurroundings | None" = None,
    ) -> None:
        self._plan = plan
        self._path = path
        self._surroundings = surroundings
        self.deviation: PlanDeviation | None = None
        self.clearances: tuple[NeedleClearance, ...] = ()
        self._events: list[SessionEvent] = []
        prints = [one.fingerprint for one in (plan, path) if one is not None]
        self.resume(PlanMemory(" along ".join(prints)))

    @property
    def entry_depth_m(self) -> float | None:
        """Depth of the plan's entry; None without one."""
        return None if self._path is None else self.memory.entry_depth_m

    @property
    def reported_state(self) -> "PlanState | None":
        """The state; while the needle is off the plan one that names no layer."""
        is_off_plan = self.deviation is not None and self.deviation.is_off_plan
        if self._plan is None or self.state is None or not is_off_plan:
            return self.state
        return self._plan.off_plan_state()

    def compare_with(self, tool: ToolKinematics) -> None:
        """Compare the needle, where the tool has it now, with the planned path."""
        if self._path is None:
            return
        tip_m = tool.pose[:3, 3]
        axis = tool.pose[:3, :3].dot(tool.axis_in_tool)
        self.deviation = self._path.deviation(tip_m, axis)
        self._watch_target(self.deviation)
        if self._surroundings is not None:
            self.clearances = tuple(self._surroundings.clearances(tip_m, axis))
            self._watch_clearances()

    def _watch_target(self, deviation: PlanDeviation) -> None:
        """Report once that the tip is past the target, anew after it was above it."""
        was_past = self.memory.is_past_target
        is_past = deviation.is_past_target or (was_past and deviation.to_target_m <= 0)
        if is_past and not was_past:
            text = f"PAST THE TARGET: the tip is {describe_to_target(deviation)}"
            values = {
                "to_target_m": deviation.to_target_m,
                "to_target_std_m": deviation.to_target_std_m,
            }
            self._events.append(SessionEvent("past_target", text, values))
        self.memory = self.memory._replace(is_past_target=is_past)

    def _watch_clearances(self) -> None:
        """Report once that a structure is too near, anew after it was not."""
        near = {one.name: one for one in self.clearances if one.is_too_near}
        for name in near.keys() - self.memory.near:
            values = {
                "distance_m": near[name].distance_m,
                "needed_m": near[name].needed_m,
                "std_m": near[name].std_m,
            }
            text = describe_too_near(near[name])
            self._events.append(SessionEvent("too_near", text, values))
        self.memory = self.memory._replace(near=frozenset(near))

    def take_events(self) -> tuple[SessionEvent, ...]:
        """Return the events since the last call."""
        events = tuple(self._events)
        self._events.clear()
        return events

    def begin(self, zero: TravelZero, ruptures: Iterable[Rupture] = ()) -> None:
        """Begin an insertion: count depth from a point along an axis.

        Args:
            zero: Point and axis.
            ruptures: Those of the channel in which the needle goes on.
        """
        entry_depth_m = 0.0
        if self._path is not None:
            way_m = self._path.entry_m - zero.start_in_base_m
            entry_depth_m = float(zero.axis_in_base.dot(way_m))
        memory = self.memory
        self.resume(
            PlanMemory(
                memory.fingerprint,
                entry_depth_m,
                tuple(ruptures),
                is_past_target=memory.is_past_target,
                near=memory.near,
            )
        )

    def move_zero(self, zero: TravelZero, moved_m: float) -> None:
        """Count depth from another point in the same insertion.

        Args:
            zero: Point and axis.
            moved_m: Depth of a place from there less its depth before.
        """
        ruptures = self.memory.ruptures
        self.begin(zero, (replace(r, depth_m=r.depth_m + moved_m) for r in ruptures))

    def match(
        self, identification: Estimate, depth_m: float, contact_m: float | None
    ) -> None:
        """Match new events, and evaluate the plan after events or travel.

        Args:
            identification: Estimate of this sample, with its events.
            depth_m: Depth of the tip at this sample [m].
            contact_m: Depth of first contact [m]; None before contact.
        """
        # Travel after which the plan is evaluated again, besides at events. An
        # evaluation takes much longer than a tick.
        step_m = 0.1e-3
        if self._plan is None or not np.isfinite(depth_m):
            return
        memory = self.memory
        ruptures = _after_events(memory.ruptures, identification)
        before_m = memory.depth_m
        has_moved = before_m is None or abs(depth_m - before_m) >= step_m
        if has_moved or ruptures != memory.ruptures:
            deepest_m = depth_m if before_m is None else max(memory.deepest_m, depth_m)
            memory = memory._replace(
                ruptures=ruptures,
                depth_m=depth_m,
                deepest_m=deepest_m,
                contact_m=contact_m,
            )
            self.resume(memory)

    def resume(self, memory: PlanMemory) -> None:
        """Continue from ``memory``, with the state that the plan makes of it."""
        state: PlanState | None = None
        if self._plan is not None and memory.depth_m is not None:
            state = self._plan.state(
                memory.depth_m,
                tuple(rupture.depth_m for rupture in memory.ruptures),
                contact_m=memory.contact_m,
                deepest_m=memory.deepest_m,
                entry_depth_m=memory.entry_depth_m,
            )
        self.memory = memory
        self.state = state


def _after_events(
    ruptures: tuple[Rupture, ...], identification: Estimate
) -> tuple[Rupture, ...]:
    """Return the ruptures after the events of a sample: one retracted, one added.

    A needle that is pushed in again may rupture what it has ruptured before: a rupture
    above an earlier one is not added.
    """
    retracted = identification.retracted
    if retracted is not None:
        ruptures = tuple(r for r in ruptures if r.alarm_s != retracted.alarm_s)
    rupture = identification.rupture
    if rupture is not None and all(rupture.depth_m >= r.depth_m for r in ruptures):
        ruptures = (*ruptures, rupture)
    return ruptures
