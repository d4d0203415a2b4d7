"""Sees a loop of control that swings by itself, or that limits hold back for long.

A loop whose gain is too high for its delay T swings with half periods of about 2 T,
each larger than the one before, until joints are at their limits. So do errors that a
hand or a goal makes. What tells them apart is the excitation

    x(t) = e(t) + c(t - T),    c = integral of the motion for the error's sake

with e the error of a row. That motion is K e, or what limits leave of it, J dq - w. So
x is how the goal moves, less the wanted rate w, less what the arm has moved
uncommanded, or for a task above: where x stands still, or moves evenly, while e swings
and does not decay, the loop swings by itself. T need not be known: it is the one that
explains e best, up to the duration of a swing.

A loop is held back where a joint is at a limit, a task asks for motion, and the
measured positions come no further that way. An approach at the limits does.
"""

from collections import deque
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce.control.priority_solver import Stack
from needleforce.control.setting_checks import require_positive
from needleforce.control.swings import SwingRow, Swings
from needleforce.control.tasks import (
    AxialSpeed,
    MAX_STEP_s,
    Posture,
    RemoteCentre,
    Task,
    TipTask,
)

COUNTING_m = 3e-4
"""Smaller errors may be noise: an encoder's steps of 0.17 mrad move the tip by 0.26 mm
from tick to tick."""

COUNTING_rad = 1e-3
"""The same for orientations and joints."""

_COUNTING_SQUARED = np.array([COUNTING_m**2] * 3 + [COUNTING_rad**2] * 3)

HISTORY = 1024
"""Cycles that are kept: a second at 1 kHz, rows of four swings of the longest."""

DELAYS = 17
"""Delays that are tried, from none to the duration of a swing or the longest."""

MAX_DELAY_s = 0.045
"""Longer delays are not looked for, where the arm's is not known: a hand that shakes at
omega = K, more and more, looks like a loop with the delay pi / 2K."""

DELAY_FACTOR = 1.5
"""The same in terms of a delay that is known, which may be off by a half."""

DELAY_MARGIN_s = 5e-3
"""And by so much: a measured delay of zero is one of a few cycles."""

MIN_FOLLOWED = 0.8
"""An arm follows by this part of its commands at least: a soft servo makes 0.7 of quick
ones."""

MAX_FOLLOWED = 1.1
"""And by this at most."""

MAX_EXCITED_PART = 0.15
"""Where what commands leave unexplained is a smaller part of the error, the loop swings
by itself: 0.01 to 0.1 where it does, on servos with a lag of 15 ms, too. A hand that
shakes the arm leaves 0.3 and more, but at frequencies near the gain."""

MIN_CYCLES = 6
"""A straight line, a factor and a delay are fitted to so many cycles at least."""

LARGEST_PART = 0.7
"""The swing is larger than this part of what other errors of the task change by
meanwhile: those of an approach at the limits swing, too."""

MIN_POWER = 1e-12
"""Keeps the factor finite where nothing was commanded."""

CHECK_s = 5e-3
"""Time between two looks at the same row of swings."""

BLOCK_s = 0.05
"""Saturation is judged over blocks of this duration."""

BLOCKS = 3
"""So many of them in a row: it is seen 0.15 to 0.2 s after it has begun."""

SATURATED_PART = 0.9
"""In this part of the time a joint is at a limit."""

ASKED = 2.0
"""A task asks for motion where it asks for more, in counts: noise asks for less."""

STEADY_PART = 0.8
"""And where what it asks adds up to this part of its path: an error that swings is no
goal out of reach."""

SERVED_PART = 0.5
"""And where limits leave less than this part of it in the commands: against a hand that
shakes the arm they leave most."""

PROGRESS = 1.0
"""A loop that comes further, in counts, is not held back."""

PROGRESS_PART = 0.1
"""Nor is one that comes further than this part of what is asked."""


class FailureKind(StrEnum):
    """How a loop fails."""

    OSCILLATES = "oscillates"
    HELD_BACK = "held back"


class LoopFailure(NamedTuple):
    """What is wrong with a loop.

    Attributes:
        kind: In one word, as the status of the command says it.
        reason: The same in a sentence, with what to do.
    """

    kind: FailureKind
    reason: str


