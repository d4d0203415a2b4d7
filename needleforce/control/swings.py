"""Swings of errors between their extremes, and rows of swings that do not decay."""

from dataclasses import dataclass
from typing import NamedTuple

from foundation.arrays import Vector
from foundation.jit import compiled_inside
from foundation.records import read_element

CLEARLY_GROWN_SWINGS = 3
"""Swings in a row, each clearly larger than the one before, that may be an oscillation;
the last one may still go on."""

CLEAR_GROWTH = 1.25
"""A swing is clearly larger by this factor. At 1.5 times the gain of instability it is
1.7."""

HELD_SWINGS = 3
"""Swings in a row that may be an oscillation if limits hold all but the first and none
is clearly smaller than the one before: safe loops leave their limits as they come to
their goal."""

LEVEL = 0.85
"""A swing that limits hold is clearly smaller than the one before if it has less than
this fraction of its extent."""

LIMITED_FRACTION = 0.5
"""Limits hold a swing if a joint is at a limit in this fraction of its time."""

GROWING_SWINGS = 5
"""Swings in a row that grow a little, and may be an oscillation."""

GROWTH = 1.05
"""A swing has grown by this factor: noise alters the extent of steady ones by less."""

MAX_SWING_s = 0.4
"""Slower swings are motion of a hand or a goal. Those of a loop with a delay T last
about 2 T, those that limits hold twice to thrice that."""

MAX_UNEVENNESS = 0.4
"""Durations of two swings in a row differ by less than this part of the longer one, and
a cycle."""


@dataclass
class Swing:
    """The swing of one error that goes on, and those before it.

    An error counts in units that are its noise at most, so that one is a turn.

    Attributes:
        direction: 1 or -1; 0 before the first one.
        start: The extreme that it began at.
        extreme: The furthest that it has come.
        going_s: Time from there to there.
        turned_s: Time since the extreme.
        limited_s: Time with a joint at a limit since the start.
        last_extent: From extreme to extreme, of the swing before.
        last_s: Time from extreme to extreme, of the swing before.
        alike: Swings before it in a row that are regular and do not decay.
        held: Of those, the ones that limits hold.
        grown: Swings before it in a row that are clearly larger each.
        row_s: Time since that row began.
    """

    direction: float
    start: float
    extreme: float
    going_s: float
    turned_s: float
    limited_s: float
    last_extent: float
    last_s: float
    alike: int
    held: int
    grown: int
    row_s: float


class SwingRow(NamedTuple):
    """A row of swings that may be an oscillation.

    Attributes:
        error: Index of the error that swings.
        swing_s: Time from extreme to extreme.
        row_s: Time since the row began.
        extent: Of the last swing, so far.
    """

    error: int
    swing_s: float
    row_s: float
    extent: float


def read_row(swings: list[Swing], error: int, dt_s: float) -> SwingRow:
    """Return the row of swings of an error, after a cycle of some duration."""
    swing = read_element(Swing, swings, error)
    extent = abs(swing.extreme - swing.start)
    return SwingRow(error, max(swing.last_s, dt_s), swing.row_s, extent)


@compiled_inside
def begin_swings(swings: list[Swing], errors: Vector) -> None:
    """Begin at errors, shape (k,)."""
    for k in range(errors.size):
        swings[k].start = errors[k]
        swings[k].extreme = errors[k]


@compiled_inside
def advance_swings(
    swings: list[Swing], errors: Vector, dt_s: float, is_limited: bool
) -> int:
    """Follow the swings for a cycle; return the first that may oscillate, or -1."""
    found = -1
    for k in range(errors.size):
        swing = swings[k]
        swing.turned_s += dt_s
        swing.row_s += dt_s
        if is_limited:
            swing.limited_s += dt_s
        back = swing.extreme - errors[k]
        if swing.direction == 0.0:
            if abs(back) > 1.0:
                turn_swing(swing, errors[k], dt_s)
        elif swing.direction * back < 0.0:
            swing.extreme = errors[k]
            swing.going_s += swing.turned_s
            swing.turned_s = 0.0
        elif swing.direction * back > 1.0:
            turn_swing(swing, errors[k], dt_s)
        if found < 0 and swing.alike > 0 and may_oscillate(swing, dt_s):
            found = k
    return found


@compiled_inside
def turn_swing(swing: Swing, error: float, dt_s: float) -> None:
    """End a swing, and begin the next one at its extreme."""
    extent = abs(swing.extreme - swing.start)
    since_s = swing.going_s + swing.turned_s
    is_held = swing.limited_s > LIMITED_FRACTION * since_s
    if continues_row(swing, dt_s):
        swing.alike += 1
        swing.held += int(is_held)
        is_grown = extent > CLEAR_GROWTH * swing.last_extent
        swing.grown = swing.grown + 1 if is_grown else 1
    else:
        begun = int(swing.direction != 0.0)
        swing.alike = begun
        swing.held = begun
        swing.grown = begun
        swing.row_s = since_s
    swing.last_extent = extent
    swing.last_s = swing.going_s
    swing.direction = 1.0 if error > swing.extreme else -1.0
    swing.start = swing.extreme
    swing.extreme = error
    swing.going_s = swing.turned_s
    swing.turned_s = 0.0
    swing.limited_s = 0.0


@compiled_inside
def may_oscillate(swing: Swing, dt_s: float) -> bool:
    """Return whether the swing that goes on makes its row an oscillation."""
    if not continues_row(swing, dt_s):
        return False
    extent = abs(swing.extreme - swing.start)
    since_s = swing.going_s + swing.turned_s
    is_held = swing.limited_s > LIMITED_FRACTION * since_s
    is_grown = extent > CLEAR_GROWTH * swing.last_extent
    return (
        swing.alike + 1 >= GROWING_SWINGS
        or swing.held + int(is_held) >= HELD_SWINGS
        or (is_grown and swing.grown + 1 >= CLEARLY_GROWN_SWINGS)
    )


@compiled_inside
def continues_row(swing: Swing, dt_s: float) -> bool:
    """Return whether the swing that goes on is like the one before, or larger."""
    since_s = swing.going_s + swing.turned_s
    is_held = swing.limited_s > LIMITED_FRACTION * since_s
    longest_s = max(swing.going_s, swing.last_s)
    has_settled = swing.turned_s > longest_s + dt_s
    uneven_s = abs(swing.going_s - swing.last_s)
    extent = abs(swing.extreme - swing.start)
    least = (LEVEL if is_held else GROWTH) * swing.last_extent
    return (
        swing.last_extent > 0.0
        and not has_settled
        and extent >= least
        and longest_s < MAX_SWING_s
        and uneven_s < MAX_UNEVENNESS * longest_s + dt_s
    )
