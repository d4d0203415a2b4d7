"""What the rows of a stack asked for and how joints moved, cycle by cycle.

Every tick copies numbers only, and has compiled code add them up. Rows count in units
that are their noise at most. A posture counts where it is the only task, with a row per
joint: others move it as they need.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from operator import is_
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import (
    Array,
    Matrix,
    Vector,
    WrittenBlocks,
    WrittenMatrix,
    WrittenVector,
)
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import dot
from foundation.records import as_record, read_column, read_field, record_array
from needleforce.control.priority_solver import Stack
from needleforce.control.swings import (
    Swing,
    SwingRow,
    advance_swings,
    begin_swings,
    read_row,
)
from needleforce.control.tasks import AxialSpeed, Posture, RemoteCentre, Task, TipTask

COUNTING_m = 3e-4
"""Smaller errors may be noise: an encoder's steps of 0.17 mrad move the tip by 0.26 mm
from tick to tick."""

COUNTING_rad = 1e-3
"""Smaller errors of orientations and joints may be noise."""

_COUNTING_SQUARED = np.array([COUNTING_m**2] * 3 + [COUNTING_rad**2] * 3)

HISTORY = 1024
"""Cycles that are kept: of a row of swings that lasts longer, a second at 1 kHz, the
end is judged."""

BLOCK_s = 0.05
"""Saturation is judged over blocks of this duration."""

FED_BACK = 0
"""Place among the sums of motion of that for the errors' sake."""

WANTED = 1
"""Place among them of the motion at wanted rates."""

MOVED = 2
"""Place among them of the measured motion."""


@dataclass
class RowState:
    """A row of the stack, in counts.

    Attributes:
        scale: One over what counts; zero of unknown tasks.
        gain_per_s: K of its feedback; zero without.
        wanted: w, its rate without feedback, in m/s or rad/s.
        asked_per_s: Its rate v in the cycle that has begun.
        fed_back_per_s: Of that the part K e.
        asked: Motion that rates asked for in this block.
        path: The same, forth and back added.
    """

    scale: float
    gain_per_s: float
    wanted: float
    asked_per_s: float
    fed_back_per_s: float
    asked: float
    path: float


@dataclass
class JointState:
    """A joint of the arm.

    Attributes:
        last_rad: Its position in the cycle before.
        block_start_rad: Its position when the block began.
        block_led_rad: Motion commanded in this block.
    """

    last_rad: float
    block_start_rad: float
    block_led_rad: float


@dataclass
class LoopState:
    """The loop as a whole.

    Attributes:
        cycles: That were taken in.
        time_s: Of the last one.
        was_limited: Whether a joint was at a limit in it.
        block_s: Time since the block began.
        limited_s: Of that, with a joint at a limit.
    """

    cycles: int
    time_s: float
    was_limited: bool
    block_s: float
    limited_s: float


class Records(NamedTuple):
    """All that compiled code writes into.

    Attributes:
        loop: One element.
        rows: One of each row, m.
        joints: One of each joint, n.
        swings: Of the errors of rows, m.
        times_s: Of the last `HISTORY` cycles.
        errors: In counts, shape (HISTORY, m); zero without feedback.
        motions: Sums of motion in counts, shape (3, HISTORY, m).
    """

    loop: list[LoopState]
    rows: list[RowState]
    joints: list[JointState]
    swings: list[Swing]
    times_s: WrittenVector
    errors: WrittenMatrix
    motions: WrittenBlocks


class Block(NamedTuple):
    """What happened in a block of time, in counts; arrays of shape (m,).

    Attributes:
        asked: Motion that rates asked for.
        path: The same, forth and back added.
        led: Motion commanded.
        moved: Motion measured.
        limited_fraction: Fraction of the time with a joint at a limit.
    """

    asked: Array
    path: Array
    led: Array
    moved: Array
    limited_fraction: float


class Seen(NamedTuple):
    """Cycles that are kept, the oldest first.

    Attributes:
        times_s: Shape (k,).
        errors: In counts, shape (k, r) for r rows with feedback.
        fed_back: Sum of the motion for their sake, the same shape.
        wanted: Of the motion at wanted rates, the same shape.
        moved: Of the motion measured, the same shape.
    """

    times_s: Array
    errors: Array
    fed_back: Array
    wanted: Array
    moved: Array


