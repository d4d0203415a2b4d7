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
from needleforce.control.loop_history import Block, BLOCK_s, LoopHistory
from needleforce.control.priority_solver import Stack
from needleforce.control.setting_checks import require_positive
from needleforce.control.swings import SwingRow
from needleforce.control.tasks import MAX_STEP_s, Task

DELAYS = 17
"""Delays that are tried, from none to the duration of a swing or the longest."""

MAX_DELAY_s = 0.045
"""Longer delays are not looked for, where the arm's is not known: a hand that shakes at
omega = K, more and more, looks like a loop with the delay pi / 2K."""

DELAY_FACTOR = 1.5
"""Where the arm's delay is known, delays of up to this multiple of it are tried, and
`DELAY_MARGIN_s` more: it may be off by a half."""

DELAY_MARGIN_s = 5e-3
"""Added to that multiple: a delay measured as zero is one of a few cycles."""

MIN_FOLLOWED = 0.8
"""Least fraction of its commands by which an arm is taken to follow: a soft servo makes
0.7 of quick ones."""

MAX_FOLLOWED = 1.1
"""Largest fraction of its commands by which an arm is taken to follow."""

MAX_EXCITED_FRACTION = 0.15
"""Where commands leave a smaller fraction of the error unexplained, the loop swings
by itself: 0.01 to 0.1 where it does, on servos with a lag of 15 ms, too. A hand that
shakes the arm leaves 0.3 and more, but at frequencies near the gain."""

MIN_CYCLES = 6
"""A straight line, a factor and a delay are fitted to so many cycles at least."""

LARGEST_FRACTION = 0.7
"""The swing is larger than this fraction of the change of every other error of its
task: errors of an approach at the limits swing, too, beside one that shrinks."""

MIN_POWER = 1e-12
"""Keeps the factor finite where nothing was commanded."""

CHECK_s = 5e-3
"""Time between two checks of the same row of swings."""

BLOCKS = 3
"""Saturation is judged over so many blocks of time in a row: it is seen 0.15 to 0.2 s
after it has begun."""

SATURATED_FRACTION = 0.9
"""A loop is saturated in a block if a joint is at a limit in this fraction of it."""

ASKED = 2.0
"""A task asks for motion if it asks for more counts in these blocks: noise asks for
less."""

STEADY_FRACTION = 0.8
"""It asks steadily if what it asks for adds up to this fraction of its path: an error
that swings is no goal out of reach."""

SERVED_FRACTION = 0.5
"""Limits cut it if they leave less than this fraction of it in the commands: of a hand
that shakes the arm they leave most."""

PROGRESS = 1.0
"""A task that comes further, in counts, is not held back."""

PROGRESS_FRACTION = 0.1
"""Nor is a task that comes further than this fraction of what it asks for."""


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


def _remove_trend(basis: Array, signals: Array) -> Array:
    """Return signals, in columns, less their parts along a basis of straight lines."""
    return signals - basis @ (basis.T @ signals)


def _interpolate(signals: Array, times_s: Array, at_s: Array) -> Array:
    """Return signals, in columns, between their samples, at other times."""
    place = np.interp(at_s, times_s, np.arange(times_s.size))
    before = np.minimum(place.astype(np.intp), times_s.size - 2)
    part = (place - before)[:, None]
    return (1.0 - part) * signals[before] + part * signals[before + 1]


def _find_unexplained_power(errors: Array, commanded: Array) -> float:
    """Return the power of errors that motion commanded for them leaves unexplained."""
    power = max(float((commanded * commanded).sum()), MIN_POWER)
    followed = -float((commanded * errors).sum()) / power
    excited = errors + min(max(followed, MIN_FOLLOWED), MAX_FOLLOWED) * commanded
    return float((excited * excited).sum())


def _find_rows_of_task(history: LoopHistory, row: int) -> NDArray[np.bool_]:
    """Return which of the rows with feedback belong to the task of a row."""
    ends = np.cumsum(history.task_sizes)
    task = np.searchsorted(ends, row, side="right")
    return np.searchsorted(ends, history.rows_with_feedback, side="right") == task