class _Counts:
    """What the rows of a stack, and then the joints, ask for, in units that count.

    A posture counts where it is the only task: others move it as they need.

    Args:
        stack: Its numbers of rows m and of joints n.

    Attributes:
        errors: Shape (m + n,); zero without feedback.
        asked_per_s: Rates v, the same shape.
        fed_back_per_s: Of these the part K e, the same shape.
        has_feedback: Whether there is an error, the same shape.
        scale: One over what counts, shape (m,); zero of unknown tasks.
    """

    def __init__(self, stack: Stack) -> None:
        self._row_count = stack.rates.size
        size = self._row_count + stack.joint_velocity.size
        self.errors = np.zeros(size)
        self.asked_per_s = np.zeros(size)
        self.fed_back_per_s = np.zeros(size)
        self.has_feedback = np.zeros(size, dtype=bool)
        self.scale = np.zeros(self._row_count)

    def fill(self, tasks: Sequence[Task], stack: Stack) -> None:
        """Take in the tasks of a cycle, as they were written into the stack."""
        self.errors[:] = 0.0
        self.asked_per_s[:] = 0.0
        self.fed_back_per_s[:] = 0.0
        self.has_feedback[:] = False
        self.scale[:] = 0.0
        start = 0
        for task in tasks:
            end = start + task.size
            if isinstance(task, TipTask):
                self._fill_tip_task(task, stack.rates[start:end], start)
            elif isinstance(task, RemoteCentre):
                self.scale[start:end] = 1.0 / COUNTING_m
                fed_back_per_s = stack.rates[start:end] / COUNTING_m
                self._fill_errors(start, fed_back_per_s, task.gain_per_s)
            elif isinstance(task, AxialSpeed):
                self.scale[start:end] = 1.0 / COUNTING_m
            elif isinstance(task, Posture) and self._row_count == 0:
                fed_back_per_s = stack.joint_velocity / COUNTING_rad
                self.asked_per_s[:] = fed_back_per_s
                self._fill_errors(start, fed_back_per_s, task.gain_per_s)
            start = end
        self.asked_per_s[: self._row_count] = stack.rates * self.scale

    def _fill_tip_task(self, task: TipTask, rates: Array, start: int) -> None:
        """Take in a task of the tip, from a row on."""
        scale = 1.0 / np.sqrt(task.selection**2 @ _COUNTING_SQUARED)
        self.scale[start : start + task.size] = scale
        self._fill_errors(start, (rates - task.rate) * scale, task.gain_per_s)

    def _fill_errors(
        self, start: int, fed_back_per_s: Array, gain_per_s: float
    ) -> None:
        """Take in rates of feedback, from a row on."""
        end = start + fed_back_per_s.size
        self.fed_back_per_s[start:end] = fed_back_per_s
        if gain_per_s > 0.0:
            self.errors[start:end] = fed_back_per_s / gain_per_s
            self.has_feedback[start:end] = True


def _without(basis: Array, signals: Array) -> Array:
    """Return signals less their straight parts, both in columns."""
    return signals - basis @ (basis.T @ signals)


def _delayed(signals: Array, times_s: Array, at_s: Array) -> Array:
    """Return signals, in columns, at other times."""
    place = np.interp(at_s, times_s, np.arange(times_s.size))
    before = np.minimum(place.astype(np.intp), times_s.size - 2)
    part = (place - before)[:, None]
    return (1.0 - part) * signals[before] + part * signals[before + 1]


def _left_by(errors: Array, commanded: Array) -> float:
    """Return the power of errors that a part of what was commanded leaves over."""
    power = max(float((commanded * commanded).sum()), MIN_POWER)
    followed = -float((commanded * errors).sum()) / power
    excited = errors + min(max(followed, MIN_FOLLOWED), MAX_FOLLOWED) * commanded
    return float((excited * excited).sum())


class _Block(NamedTuple):
    """What happened in `BLOCK_s`, in counts; arrays of shape (m + n,).

    Attributes:
        asked: Motion that rates asked for.
        path: The same, forth and back added.
        led: Motion commanded.
        moved: Motion measured.
        is_limited: Whether a joint was at a limit nearly all the time.
    """

    asked: Array
    path: Array
    led: Array
    moved: Array
    is_limited: bool


