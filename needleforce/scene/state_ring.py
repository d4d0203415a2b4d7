"""What a control loop hands to a viewer in another process: rows in shared memory.

The memory is a ring with one writer, which never waits: it writes a row, then raises
the count. A reader that was too slow finds the rows it missed overwritten, and goes on
with the newest.
"""

import math
import struct
from contextlib import AbstractContextManager
from multiprocessing.shared_memory import SharedMemory
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from needleforce.depth_zero import ZERO_NAMES, find_depth_zero
from needleforce.insertion_events import session_events

ROWS = 4096
"""How many rows the ring has, four seconds at 1 kHz."""

_COUNT = struct.Struct("<Q")
"""How many rows were written, at the beginning of the memory."""


EVENTS = ("", "rupture", "hard_contact", "too_near", "past_target")
"""Kinds of events that a page tells by a sound, by number; of several in one tick the
last of these counts."""


class ViewRow(NamedTuple):
    """A tick of a session as it is shown, before the joint positions.

    The fields of the plan are those of a `PlanState`, NaN without a plan; the fields
    aside are those of a `PlanDeviation`, NaN without a planned path.

    Attributes:
        time_s: Of the session.
        depth_m: Of the tip.
        speed_m_s: Of the tip.
        force_N: Axial force.
        force_std_N: Standard deviation of the axial force.
        tip_N: Tip force.
        tip_std_N: Standard deviation of the tip force.
        friction_N: Shaft friction.
        enhanced_N: Axial force less the friction of the layers traversed.
        layer: Number of the layer that the tip is in.
        rupture: Number of the layer that ruptured in this tick, else 0.
        rupture_depth_m: Depth of that rupture.
        retracted: Number of the layer that did not rupture after all, else 0.
        is_good: 1 if the force is tared and of this tick, else 0.
        plan_layer: Number of the planned layer that the tip is in.
        plan_probability: Of being in that layer.
        plan_offset_m: How much deeper all lies than planned.
        plan_offset_std_m: Standard deviation of the offset.
        plan_next_m: Expected depth of the next boundary.
        plan_next_std_m: Standard deviation of that depth.
        plan_matched: Number of the planned layer that the latest rupture led into.
        plan_matched_probability: Of that match.
        aside_entry_m: Distance of the needle's line from the planned entry.
        aside_entry_std_m: Standard deviation of that distance.
        aside_tip_m: Distance of the tip from the planned line.
        aside_tip_std_m: Standard deviation of that distance.
        aside_angle_rad: Between the planned and the needle's direction.
        aside_angle_std_rad: Standard deviation of that angle.
        aside_to_target_m: From the tip to the target, negative past it.
        aside_to_target_std_m: Standard deviation of that distance.
        aside_is_off_plan: 1 if the needle is off the plan, else 0.
        aside_is_past_target: 1 if the tip is past the target, else 0.
        aside_is_doubtful: 1 if it cannot be told that the needle is on the plan.
        near_number: Number of the structure at risk that is too near, or nearest, to
            the needle or its way ahead, NaN where none is known.
        near_distance_m: Its distance.
        near_is_ahead: 1 if that is from the way ahead, 0 if from the needle.
        near_std_m: Standard deviation of that distance.
        near_is_too_near: 1 if it is nearer than it may be, else 0.
        near_x_m: Where it is nearest, in the robot's base.
        near_y_m: Likewise.
        near_z_m: Likewise.
        zero_m: Depth from which shown depths count.
        zero_kind: Number of its name in `needleforce.depth_zero.ZERO_NAMES`.
        event: Number in `EVENTS` of what happened in this tick.
    """

    time_s: float
    depth_m: float
    speed_m_s: float
    force_N: float
    force_std_N: float
    tip_N: float
    tip_std_N: float
    friction_N: float
    enhanced_N: float
    layer: float
    rupture: float
    rupture_depth_m: float
    retracted: float
    is_good: float
    plan_layer: float = math.nan
    plan_probability: float = math.nan
    plan_offset_m: float = math.nan
    plan_offset_std_m: float = math.nan
    plan_next_m: float = math.nan
    plan_next_std_m: float = math.nan
    plan_matched: float = math.nan
    plan_matched_probability: float = math.nan
    aside_entry_m: float = math.nan
    aside_entry_std_m: float = math.nan
    aside_tip_m: float = math.nan
    aside_tip_std_m: float = math.nan
    aside_angle_rad: float = math.nan
    aside_angle_std_rad: float = math.nan
    aside_to_target_m: float = math.nan
    aside_to_target_std_m: float = math.nan
    aside_is_off_plan: float = math.nan
    aside_is_past_target: float = math.nan
    aside_is_doubtful: float = math.nan
    near_number: float = math.nan
    near_distance_m: float = math.nan
    near_is_ahead: float = math.nan
    near_std_m: float = math.nan
    near_is_too_near: float = math.nan
    near_x_m: float = math.nan
    near_y_m: float = math.nan
    near_z_m: float = math.nan
    zero_m: float = 0.0
    zero_kind: float = 0.0
    event: float = 0.0

    @property
    def zero_name(self) -> str:
        """Name of the zero of shown depths, such as ``below first contact``."""
        return ZERO_NAMES[int(self.zero_kind)]

    @property
    def is_off_plan(self) -> bool:
        """Whether the needle is off the plan."""
        return self.aside_is_off_plan == 1.0

    @property
    def is_too_near(self) -> bool:
        """Whether the needle, or its way ahead, is too near to a structure at risk."""
        return self.near_is_too_near == 1.0

    @property
    def is_doubtful(self) -> bool:
        """Whether it cannot be told that the needle is on the plan."""
        return self.aside_is_doubtful == 1.0

    @property
    def is_past_target(self) -> bool:
        """Whether the tip is past the target."""
        return self.aside_is_past_target == 1.0