class LoopHistory:
    """The last cycles of one stack.

    Args:
        stack: The same one in every cycle.
        q_rad: Joint positions that it begins at, shape (n,).
    """

    def __init__(self, stack: Stack, q_rad: Array) -> None:
        self.stack = stack
        joints = q_rad.size
        self._has_rows = bool(stack.rates.size)
        self._jacobian = stack.rows if self._has_rows else np.eye(joints)
        size = len(self._jacobian)
        self._records = Records(
            as_record(LoopState(0, 0.0, False, 0.0, 0.0)),
            record_array(RowState, size),
            record_array(JointState, joints),
            record_array(Swing, size),
            np.zeros(HISTORY),
            np.zeros((HISTORY, size)),
            np.zeros((3, HISTORY, size)),
        )
        self._read_joints("last_rad")[:] = q_rad
        begin_block(self._records)
        self._tasks = list[Task]()
        self._gains = list[tuple[TipTask | RemoteCentre | Posture, Array]]()
        self._wanted = list[tuple[TipTask, Array]]()

    def add(
        self,
        tasks: Sequence[Task],
        q_rad: Array,
        last_rad_s: Array,
        ahead_rad: Array,
        dt_s: float,
        is_limited: bool,
    ) -> tuple[int, bool]:
        """Add a cycle; see `LoopWatch.update` for the arguments.

        Returns:
            The row whose swings may be an oscillation, or -1, and whether the block of
            time is over.
        """
        known = self._tasks
        if len(tasks) != len(known) or not all(map(is_, tasks, known)):
            self._take_tasks(tasks)
        for task, gain_per_s in self._gains:
            gain_per_s[:] = task.gain_per_s
        for tip_task, wanted in self._wanted:
            wanted[:] = tip_task.rate
        stack = self.stack
        rates = stack.rates if self._has_rows else stack.joint_velocity
        return add_cycle(
            self._records,
            self._jacobian,
            rates,
            q_rad,
            last_rad_s,
            ahead_rad,
            dt_s,
            is_limited,
        )

    def _take_tasks(self, tasks: Sequence[Task]) -> None:
        """Find out what rows count, and where their gains and wanted rates are."""
        self._tasks = list(tasks)
        self._gains.clear()
        self._wanted.clear()
        scale = self._read_rows("scale")
        gains_per_s = self._read_rows("gain_per_s")
        wanted = self._read_rows("wanted")
        for values in (scale, gains_per_s, wanted):
            values[:] = 0.0
        start = 0
        for task in tasks:
            rows = slice(start, start + task.size)
            start += task.size
            if isinstance(task, TipTask):
                scale[rows] = 1.0 / np.sqrt(task.selection**2 @ _COUNTING_SQUARED)
                self._gains.append((task, gains_per_s[rows]))
                self._wanted.append((task, wanted[rows]))
            elif isinstance(task, RemoteCentre):
                scale[rows] = 1.0 / COUNTING_m
                self._gains.append((task, gains_per_s[rows]))
            elif isinstance(task, AxialSpeed):
                scale[rows] = 1.0 / COUNTING_m
            elif isinstance(task, Posture) and not self._has_rows:
                scale[rows] = 1.0 / COUNTING_rad
                self._gains.append((task, gains_per_s[rows]))

    @property
    def time_s(self) -> float:
        """Time since the history began."""
        return float(read_field(self._records.loop, "time_s"))

    @property
    def rows_with_feedback(self) -> NDArray[np.intp]:
        """Their indices."""
        return np.flatnonzero(self._read_rows("gain_per_s") > 0.0)

    @property
    def task_sizes(self) -> list[int]:
        """Numbers of rows of the tasks, the most important first."""
        if not self._has_rows:
            return [len(self._jacobian)]
        return [rates.size for _, rates in self.stack.levels]

    def read_swings(self, row: int, dt_s: float) -> SwingRow:
        """Return the swings of the error of a row."""
        return read_row(self._records.swings, row, dt_s)

    def read_cycles(self) -> Seen:
        """Return the cycles that are kept, of rows with feedback."""
        records = self._records
        end = int(read_field(records.loop, "cycles"))
        kept = np.arange(max(end - HISTORY, 0), end) % HISTORY
        rows = self.rows_with_feedback
        fed_back, wanted, moved = records.motions[:, kept][:, :, rows]
        errors = records.errors[kept][:, rows]
        return Seen(records.times_s[kept], errors, fed_back, wanted, moved)

    def end_block(self) -> Block:
        """Return what happened in the block of time, and begin the next one."""
        loop = self._records.loop
        moved_rad = self._read_joints("last_rad") - self._read_joints("block_start_rad")
        block = Block(
            self._read_rows("asked").copy(),
            self._read_rows("path").copy(),
            self._motion_along(self._read_joints("block_led_rad")),
            self._motion_along(moved_rad),
            float(read_field(loop, "limited_s") / read_field(loop, "block_s")),
        )
        begin_block(self._records)
        return block

    def _motion_along(self, joints: Array) -> Array:
        """Return the motion of joints along the rows in counts."""
        return (self._jacobian @ joints) * self._read_rows("scale")

    def _read_rows(self, name: str) -> NDArray[np.float64]:
        """Return one field of all rows, a view."""
        return read_column(self._records.rows, name)

    def _read_joints(self, name: str) -> NDArray[np.float64]:
        """Return one field of all joints, a view."""
        return read_column(self._records.joints, name)