class LoopWatch:
    """Watches a loop of control cycle by cycle, see the module.

    Args:
        delay_s: From command to measured motion; None if it is not known.

    Raises:
        SettingError: The delay is negative, or no number.
    """

    def __init__(self, delay_s: float | None = None) -> None:
        self._max_delay_s = MAX_DELAY_s
        if delay_s is not None:
            require_positive({"delay_s": delay_s}, or_zero=("delay_s",))
            self._max_delay_s = DELAY_FACTOR * delay_s + DELAY_MARGIN_s
        self.reset()

    def reset(self) -> None:
        """Forget what was seen."""
        self._counts: _Counts | None = None

    def _begin(self, stack: Stack, q_rad: Array) -> _Counts:
        """Begin with another stack."""
        counts = _Counts(stack)
        size = counts.errors.size
        self._stack = stack
        self._counts = counts
        self._swings: Swings | None = None
        self._times_s = np.zeros(HISTORY)
        self._errors = np.zeros((HISTORY, size))
        self._sums = np.zeros((HISTORY, 3 * size))  # of motions in counts, see below
        self._sum = np.zeros(3 * size)
        self._motions = np.zeros(3 * size)  # in the cycle that ends
        self._was_limited = False
        self._last_q_rad = q_rad
        self._cycle = -1
        self._time_s = 0.0
        self._next_check_s = 0.0
        self._blocks = deque[_Block](maxlen=BLOCKS)
        self._begin_block(q_rad)
        return counts

    def _begin_block(self, q_rad: Array) -> None:
        """Begin the next block of time."""
        self._block_asked = np.zeros(self._errors.shape[1])
        self._block_path = np.zeros(self._errors.shape[1])
        self._block_led_rad = np.zeros_like(q_rad)
        self._block_start_rad = q_rad.copy()
        self._block_s = 0.0
        self._limited_s = 0.0

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
        counts = self._counts
        if counts is None or stack is not self._stack or dt_s > MAX_STEP_s:
            counts = self._begin(stack, q_rad)
        counts.fill(tasks, stack)
        if ahead_rad.any():
            ahead = self._motion_along(counts, ahead_rad)
            counts.errors += np.where(counts.has_feedback, ahead, 0.0)
        self._time_s += dt_s
        self._record(counts, q_rad, last_rad_s, dt_s, is_limited)
        failure = self._find_oscillation(counts, dt_s, is_limited)
        if failure is None:
            self._block_led_rad += dt_s * last_rad_s
            failure = self._find_saturation(counts, q_rad, dt_s, is_limited)
        if failure is not None:
            self.reset()
        return failure

    def _find_oscillation(
        self, counts: _Counts, dt_s: float, is_limited: bool
    ) -> LoopFailure | None:
        """Return what swings by itself, None if nothing does."""
        if self._swings is None:
            self._swings = Swings(counts.errors)
        row = self._swings.update(counts.errors, dt_s, is_limited=is_limited)
        if row is None or self._time_s < self._next_check_s:
            return None
        self._next_check_s = self._time_s + CHECK_s
        if not self._swings_by_itself(row, counts):
            return None
        return LoopFailure(
            FailureKind.OSCILLATES,
            f"the loop oscillates at {0.5 / row.swing_s:.0f} Hz: its gain is too high "
            "for the delay of the arm. Lower gain_per_s of the tasks, then reset() the "
            "controller",
        )

    def _record(
        self,
        counts: _Counts,
        q_rad: Array,
        last_rad_s: Array,
        dt_s: float,
        is_limited: bool,
    ) -> None:
        """Add a cycle to the history."""
        size = counts.errors.size
        motions = self._motions
        motions *= dt_s
        if self._was_limited:
            commanded = dt_s * self._motion_along(counts, last_rad_s)
            motions[:size] = commanded - motions[size : 2 * size]
        motions[2 * size :] = self._motion_along(counts, q_rad - self._last_q_rad)
        self._sum = self._sum + motions
        motions[:size] = counts.fed_back_per_s
        motions[size : 2 * size] = counts.asked_per_s - counts.fed_back_per_s
        self._was_limited = is_limited
        self._last_q_rad = q_rad
        self._cycle += 1
        index = self._cycle % HISTORY
        self._times_s[index] = self._time_s
        self._errors[index] = counts.errors
        self._sums[index] = self._sum

    def _motion_along(self, counts: _Counts, joints: Array) -> Array:
        """Return the motion of joints along the rows, and their own, in counts."""
        rows = self._stack.rows @ joints
        return np.concatenate((rows * counts.scale, joints / COUNTING_rad))

    def _swings_by_itself(self, row: SwingRow, counts: _Counts) -> bool:
        """Return whether swings are explained by what was commanded for their sake."""
        count = min(self._cycle + 1, HISTORY)
        kept = np.arange(self._cycle + 1 - count, self._cycle + 1) % HISTORY
        times_s = self._times_s[kept]
        is_seen = times_s >= self._time_s - row.row_s
        seen_s = times_s[is_seen]
        rows = np.flatnonzero(counts.has_feedback)
        errors = self._errors[kept][is_seen][:, rows]
        changes = np.ptp(errors[:, self._same_task(row.error, rows)], axis=0)
        is_largest = row.extent > LARGEST_PART * float(changes.max())
        if seen_s.size < MIN_CYCLES or not is_largest:
            return False
        straight = np.column_stack((np.ones(seen_s.size), seen_s - seen_s.mean()))
        basis, _ = np.linalg.qr(straight)
        sums = self._sums[kept]
        fed_back, wanted, moved = (part[:, rows] for part in np.split(sums, 3, axis=1))
        goals = _without(basis, errors + moved[is_seen])
        wanted = _without(basis, wanted[is_seen])
        errors = _without(basis, errors)
        power = float((errors * errors).sum())
        asked = max((goals * goals).sum(), (wanted * wanted).sum())
        if asked > MAX_EXCITED_PART**2 * power:
            return False
        longest_s = min(row.swing_s, self._max_delay_s)
        left = [
            _left_by(errors, _without(basis, _delayed(fed_back, times_s, late_s)))
            for late_s in seen_s - np.linspace(0.0, longest_s, DELAYS)[:, None]
        ]
        return min(left) < MAX_EXCITED_PART**2 * power

    def _same_task(self, row: int, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Return which of some rows belong to the task of a row."""
        ends = np.cumsum([rates.size for _, rates in self._stack.levels], dtype=np.intp)
        of_rows = np.searchsorted(ends, rows, side="right")
        return of_rows == np.searchsorted(ends, row, side="right")

    def _find_saturation(
        self, counts: _Counts, q_rad: Array, dt_s: float, is_limited: bool
    ) -> LoopFailure | None:
        """Return what limits hold back, None if nothing is."""
        self._block_asked += dt_s * counts.asked_per_s
        self._block_path += dt_s * np.abs(counts.asked_per_s)
        self._block_s += dt_s
        self._limited_s += dt_s * is_limited
        if self._block_s < BLOCK_s:
            return None
        block = _Block(
            self._block_asked,
            self._block_path,
            self._motion_along(counts, self._block_led_rad),
            self._motion_along(counts, q_rad - self._block_start_rad),
            self._limited_s > SATURATED_PART * self._block_s,
        )
        self._blocks.append(block)
        self._begin_block(q_rad)
        is_saturated = all(block.is_limited for block in self._blocks)
        if len(self._blocks) < BLOCKS or not is_saturated or not self._stands():
            return None
        return LoopFailure(
            FailureKind.HELD_BACK,
            f"joints are at their limits for {BLOCKS * BLOCK_s:g} s, and a task comes "
            "no nearer to its goal. Ask for goals within reach, then reset() the "
            "controller",
        )

    def _stands(self) -> bool:
        """Return whether the most important task that asks for motion gets none."""
        asked = np.sum([block.asked for block in self._blocks], axis=0)
        path = np.sum([block.path for block in self._blocks], axis=0)
        led = np.sum([block.led for block in self._blocks], axis=0)
        moved = np.sum([block.moved for block in self._blocks], axis=0)
        end = 0
        sizes = [rates.size for _, rates in self._stack.levels]
        for size in [*sizes, self._stack.joint_velocity.size]:
            rows = slice(end, end + size)
            end += size
            distance = float(np.linalg.norm(asked[rows]))
            if distance > ASKED:
                is_steady = distance > STEADY_PART * float(np.linalg.norm(path[rows]))
                served = float(led[rows] @ asked[rows]) / distance
                progress = float(np.linalg.norm(moved[rows]))
                is_still = all(
                    float(np.linalg.norm(block.moved[rows])) < PROGRESS
                    for block in self._blocks
                )
                is_cut = served < SERVED_PART * distance
                is_held = progress < min(PROGRESS, PROGRESS_PART * distance)
                return is_steady and is_cut and is_still and is_held
        return False
