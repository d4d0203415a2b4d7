"""The plan beside a session: ruptures are matched with it, false alarms taken back
from it.
"""

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from identification import Estimate, Identifier

if TYPE_CHECKING:
    from needleforce.anatomy import PlanState

STEP_m = 0.1e-3  # Travel after which the plan is read again, besides at events: it takes its time


class Plan(Protocol):
    """What a session needs of a plan; `needleforce.anatomy.PlanMatch` is one.

    Attributes:
        fingerprint: Of the plan: equal for equal plans.
    """

    fingerprint: str

    def state(
        self,
        depth_m: float,
        ruptures_m: tuple[float, ...],
        *,
        contact_m: float | None,
        deepest_m: float,
        entry_depth_m: float,
    ) -> "PlanState":
        """What is known with the tip at a depth; of the same depths always the same."""
        ...


class PlanMemory(NamedTuple):
    """What a session remembers of its plan: with what that was last read.

    Attributes:
        fingerprint: Of plan and entry; empty without a plan.
        entry_depth_m: Depth of the plan's entry.
        ruptures: Time of the alarm, depth [m].
        depth_m: None: not read yet.
        contact_m: None: the surface has not been met.
    """

    fingerprint: str
    entry_depth_m: float = 0.0
    ruptures: tuple[tuple[float, float], ...] = ()
    depth_m: float | None = None
    deepest_m: float = 0.0
    contact_m: float | None = None


class PlanFollower:
    """Takes a session's events to a plan; does nothing without one.

    Attributes:
        memory: Immutable.
        state: What the plan says; None without one, or not read yet.
    """

    def __init__(
        self, plan: Plan | None, entry_in_base_m: NDArray[np.float64] | None
    ) -> None:
        self._plan = plan
        self._entry_m = entry_in_base_m
        where = "" if entry_in_base_m is None else f" from {entry_in_base_m.tolist()}"
        self.memory = PlanMemory("" if plan is None else plan.fingerprint + where)
        self.state: PlanState | None = None

    def begin(
        self, start_in_base_m: NDArray[np.float64], axis: NDArray[np.float64]
    ) -> None:
        """Count depth from a point, and forget the ruptures."""
        above_m = (
            0.0 if self._entry_m is None else axis.dot(self._entry_m - start_in_base_m)
        )
        self.resume(PlanMemory(self.memory.fingerprint, float(above_m)), None)

    def follow(self, found: Estimate, depth_m: float, identifier: Identifier) -> None:
        """Take events to the plan, and read it where there was one or the tip has
        moved.
        """
        if self._plan is None or not np.isfinite(depth_m):
            return
        last = self.memory
        ruptures = self.memory.ruptures
        rupture = found.rupture
        if found.retracted is not None:
            wrong_s = found.retracted.alarm_s
            ruptures = tuple(one for one in ruptures if one[0] != wrong_s)
        # A needle that is pushed in again may rupture what it has ruptured before.
        if rupture is not None and all(
            rupture.depth_m >= depth_m for _, depth_m in ruptures
        ):
            ruptures = (*ruptures, (rupture.alarm_s, rupture.depth_m))
        is_same = ruptures == last.ruptures
        if (
            is_same
            and last.depth_m is not None
            and abs(depth_m - last.depth_m) < STEP_m
        ):
            return
        deepest_m = depth_m if last.depth_m is None else max(last.deepest_m, depth_m)
        entry = last.fingerprint, last.entry_depth_m
        memory = PlanMemory(
            *entry, ruptures, depth_m, deepest_m, identifier.contact_depth_m
        )
        self.resume(memory, self.read(memory))

    def read(self, memory: PlanMemory) -> "PlanState | None":
        """What the plan says with a memory."""
        if self._plan is None or memory.depth_m is None:
            return None
        return self._plan.state(
            memory.depth_m,
            tuple(depth_m for _, depth_m in memory.ruptures),
            contact_m=memory.contact_m,
            deepest_m=memory.deepest_m,
            entry_depth_m=memory.entry_depth_m,
        )

    def resume(self, memory: PlanMemory, state: "PlanState | None") -> None:
        """Go on from a memory and what `read` makes of it."""
        self.memory = memory
        self.state = state