def _is_held_back(blocks: Sequence[Block], task_sizes: Sequence[int]) -> bool:
    """Return whether the most important task that asks for motion gets none."""
    asked = np.sum([block.asked for block in blocks], axis=0)
    path = np.sum([block.path for block in blocks], axis=0)
    led = np.sum([block.led for block in blocks], axis=0)
    moved = np.sum([block.moved for block in blocks], axis=0)
    end = 0
    for size in task_sizes:
        rows = slice(end, end + size)
        end += size
        distance = float(np.linalg.norm(asked[rows]))
        if distance > ASKED:
            is_steady = distance > STEADY_FRACTION * float(np.linalg.norm(path[rows]))
            served = float(led[rows] @ asked[rows]) / distance
            progress = float(np.linalg.norm(moved[rows]))
            is_still = all(
                float(np.linalg.norm(block.moved[rows])) < PROGRESS for block in blocks
            )
            is_cut = served < SERVED_FRACTION * distance
            is_held = progress < min(PROGRESS, PROGRESS_FRACTION * distance)
            return is_steady and is_cut and is_still and is_held
    return False


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
        self._history: LoopHistory | None = None

    def _begin(self, stack: Stack, q_rad: Array) -> LoopHistory:
        """Begin with another stack."""
        history = LoopHistory(stack, q_rad)
        self._history = history
        self._next_check_s = 0.0
        self._blocks = deque[Block](maxlen=BLOCKS)
        return history

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
        history = self._history
        if history is None or stack is not history.stack or dt_s > MAX_STEP_s:
            history = self._begin(stack, q_rad)
        row, is_block_over = history.add(
            tasks, q_rad, last_rad_s, ahead_rad, dt_s, is_limited
        )
        failure = None
        if row >= 0:
            failure = self._find_oscillation(history, row, dt_s)
        if is_block_over and failure is None:
            failure = self._find_saturation(history)
        if failure is not None:
            self.reset()
        return failure

    def _find_oscillation(
        self, history: LoopHistory, row: int, dt_s: float
    ) -> LoopFailure | None:
        """Return how a row swings by itself, None if it does not."""
        time_s = history.time_s
        if time_s < self._next_check_s:
            return None
        self._next_check_s = time_s + CHECK_s
        swings = history.read_swings(row, dt_s)
        if not self._swings_by_itself(swings, history):
            return None
        return LoopFailure(
            FailureKind.OSCILLATES,
            f"the loop oscillates at {0.5 / swings.swing_s:.0f} Hz: its gain is too "
            "high for the delay of the arm. Lower gain_per_s of the tasks, then "
            "reset() the controller",
        )

    def _swings_by_itself(self, row: SwingRow, history: LoopHistory) -> bool:
        """Return whether swings are explained by what was commanded for their sake."""
        cycles = history.read_cycles()
        times_s = cycles.times_s
        is_seen = times_s >= history.time_s - row.row_s
        seen_s = times_s[is_seen]
        errors = cycles.errors[is_seen]
        same_task = _find_rows_of_task(history, row.error)
        if not same_task.any():
            return False
        changes = np.ptp(errors[:, same_task], axis=0)
        is_largest = row.extent > LARGEST_FRACTION * float(changes.max())
        if seen_s.size < MIN_CYCLES or not is_largest:
            return False
        straight = np.column_stack((np.ones(seen_s.size), seen_s - seen_s.mean()))
        basis, _ = np.linalg.qr(straight)
        goals = _remove_trend(basis, errors + cycles.moved[is_seen])
        wanted = _remove_trend(basis, cycles.wanted[is_seen])
        errors = _remove_trend(basis, errors)
        power = float((errors * errors).sum())
        asked = max((goals * goals).sum(), (wanted * wanted).sum())
        if asked > MAX_EXCITED_FRACTION**2 * power:
            return False
        longest_s = min(row.swing_s, self._max_delay_s)
        left = [
            _find_unexplained_power(
                errors,
                _remove_trend(basis, _interpolate(cycles.fed_back, times_s, late_s)),
            )
            for late_s in seen_s - np.linspace(0.0, longest_s, DELAYS)[:, None]
        ]
        return min(left) < MAX_EXCITED_FRACTION**2 * power

    def _find_saturation(self, history: LoopHistory) -> LoopFailure | None:
        """Return what limits hold back at the end of a block, None if nothing is."""
        blocks = self._blocks
        blocks.append(history.end_block())
        is_saturated = all(
            block.limited_fraction > SATURATED_FRACTION for block in blocks
        )
        if len(blocks) < BLOCKS or not is_saturated:
            return None
        if not _is_held_back(blocks, history.task_sizes):
            return None
        return LoopFailure(
            FailureKind.HELD_BACK,
            f"joints are at their limits for {BLOCKS * BLOCK_s:g} s, and a task comes "
            "no nearer to its goal. Ask for goals within reach, then reset() the "
            "controller",
        )
