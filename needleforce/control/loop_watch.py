"""Sees a loop of control that swings by itself, and a task that stands still.

A loop whose gain is too high for its delay T swings, each time further. So do errors
that a hand or a goal makes. What tells them apart is the excitation

    x(t) = e(t) + c(t - T),    c = integral of the motion for the error's sake

with e the error of a row. That motion is K e, or what limits leave of it, J dq - w. So
x is how the goal moves, less the wanted rate w, less what the arm has moved
uncommanded, or for a task above: where x stands still, or moves evenly, while e swings
and does not decay, the loop swings by itself. T need not be known: it is the one that
explains e best, up to the duration of a swing.

A task stands still where it asks for motion, steadily, and gets none. The cause is
found in the joints: the arm does not follow, one presses against its stop, or the pose
is singular. A task that gives way to those above it has none of these causes.
"""

import math
from collections.abc import Sequence
from enum import StrEnum
from operator import is_
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector, WrittenBlocks, WrittenMatrix
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import dot
from needleforce.control.joint_limits import JointLimits
from needleforce.control.priority_solver import WEAK_MOTION, Stack
from needleforce.control.setting_checks import require_positive
from needleforce.control.tasks import (
    AxialSpeed,
    MAX_STEP_s,
    Posture,
    RemoteCentre,
    Task,
    TipTask,
    ToolState,
)
from urdf import Robot

COUNTING_m = 3e-4
"""Errors count in units that are their noise at most: an encoder's steps of 0.17 mrad
move the tip by 0.26 mm from tick to tick."""

COUNTING_rad = 1e-3
"""The unit of errors of orientations and joints."""

HISTORY = 1024
"""Cycles that are kept, a second at 1 kHz."""

ERROR, ASKED, FED_BACK, WANTED, MOVED = range(5)
"""Signals of a row that are kept, in counts: its error; and sums of the motion that its
rate asks for, of that for the error's sake, of that at the wanted rate, and of that
measured."""

LEVEL = 0.85
"""A swing decays if it has less than this fraction of the extent of the one before; a
loop with 0.9 of the gain that makes it unstable has 0.86."""

MAX_SWING_s = 0.4
"""Slower swings are motion of a hand or a goal. Those of a loop with a delay T last
about 2 T, those that limits hold twice to thrice that."""

MAX_EXCITED_FRACTION = 0.15
"""Where commands leave a smaller fraction of the error unexplained, the loop swings
by itself: 0.01 to 0.1 where it does, on servos with a lag of 15 ms, too. A hand that
shakes the arm leaves 0.3 and more, but at frequencies near the gain."""

STANDSTILL_s = 0.2
"""A task that stands still is judged over this time and the delay, if that is known."""

MIN_ASKED = 2.0
"""A task asks for motion if it asks for more counts in that time: noise asks for
less."""

PROGRESS_FRACTION = 0.1
"""A task that comes further than this fraction of what it asks for does not stand."""


class FailureKind(StrEnum):
    """How a loop fails."""

    OSCILLATES = "oscillates"
    AT_LIMIT = "at limit"
    SINGULAR = "singular"
    NO_PROGRESS = "no progress"


class LoopFailure(NamedTuple):
    """What is wrong with a loop.

    Attributes:
        kind: In one word, as the status of the command says it.
        reason: The same in a sentence, with what to do.
    """

    kind: FailureKind
    reason: str


