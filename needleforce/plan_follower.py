"""The plan beside a session: the ruptures of the session are matched with it."""

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from foundation.arrays import Array
from identification import Estimate, Rupture
from needleforce.needle_on_plan import (
    PlanDeviation,
    PlannedEntry,
    PlannedPath,
    Surroundings,
    describe_to_target,
    describe_too_near,
)
from needleforce.session_event import SessionEvent
from residual.tool_kinematics import ToolKinematics

if TYPE_CHECKING:
    from needleforce.anatomy import NeedleClearance, PlanState


class Plan(Protocol):
    """Interface of a plan to follow; `needleforce.anatomy.PlanMatch` is one.

    Attributes:
        fingerprint: Text that is equal for equal plans.
        offset_std_m: Standard deviation of the plan's error along the needle.
    """

    fingerprint: str
    offset_std_m: float

    def off_plan_state(self) -> "PlanState":
        """Return the state while the needle is off the plan: it names no layer."""
        ...

    def state(
        self,
        depth_m: float,
        ruptures_m: tuple[float, ...],
        *,
        contact_m: float | None,
        deepest_m: float,
        entry_depth_m: float,
    ) -> "PlanState":
        """Return the state of plan and ruptures with the tip at a depth.

        Equal depths always give an equal state.

        Args:
            depth_m: Depth of the tip [m].
            ruptures_m: Depths of the ruptures, in the order in which they came [m].
            contact_m: Depth of first contact [m]; None before contact.
            deepest_m: Largest depth of the tip so far [m].
            entry_depth_m: Depth of the plan's entry point [m].
        """
        ...


class MatchedRupture(NamedTuple):
    """A rupture that counts for the plan.

    Attributes:
        alarm_s: Time of its alarm, by which a retraction finds it.
        depth_m: Depth of the rupture.
    """

    alarm_s: float
    depth_m: float


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
    ruptures: tuple[MatchedRupture, ...] = ()
    depth_m: float | None = None
    deepest_m: float = 0.0
    contact_m: float | None = None
    is_past_target: bool = False
    near: frozenset[str] = frozenset()