@compiled
def begin_block(records: Records) -> None:
    """Begin a block of time."""
    loop = records.loop[0]
    loop.block_s = 0.0
    loop.limited_s = 0.0
    for k in range(len(records.rows)):
        records.rows[k].asked = 0.0
        records.rows[k].path = 0.0
    for j in range(len(records.joints)):
        joint = records.joints[j]
        joint.block_start_rad = joint.last_rad
        joint.block_led_rad = 0.0


@compiled
def add_cycle(
    records: Records,
    jacobian: Matrix,
    rates: Vector,
    q_rad: Vector,
    last_rad_s: Vector,
    ahead_rad: Vector,
    dt_s: float,
    is_limited: bool,
) -> tuple[int, bool]:
    """Add a cycle, see `LoopHistory.add`, with rates v and their J, shape (m, n)."""
    loop = records.loop[0]
    index = loop.cycles % HISTORY
    errors = records.errors[index]
    add_motions(records, index, jacobian, q_rad, last_rad_s, dt_s)
    for k in range(rates.size):
        ahead = dot(jacobian[k], ahead_rad)
        errors[k] = take_rate(records.rows[k], rates[k], ahead, dt_s)
    for j in range(q_rad.size):
        joint = records.joints[j]
        joint.last_rad = q_rad[j]
        joint.block_led_rad += dt_s * last_rad_s[j]
    if loop.cycles == 0:
        begin_swings(records.swings, errors)
    loop.cycles += 1
    loop.time_s += dt_s
    records.times_s[index] = loop.time_s
    loop.was_limited = is_limited
    loop.block_s += dt_s
    if is_limited:
        loop.limited_s += dt_s
    row = advance_swings(records.swings, errors, dt_s, is_limited)
    return row, loop.block_s >= BLOCK_s


@compiled_inside
def add_motions(
    records: Records,
    index: int,
    jacobian: Matrix,
    q_rad: Vector,
    last_rad_s: Vector,
    dt_s: float,
) -> None:
    """Add the motion in the cycle that ends to the sums, in counts.

    That for the errors' sake is K e dt, or what limits leave of it, (J dq - w) dt.
    """
    was_limited = records.loop[0].was_limited
    before = (index - 1) % HISTORY  # holds zeros in the first cycle
    for k in range(len(jacobian)):
        row = records.rows[k]
        led = 0.0
        moved = 0.0
        for j in range(q_rad.size):
            led += jacobian[k, j] * last_rad_s[j]
            moved += jacobian[k, j] * (q_rad[j] - records.joints[j].last_rad)
        fed_back_per_s = row.fed_back_per_s
        wanted_per_s = row.asked_per_s - fed_back_per_s
        if was_limited:
            fed_back_per_s = row.scale * led - wanted_per_s
        sums = records.motions[:, before, k]
        records.motions[FED_BACK, index, k] = sums[FED_BACK] + dt_s * fed_back_per_s
        records.motions[WANTED, index, k] = sums[WANTED] + dt_s * wanted_per_s
        records.motions[MOVED, index, k] = sums[MOVED] + row.scale * moved


@compiled_inside
def take_rate(row: RowState, rate: float, ahead: float, dt_s: float) -> float:
    """Take in the rate v of a row; return the error of what is measured, in counts.

    The task's own error is of joints that are ahead by some motion along the row.
    """
    row.asked_per_s = row.scale * rate
    row.asked += dt_s * row.asked_per_s
    row.path += dt_s * abs(row.asked_per_s)
    if row.gain_per_s <= 0.0:
        row.fed_back_per_s = 0.0
        return 0.0
    row.fed_back_per_s = row.scale * (rate - row.wanted)
    return row.fed_back_per_s / row.gain_per_s + row.scale * ahead