FIELDS = ViewRow._fields
"""Names of the numbers of a row, before the joint positions."""

_PLAN_PREFIX = "plan_"

PLAN_FIELDS = tuple(
    name.removeprefix(_PLAN_PREFIX) for name in FIELDS if name.startswith(_PLAN_PREFIX)
)
"""Names of the fields of a `PlanState` that a row has."""

_ASIDE_PREFIX = "aside_"

ASIDE_FIELDS = tuple(
    name.removeprefix(_ASIDE_PREFIX)
    for name in FIELDS
    if name.startswith(_ASIDE_PREFIX)
)
"""Names of the fields of a `PlanDeviation` that a row has."""


_NEAR_PREFIX = "near_"

NEAR_FIELDS = tuple(
    name.removeprefix(_NEAR_PREFIX) for name in FIELDS if name.startswith(_NEAR_PREFIX)
)
"""Names of the fields of a `Clearance` that a row has."""


def view_row(estimate: Any, q_rad: ArrayLike) -> tuple[float, ...]:
    """Return a tick as numbers: the fields of a `ViewRow`, then the joint positions.

    Args:
        estimate: A `SessionEstimate`.
        q_rad: Joint positions, shape (n,).
    """
    wrench = estimate.wrench
    identification = estimate.identification
    rupture = identification.rupture
    retracted = identification.retracted
    plan = estimate.plan
    plan_values: dict[str, float] = {}
    if plan is not None:
        plan_values = {_PLAN_PREFIX + name: getattr(plan, name) for name in PLAN_FIELDS}
    deviation = getattr(estimate, "deviation", None)
    if deviation is not None:
        plan_values |= {
            _ASIDE_PREFIX + name: float(getattr(deviation, name))
            for name in ASIDE_FIELDS
        }

    for nearest in getattr(estimate, "clearances", ())[:1]:
        plan_values |= {
            _NEAR_PREFIX + name: float(getattr(nearest, name)) for name in NEAR_FIELDS
        }

    kinds = (event.kind for event in session_events(estimate))
    events = [EVENTS.index(kind) for kind in kinds if kind in EVENTS]
    zero = find_depth_zero(estimate)
    row = ViewRow(
        time_s=estimate.time_s,
        depth_m=estimate.depth_m,
        speed_m_s=estimate.speed_m_s,
        force_N=wrench.axial,
        force_std_N=wrench.axial_std,
        tip_N=identification.tip_force_N,
        tip_std_N=identification.tip_force_std_N or 0.0,
        friction_N=identification.shaft_friction_N,
        enhanced_N=identification.enhanced_force_N,
        layer=identification.layer,
        rupture=0.0 if rupture is None else rupture.layer,
        rupture_depth_m=0.0 if rupture is None else rupture.depth_m,
        retracted=0.0 if retracted is None else retracted.layer,
        is_good=estimate.status.value == "ok",
        zero_m=zero.depth_m,
        zero_kind=ZERO_NAMES.index(zero.name),
        event=max(events, default=0),
        **plan_values,
    )
    return (*row, *np.asarray(q_rad, dtype=float).tolist())


FREE_PORT = "Give an address of this machine and a free port."


class SceneError(NeedleforceError):
    """A page or an output that cannot be opened, or what cannot be shown."""

    usual_advice = "Give rows of an insertion, and two points for a plan."


class Closing(AbstractContextManager[Any]):
    """What is closed at the end of a ``with`` block."""

    def close(self) -> None:
        """End it."""

    def __exit__(self, *error: object) -> None:
        """Close it."""
        self.close()


class StateRing(Closing):
    """The ring; the side that makes it removes it.

    Args:
        joints: How many positions a row has.
        name: Of an existing ring; None to make one.

    Attributes:
        name: By which another process finds it.
    """

    def __init__(self, joints: int, name: str | None = None) -> None:
        self._width = len(FIELDS) + joints
        self._row = struct.Struct(f"<{self._width}d")
        self._is_owner = name is None
        size = _COUNT.size + ROWS * self._row.size
        self._memory = SharedMemory(
            name, create=self._is_owner, size=size if self._is_owner else 0
        )
        self._buffer: Any = self._memory.buf
        self.name = self._memory.name
        self._count = 0  # the memory, too, begins with zeros

    def put(self, row: tuple[float, ...]) -> None:
        """Write a `view_row`; takes microseconds and never waits."""
        offset = _COUNT.size + (self._count % ROWS) * self._row.size
        self._row.pack_into(self._buffer, offset, *row)
        self._count += 1
        _COUNT.pack_into(self._buffer, 0, self._count)

    def since(self, count: int) -> tuple[int, Array]:
        """Return rows written after the first `count`, as far as they are still there.

        Returns:
            How many rows were written so far, and the rows, shape (n, fields and
            joints).
        """
        written_count = self._written_count()
        # A quarter of them is left for what the writer does meanwhile.
        first = max(count, written_count - 3 * ROWS // 4)
        numbers = np.frombuffer(
            self._buffer, "<f8", ROWS * self._width, offset=_COUNT.size
        )
        table = numbers.reshape(ROWS, self._width)
        places = np.arange(first, written_count)
        rows = table[places % ROWS].copy()
        # A reader that was held up may have copied newer rows in place of old ones.
        is_whole = places > self._written_count() - ROWS
        return written_count, rows[is_whole]

    def _written_count(self) -> int:
        """Return how many rows were written."""
        (count,) = _COUNT.unpack_from(self._buffer, 0)
        return count

    def close(self) -> None:
        """Let go of the memory; its owner also removes it."""
        self._buffer = None
        self._memory.close()
        if self._is_owner:
            self._memory.unlink()