class LoopWatch:
    """Watches a loop of control cycle by cycle, see the module.

    Args:
        robot: The arm.
        limits: What its joints may do.
        delay_s: From command to measured motion; None if it is not known.

    Raises:
        SettingError: The delay is negative, or no number.
    """

    def __init__(
        self, robot: Robot, limits: JointLimits, delay_s: float | None = None
    ) -> None:
        # Without a known delay none beyond 45 ms is looked for: a hand that shakes at
        # omega = K, more and more, looks like a loop with the delay pi / 2K.
        self._max_delay_s = 0.045
        self._standstill_s = STANDSTILL_s
        if delay_s is not None:
            require_positive({"delay_s": delay_s}, or_zero=("delay_s",))
            # It may be off by a half; one measured as zero is one of a few cycles.
            self._max_delay_s = 1.5 * delay_s + 5e-3
            self._standstill_s += delay_s
        self._joint_names = robot.joint_names
        self._limits = limits
        self._tool = ToolState(robot)
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._stack: Stack | None = None

    def _begin(self, stack: Stack, q_rad: Array) -> None:
        """Begin with another stack."""
        self._stack = stack
        joints = q_rad.size
        # A posture counts where it is the only task: others move it as they need.
        self._has_rows = bool(stack.rates.size)
        self._jacobian = stack.rows if self._has_rows else np.eye(joints)
        self._rates = stack.rates if self._has_rows else stack.joint_velocity
        size = self._rates.size
        self._cycles = 0
        self._time_s = 0.0
        self._next_swings_s = 0.0
        self._next_standstill_s = self._standstill_s
        self._was_limited = False
        self._times_s = np.zeros(HISTORY)
        self._history = np.zeros((HISTORY, 5, size))
        self._joint_history_rad = np.zeros((HISTORY, 2, joints))
        self._extremes = np.zeros((size, 4, 2))
        self._per_row = np.zeros((5, size))
        self._joint_history_rad[-1, 1] = q_rad
        self._tasks = list[Task]()

    def _take_tasks(self, tasks: Sequence[Task]) -> None:
        """Find out what rows count, and where their gains and wanted rates are."""
        self._tasks = list(tasks)
        self._rows_of_tasks = list[slice]()
        self._gains = list[tuple[TipTask | RemoteCentre | Posture, Array]]()
        self._wanted = list[tuple[TipTask, Array]]()
        self._per_row[:3] = 0.0
        counting_squared = np.array([COUNTING_m**2] * 3 + [COUNTING_rad**2] * 3)
        for task in tasks if self._has_rows else tasks[-1:]:
            start = self._rows_of_tasks[-1].stop if self._rows_of_tasks else 0
            rows = slice(start, start + task.size)
            if rows.stop > self._rates.size:
                break  # a posture that needs no rows
            self._rows_of_tasks.append(rows)
            scale, gain_per_s, wanted = self._per_row[:3, rows]
            if isinstance(task, TipTask):
                scale[:] = 1.0 / np.sqrt(task.selection**2 @ counting_squared)
                self._wanted.append((task, wanted))
            elif isinstance(task, RemoteCentre | AxialSpeed):
                scale[:] = 1.0 / COUNTING_m
            elif isinstance(task, Posture) and not self._has_rows:
                scale[:] = 1.0 / COUNTING_rad
            if isinstance(task, TipTask | RemoteCentre | Posture) and scale.any():
                self._gains.append((task, gain_per_s))

    def update(
        self,
        tasks: Sequence[Task],
        stack: Stack,
        q_rad: Array,
        last_rad_s: Array,
        dt_s: float,
        *,
        ahead_rad: Array,
        is_limited: bool,
    ) -> LoopFailure | None:
        """Take in a cycle; return how the loop fails, and begin anew, or None.

        A cycle longer than `MAX_STEP_s` is a pause: what was seen before is forgotten.

        Args:
            tasks: As they were written into the stack.
            stack: Their numbers.
            q_rad: Measured joint positions, shape (n,).
            last_rad_s: Velocity commanded in the cycle that ends, shape (n,).
            dt_s: Its duration.
            ahead_rad: By so much the joints of the tasks were ahead of those measured,
                shape (n,); errors are judged without it.
            is_limited: Whether a joint is at a limit in the cycle that begins.
        """
        if stack is not self._stack or dt_s > MAX_STEP_s:
            self._begin(stack, q_rad)
        if len(tasks) != len(self._tasks) or not all(map(is_, tasks, self._tasks)):
            self._take_tasks(tasks)
        for task, gain_per_s in self._gains:
            gain_per_s[:] = task.gain_per_s
        for tip_task, wanted in self._wanted:
            wanted[:] = tip_task.rate
        self._time_s += dt_s
        self._times_s[self._cycles % HISTORY] = self._time_s
        row = add_cycle(
            self._history,
            self._joint_history_rad,
            self._extremes,
            self._cycles,
            self._jacobian,
            self._rates,
            self._per_row,
            q_rad,
            last_rad_s,
            ahead_rad,
            self._time_s,
            dt_s,
            self._was_limited,
        )
        self._cycles += 1
        self._was_limited = is_limited
        failure = None
        if row >= 0 and self._time_s >= self._next_swings_s:
            self._next_swings_s = self._time_s + 5e-3
            failure = self._find_oscillation(row)
        if failure is None and self._time_s >= self._next_standstill_s:
            self._next_standstill_s = self._time_s + 0.02
            failure = self._find_standstill()
        if failure is not None:
            self.reset()
        return failure

    def _cycles_since(self, start_s: float) -> NDArray[np.intp]:
        """Return the places of the cycles kept since a time, the oldest first."""
        kept = np.arange(max(self._cycles - HISTORY, 0), self._cycles) % HISTORY
        return kept[self._times_s[kept] >= start_s]

    def _find_oscillation(self, row: int) -> LoopFailure | None:
        """Return how a row swings by itself, None if commands do not explain it."""
        begun_s, _, before_s, last_s = self._extremes[row, :, 0]
        rows = next(rows for rows in self._rows_of_tasks if row < rows.stop)
        kept = self._cycles_since(0.0)
        signals = self._history[kept, :, rows]
        is_swing = self._times_s[kept] >= begun_s
        extents = np.ptp(signals[is_swing, ERROR], axis=0)
        # Errors of an approach at the limits swing, too, beside one that shrinks.
        is_largest = extents[row - rows.start] > 0.7 * extents.max()
        longest_s = min(last_s - before_s, self._max_delay_s)
        if not is_largest or (
            find_excited_fraction(self._times_s[kept], signals, is_swing, longest_s)
            >= MAX_EXCITED_FRACTION
        ):
            return None
        return LoopFailure(
            FailureKind.OSCILLATES,
            f"the loop oscillates at {1.5 / (last_s - begun_s):.0f} Hz: its gain is "
            "too high for the delay of the arm. Lower gain_per_s of the tasks, then "
            "reset() the controller",
        )

    def _find_standstill(self) -> LoopFailure | None:
        """Return why the most important task that asks for motion gets none."""
        kept = self._cycles_since(self._time_s - self._standstill_s)
        places = kept[np.linspace(0, kept.size - 1, 7).astype(int)]
        motions = self._history[places] - self._history[places[0]]
        asked = motions[[3, 6], ASKED]  # in the first half, and in all
        moved = motions[:, MOVED]
        led_rad, moved_rad = (
            self._joint_history_rad[places] - self._joint_history_rad[places[0]]
        ).swapaxes(0, 1)
        for rows in self._rows_of_tasks:
            distance = float(np.linalg.norm(asked[1, rows]))
            if distance <= MIN_ASKED:
                continue
            direction = asked[1, rows] / distance
            # An error that swings is no goal out of reach; of one that grows evenly a
            # quarter is asked for in the first half.
            in_first_half = float(asked[0, rows] @ direction) / distance
            is_steady = 0.2 < in_first_half < 0.8
            progress = float(np.linalg.norm(moved[:, rows], axis=1).max())
            if not is_steady or progress >= min(1.0, PROGRESS_FRACTION * distance):
                return None
            led = self._per_row[0, rows] * (self._jacobian[rows] @ led_rad[-1])
            is_commanded = float(np.linalg.norm(led)) > MIN_ASKED
            followed_rad = np.linalg.norm(moved_rad, axis=1).max()
            stands_rad = PROGRESS_FRACTION * np.linalg.norm(led_rad[-1])
            if is_commanded and followed_rad < stands_rad:
                return self._report_no_progress(led_rad[-1])
            served_fraction = float(led @ direction) / distance
            q_rad = self._joint_history_rad[places[-1], 1]
            return self._find_obstacle(q_rad, rows, direction, served_fraction)
        return None

    def _report_no_progress(self, led_rad: Array) -> LoopFailure:
        """Report an arm that does not follow such a commanded motion."""
        name = self._joint_names[int(np.abs(led_rad).argmax())]
        return LoopFailure(
            FailureKind.NO_PROGRESS,
            f"joint {name} does not follow its commands: is the arm braked, held, or "
            "in another mode? Free it, then reset() the controller",
        )

    def _find_obstacle(
        self, q_rad: Array, rows: slice, direction: Array, served_fraction: float
    ) -> LoopFailure | None:
        """Return the joint that keeps a task from moving its rows in a direction.

        So much of what the task asks for has been commanded.
        """
        push = self._find_free_motion(q_rad, rows, direction)
        # Positions are noisy, and a joint comes to its stop more and more slowly.
        above = q_rad > self._limits.position_upper_rad - 1e-3
        below = q_rad < self._limits.position_lower_rad + 1e-3
        pressing = push * above - push * below
        joint = int(pressing.argmax())
        is_pressing = pressing[joint] > 0.1 * np.linalg.norm(push)
        if is_pressing and served_fraction < 0.5:
            return LoopFailure(
                FailureKind.AT_LIMIT,
                f"joint {self._joint_names[joint]} is at its stop, {q_rad[joint]:.3f} "
                "rad, and a task comes no nearer to its goal. Ask for goals within "
                "reach, or begin with another posture, then reset() the controller",
            )
        # Where damping leaves more, it moves slowly, and away from the singular pose.
        if np.linalg.norm(push) >= WEAK_MOTION or served_fraction > 0.03:
            return None
        turns_rad = 0.1 * np.vstack((np.eye(q_rad.size), -np.eye(q_rad.size)))
        freed = [
            np.linalg.norm(self._find_free_motion(q_rad + turn_rad, rows, direction))
            for turn_rad in turns_rad
        ]
        joint = int(np.argmax(freed)) % q_rad.size
        if max(freed) < WEAK_MOTION:
            return None  # in other poses, too, the levels above leave nothing
        return LoopFailure(
            FailureKind.SINGULAR,
            "in this pose joints cannot move the needle as a task asks for. Turn "
            f"joint {self._joint_names[joint]}, at {q_rad[joint]:.3f} rad, by 0.1 rad "
            "or more, then reset() the controller",
        )

    def _find_free_motion(self, q_rad: Array, rows: slice, direction: Array) -> Array:
        """Return the part of a motion that tasks above leave to joints, shape (n,).

        The motion is that of the joints which serves the rows of a task in a direction
        best, and has the length one.
        """
        jacobian = np.zeros_like(self._jacobian)
        self._tool.update(q_rad)
        tasks = self._tasks if self._has_rows else self._tasks[-1:]
        for task, its_rows in zip(tasks, self._rows_of_tasks, strict=False):
            task.write(self._tool, jacobian[its_rows], np.zeros(task.size))
        push = (self._per_row[0, rows] * direction) @ jacobian[rows]
        push /= max(float(np.linalg.norm(push)), 1e-12)
        above = jacobian[: rows.start].T
        return push - above @ np.linalg.lstsq(above, push, rcond=1e-9)[0]


