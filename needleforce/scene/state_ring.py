"""What a control loop hands to a viewer in another process: a ring of rows in shared
memory.

One writer, which never waits: it writes a row, then raises the count. A reader that was
too slow finds the rows it missed overwritten, and goes on with the newest.
"""

import struct
from contextlib import AbstractContextManager
from multiprocessing.shared_memory import SharedMemory
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

PLAN_FIELDS = (
    *("layer", "probability", "offset_m", "offset_std_m", "next_m", "next_std_m"),
    *("matched", "matched_probability"),
)  # of a `PlanState`, nan without a plan
FIELDS = (
    *("time_s", "depth_m", "speed_m_s", "force_N", "force_std_N", "tip_N", "tip_std_N"),
    *("friction_N", "layer", "rupture", "rupture_depth_m", "retracted", "is_good"),
    *(f"plan_{name}" for name in PLAN_FIELDS),
)
"""Of a row, before the joint positions. `rupture` and `retracted` are the number of the
layer that ruptured, or did not after all, else 0; `is_good`: 1 if the force is tared
and of this tick."""
ROWS = 4096
_COUNT = struct.Struct("<Q")


def view_row(now: Any, q_rad: ArrayLike) -> tuple[float, ...]:
    """A row of a `SessionEstimate` and the joint positions [rad], shape (n,), behind
    `FIELDS`.
    """
    wrench = now.wrench
    found = now.identification
    plan = now.plan
    rupture = found.rupture
    retracted = found.retracted
    return (
        *(now.time_s, now.depth_m, now.speed_m_s, wrench.axial, wrench.axial_std),
        *(
            found.tip_force_N,
            found.tip_force_std_N or 0.0,
            found.shaft_friction_N,
            found.layer,
        ),
        *((0.0, 0.0) if rupture is None else (rupture.layer, rupture.depth_m)),
        *(0.0 if retracted is None else retracted.layer, now.status.value == "ok"),
        *(np.nan if plan is None else getattr(plan, name) for name in PLAN_FIELDS),
        *np.asarray(q_rad, dtype=float).tolist(),
    )


class SceneError(Exception):
    """A page or an output that cannot be opened, or what cannot be shown."""


class Closing(AbstractContextManager[Any]):
    """What is closed at the end of a ``with`` block."""

    def close(self) -> None:
        """End it."""

    def __exit__(self, *error: object) -> None:
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
        self._row = struct.Struct(f"<{len(FIELDS) + joints}d")
        self._is_owner = name is None
        size = _COUNT.size + ROWS * self._row.size
        self._memory = SharedMemory(
            name, create=self._is_owner, size=size if name is None else 0
        )
        self._buffer: Any = self._memory.buf
        self.name = self._memory.name
        self._count = 0  # the memory, too, begins with zeros

    def put(self, row: tuple[float, ...]) -> None:
        """Write a `view_row`; takes microseconds and never waits."""
        at = _COUNT.size + (self._count % ROWS) * self._row.size
        self._row.pack_into(self._buffer, at, *row)
        self._count += 1
        _COUNT.pack_into(self._buffer, 0, self._count)

    def since(self, count: int) -> tuple[int, Array]:
        """Rows written after the first `count`, as far as they are still there: (n,
        fields).
        """
        (now,) = _COUNT.unpack_from(self._buffer, 0)
        # A quarter of the ring is left for what the writer does meanwhile.
        first = max(count, now - 3 * ROWS // 4)
        width = self._row.size // 8
        table = np.frombuffer(self._buffer, "<f8", ROWS * width, _COUNT.size).reshape(
            ROWS, width
        )
        return now, table[np.arange(first, now) % ROWS].copy()

    def close(self) -> None:
        """Let go of it; its owner also removes it."""
        self._buffer = None
        self._memory.close()
        if self._is_owner:
            self._memory.unlink()