class PlanFollower:
    """Brings the events of a session to a plan; without a plan it does nothing.

    Args:
        plan: The plan; None for none.
        path: The planned path in the robot's base, or its entry alone; None where the
            plan's depths count from where the session's do.
        surroundings: The structures at risk around the path, if they are known.

    Attributes:
        has_plan: Whether there is a plan to match ruptures with.
        has_path: Whether there is a path, or an entry, to compare the needle with.
        memory: Immutable.
        state: Result of the last evaluation; None without a plan, or before the first.
        deviation: The needle against the planned path; None without a path.
        clearances: How near the needle and its way ahead come to structures at risk.
        reported_state: The state; while the needle is off the plan one that names no
            layer.
        entry_depth_m: Depth of the plan's entry; None without one.
    """

    def __init__(
        self,
        plan: Plan | None,
        path: PlannedPath | PlannedEntry | None,
        surroundings: Surroundings | None = None,
    ) -> None:
        self._surroundings = surroundings
        self.clearances: tuple[NeedleClearance, ...] = ()
        self._plan = plan
        self._path = path
        self.has_plan = plan is not None
        self.has_path = path is not None
        self._entry_m = None if path is None else path.entry_m
        entry = "" if path is None else f" along {path.fingerprint}"
        self.deviation: PlanDeviation | None = None
        self._events: list[SessionEvent] = []
        fingerprint = "" if plan is None else plan.fingerprint + entry
        self.resume(PlanMemory(fingerprint), None)

    def compare_with(self, tool: ToolKinematics) -> None:
        """Compare the needle, where the tool has it now, with the planned path."""
        if self._path is not None:
            pose = tool.pose
            axis = pose[:3, :3].dot(tool.axis_in_tool)
            self.deviation = self._path.deviation(pose[:3, 3], axis)
            self._watch_target(self.deviation)
            if self._surroundings is not None:
                found = self._surroundings.clearances(pose[:3, 3], axis)
                self.clearances = tuple(found)
                self._watch_clearances()
            self._report()

    def _watch_target(self, deviation: PlanDeviation) -> None:
        """Report once that the tip is past the target, anew after it was above it."""
        was_past = self.memory.is_past_target
        if deviation.is_past_target and not was_past:
            self.memory = self.memory._replace(is_past_target=True)
            event = SessionEvent(
                kind="past_target",
                text=f"PAST THE TARGET: the tip is {describe_to_target(deviation)}",
                values={
                    "to_target_m": deviation.to_target_m,
                    "to_target_std_m": deviation.to_target_std_m,
                },
            )
            self._events.append(event)
        elif was_past and deviation.to_target_m > 0.0:
            self.memory = self.memory._replace(is_past_target=False)

    def _watch_clearances(self) -> None:
        """Report once that a structure is too near, anew after it was not."""
        near = {one.name: one for one in self.clearances if one.is_too_near}
        if near.keys() == self.memory.near:
            return
        for name in near.keys() - self.memory.near:
            clearance = near[name]
            event = SessionEvent(
                kind="too_near",
                text=describe_too_near(clearance),
                values={
                    "distance_m": clearance.distance_m,
                    "needed_m": clearance.needed_m,
                    "std_m": clearance.std_m,
                },
            )
            self._events.append(event)
        self.memory = self.memory._replace(near=frozenset(near))

    def take_events(self) -> tuple[SessionEvent, ...]:
        """Return the events since the last call."""
        if not self._events:
            return ()
        events = tuple(self._events)
        self._events.clear()
        return events

    def begin(
        self,
        start_in_base_m: Array,
        axis: Array,
        ruptures: tuple[Rupture, ...] = (),
    ) -> None:
        """Begin an insertion: count depth from a point along an axis.

        Args:
            start_in_base_m: Position of the tip at depth zero, shape (3,).
            axis: Direction of the needle in base axes, shape (3,).
            ruptures: Those of the channel in which the needle goes on.
        """
        known = tuple(MatchedRupture(each.alarm_s, each.depth_m) for each in ruptures)
        self._begin_with(start_in_base_m, axis, known)

    def move_zero(self, start_in_base_m: Array, axis: Array, moved_m: float) -> None:
        """Count depth from another point in the same insertion.

        Args:
            start_in_base_m: Position of the tip at depth zero, shape (3,).
            axis: Direction of the needle in base axes, shape (3,).
            moved_m: Depth of a place from there less its depth before.
        """
        ruptures = tuple(
            rupture._replace(depth_m=rupture.depth_m + moved_m)
            for rupture in self.memory.ruptures
        )
        self._begin_with(start_in_base_m, axis, ruptures)

    def _begin_with(
        self,
        start_in_base_m: Array,
        axis: Array,
        ruptures: tuple[MatchedRupture, ...],
    ) -> None:
        """Count depth from a point along an axis, and match these ruptures."""
        entry_depth_m = 0.0
        if self._entry_m is not None:
            entry_depth_m = float(axis.dot(self._entry_m - start_in_base_m))
        memory = PlanMemory(
            self.memory.fingerprint,
            entry_depth_m,
            ruptures,
            is_past_target=self.memory.is_past_target,
            near=self.memory.near,
        )
        self.resume(memory, None)

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
        has_moved = memory.depth_m is None or abs(depth_m - memory.depth_m) >= step_m
        if ruptures == memory.ruptures and not has_moved:
            return
        was_evaluated = memory.depth_m is not None
        memory = memory._replace(
            ruptures=ruptures,
            depth_m=depth_m,
            deepest_m=max(memory.deepest_m, depth_m) if was_evaluated else depth_m,
            contact_m=contact_m,
        )
        self.resume(memory, self.evaluate(memory))

    def evaluate(self, memory: PlanMemory) -> "PlanState | None":
        """Return what the plan makes of the depths in ``memory``."""
        if self._plan is None or memory.depth_m is None:
            return None
        return self._plan.state(
            memory.depth_m,
            tuple(rupture.depth_m for rupture in memory.ruptures),
            contact_m=memory.contact_m,
            deepest_m=memory.deepest_m,
            entry_depth_m=memory.entry_depth_m,
        )

    def resume(self, memory: PlanMemory, state: "PlanState | None") -> None:
        """Continue from ``memory`` and the state that `evaluate` makes of it."""
        self.memory = memory
        self.state: PlanState | None = state
        self.entry_depth_m = None if self._entry_m is None else memory.entry_depth_m
        self._report()

    def _report(self) -> None:
        """Keep the state to report, after it or the deviation has changed."""
        self.reported_state = self.state
        deviation = self.deviation
        is_off_plan = deviation is not None and deviation.is_off_plan
        if self._plan is not None and self.state is not None and is_off_plan:
            self.reported_state = self._plan.off_plan_state()


def _after_events(
    ruptures: tuple[MatchedRupture, ...], identification: Estimate
) -> tuple[MatchedRupture, ...]:
    """Return the ruptures after the events of a sample: one retracted, one added.

    A needle that is pushed in again may rupture what it has ruptured before: a rupture
    above an earlier one is not added.
    """
    retracted = identification.retracted
    if retracted is not None:
        ruptures = tuple(r for r in ruptures if r.alarm_s != retracted.alarm_s)
    rupture = identification.rupture
    if rupture is not None and all(rupture.depth_m >= r.depth_m for r in ruptures):
        ruptures = (*ruptures, MatchedRupture(rupture.alarm_s, rupture.depth_m))
    return ruptures