def find_excited_fraction(
    times_s: Array, signals: Array, is_swing: NDArray[np.bool_], longest_s: float
) -> float:
    """Return the fraction of a task's errors that commands leave unexplained.

    It is one where the goal swings, or the wanted rate.

    Args:
        times_s: Of the cycles known, shape (k,).
        signals: See `ERROR` and those below it, of r rows, shape (k, 5, r).
        is_swing: Which of the cycles are to be explained, shape (k,).
        longest_s: Delay up to which the effect of commands is looked for.
    """
    swing_s = times_s[is_swing]
    if swing_s.size < 6:  # a line, a factor and a delay are fitted
        return 1.0
    line, _ = np.linalg.qr(np.column_stack((np.ones_like(swing_s), swing_s)))

    def remove_line(signal: Array) -> Array:
        return signal - line @ (line.T @ signal)

    error, _, _, wanted, moved = signals[is_swing].swapaxes(0, 1)
    goal = remove_line(error + moved)
    wanted = remove_line(wanted)
    error = remove_line(error)
    power = max(float(np.sum(error**2)), 1e-12)
    if max(np.sum(goal**2), np.sum(wanted**2)) > MAX_EXCITED_FRACTION**2 * power:
        return 1.0
    least = power
    for delay_s in np.linspace(0.0, longest_s, 17):
        late = [
            np.interp(swing_s - delay_s, times_s, sums)
            for sums in signals[:, FED_BACK].T
        ]
        commanded = remove_line(np.transpose(late))
        followed = -np.sum(commanded * error) / max(np.sum(commanded**2), 1e-12)
        # A soft servo makes 0.7 of quick commands.
        left = error + min(max(followed, 0.8), 1.1) * commanded
        least = min(least, float(np.sum(left**2)))
    return math.sqrt(least / power)


@compiled
def add_cycle(
    history: WrittenBlocks,
    joint_history_rad: WrittenBlocks,
    extremes: WrittenBlocks,
    cycles: int,
    jacobian: Matrix,
    rates: Vector,
    per_row: WrittenMatrix,
    q_rad: Vector,
    last_rad_s: Vector,
    ahead_rad: Vector,
    time_s: float,
    dt_s: float,
    was_limited: bool,
) -> int:
    """Add a cycle; return the row that swings furthest without decaying, or -1.

    Args:
        history: Signals of the rows, shape (HISTORY, 5, m).
        joint_history_rad: Sums of commanded motion, and positions, (HISTORY, 2, n).
        extremes: See `follow_swings`.
        cycles: How many there were before.
        jacobian: J, shape (m, n).
        rates: v, shape (m,).
        per_row: Counts per unit, K, w, and in counts per second what is asked for and
            K e in the cycle that begins, shape (5, m); the last two are written.
        q_rad: Measured positions, shape (n,).
        last_rad_s: Velocity commanded in the cycle that ends, shape (n,).
        ahead_rad: How far the joints of the tasks are ahead, shape (n,).
        time_s: Its end.
        dt_s: Its duration.
        was_limited: Whether a joint was at a limit in it.
    """
    index = cycles % HISTORY
    before = (cycles - 1) % HISTORY  # holds zeros in the first cycle
    last_rad = joint_history_rad[before, 1]
    for j in range(q_rad.size):
        sum_rad = joint_history_rad[before, 0, j]
        joint_history_rad[index, 0, j] = sum_rad + dt_s * last_rad_s[j]
        joint_history_rad[index, 1, j] = q_rad[j]
    sums = history[before]
    for k in range(rates.size):
        led = dt_s * dot(jacobian[k], last_rad_s)
        moved = dot(jacobian[k], q_rad) - dot(jacobian[k], last_rad)
        ahead = dot(jacobian[k], ahead_rad)
        scale = per_row[0, k]
        asked = dt_s * per_row[3, k]
        fed_back = dt_s * per_row[4, k]
        wanted = asked - fed_back
        if was_limited:
            fed_back = scale * led - wanted
        history[index, ASKED, k] = sums[ASKED, k] + asked
        history[index, FED_BACK, k] = sums[FED_BACK, k] + fed_back
        history[index, WANTED, k] = sums[WANTED, k] + wanted
        history[index, MOVED, k] = sums[MOVED, k] + scale * moved
        per_row[3, k] = scale * rates[k]
        has_gain = per_row[1, k] > 0.0
        per_row[4, k] = scale * (rates[k] - per_row[2, k]) if has_gain else 0.0
        error = per_row[4, k] / per_row[1, k] + scale * ahead if has_gain else 0.0
        history[index, ERROR, k] = error
    return watch_extremes(extremes, history[index, ERROR], time_s, cycles == 0)


@compiled_inside
def watch_extremes(
    extremes: WrittenBlocks, errors: Vector, time_s: float, is_first: bool
) -> int:
    """Return the row that swings furthest without decaying, or -1.

    See `follow_swings`.
    """
    if is_first:
        extremes[:, :, 0] = time_s
        for k in range(errors.size):
            extremes[k, :, 1] = errors[k]
    furthest = -1
    longest_way = 0.0
    for k in range(errors.size):
        is_swinging = follow_swings(extremes[k], errors[k], time_s)
        way = abs(extremes[k, 3, 1] - extremes[k, 2, 1])
        if is_swinging and way > longest_way:
            furthest = k
            longest_way = way
    return furthest


@compiled_inside
def follow_swings(extremes: WrittenMatrix, error: float, time_s: float) -> bool:
    """Take in an error; return whether it has swung three times without decaying.

    Args:
        extremes: The last four, the oldest first: time and error, shape (4, 2). The
            newest is the furthest that the swing which goes on has come.
        error: In counts; after one count backwards it has turned.
        time_s: Now.
    """
    newest = extremes[3]
    direction = newest[1] - extremes[2, 1]
    change = error - newest[1]
    if direction * change > 0.0:
        newest[0] = time_s
        newest[1] = error
    elif abs(change) > 1.0:
        extremes[:3] = extremes[1:].copy()
        newest[0] = time_s
        newest[1] = error
    longest_s = 0.0
    extent = 0.0
    for i in range(3):
        last_extent = extent
        extent = abs(extremes[i + 1, 1] - extremes[i, 1])
        if extent <= LEVEL * last_extent:
            return False
        longest_s = max(longest_s, extremes[i + 1, 0] - extremes[i, 0])
    has_settled = time_s - newest[0] > longest_s
    return longest_s < MAX_SWING_s and not has_settled
