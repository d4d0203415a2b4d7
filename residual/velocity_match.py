"""Whether measured velocities are the rate of the measured positions, one look (pure functions).

Both are summed to travel that fades within a second, q by its differences, dq by trapezoids between
two looks. So a position that is coarse or held is off by one step at most, noise and vibration of
the velocity average out, and what is left of a sound pair is the time by which one is later than
the other. Travel of a joint that hardly moves tells nothing and is not looked at.
"""

import math

import numpy as np
from numpy.typing import NDArray

from speedup import Matrix, Vector, compiled

POSITION, VELOCITY, RATE, TRAVEL, SAID = range(5)
"""Rows of a match at the last look: position [rad], velocity and rate of the position [rad/s],
fading travel of q and of dq [rad]."""
SECONDS, BEYOND, SAID_SQUARE, CHANGE_SQUARE, CHANGE_TRAVEL, CHANGE_SAID = range(5, 11)
"""Time for which a joint has been looked at [s]; sums over it: squares of the difference beyond a
lag, of dq's travel [rad^2 s] and of the change of q's [rad^2/s]; products of that change with both
travels [rad^2]."""
SQUARES = 11
"""From here n rows, one for each joint: square of its travel while the joint of the column was
looked at [rad^2 s]; then n rows: product of its travel with dq's of the joint of the column."""

TRAVEL_S = 1.0
"""Travel fades with this time constant: shorter makes slow strokes short, longer adds up bias."""
MEMORY_S = 10.0
"""Of the motion that is looked at; time at rest does not count, so an arm that waits for its tare
does not forget."""
LONGEST_S = 0.2
"""A trapezoid over more tells nothing."""
MOST_ACCELERATION_RAD_S2 = 20.0
"""As in `residual.spike_gates`: a position that jumps has no rate."""
LEAST_TRAVEL_RAD = 0.015
"""Ten steps of a very coarse encoder; a stroke in air of 60 mm makes thrice as much."""
SAID_RATIO = 20.0
"""So many times that travel by dq alone is looked at too, whatever q does."""
HONEST_LAG_S = 0.03
"""A filtered velocity is late by 20 ms, a held one by ten; the same may hold for a position."""
HONEST_RAD = 0.02
"""A vibration of 50 Hz, seen every 20 ms, seems a velocity; 6 rad/s^2 of it make this travel."""
LEAST_SECONDS = 1.0
"""Of motion, before anything is told."""
LEAST_BEYOND = 0.01
"""Root mean square difference beyond what is honest that is looked at, in times of the travel."""


def first_match(q: NDArray[np.float64], dq: NDArray[np.float64]) -> NDArray[np.float64]:
    """A match that knows one look only, shape (SQUARES + 2 n, n).

    Args:
        q: Position [rad], shape (n,).
        dq: Velocity [rad/s], shape (n,).
    """
    match = np.zeros((SQUARES + 2 * len(q), len(q)))
    match[POSITION], match[VELOCITY] = q, dq
    return match


@compiled
def velocity_match_step(match: Matrix, q: Vector, dq: Vector, dt_s: float) -> Matrix:
    """Take the next look.

    Args:
        match: So far, shape (SQUARES + 2 n, n).
        q: Position [rad], shape (n,).
        dq: Velocity [rad/s], shape (n,).
        dt_s: Time since the last look [s], more than 0.

    Returns:
        The match after it, of the same shape.
    """
    n = q.size
    way, said = q - match[POSITION], 0.5 * dt_s * (dq + match[VELOCITY])
    rate = way / dt_s
    after = match.copy()
    after[POSITION], after[VELOCITY], after[RATE] = q, dq, rate
    jump = np.abs(rate - match[RATE]).max()
    if jump > MOST_ACCELERATION_RAD_S2 * dt_s or dt_s > LONGEST_S:
        after[TRAVEL : SAID + 1] = 0.0
        return after
    kept = math.exp(-dt_s / TRAVEL_S)
    a, b = kept * match[TRAVEL] + way, kept * match[SAID] + said
    after[TRAVEL], after[SAID] = a, b
    seen = np.maximum(SAID_RATIO * np.abs(a), np.abs(b)) > SAID_RATIO * LEAST_TRAVEL_RAD
    if not seen.any():
        return after
    honest = HONEST_RAD + HONEST_LAG_S / dt_s * np.maximum(np.abs(way), np.abs(said))
    change = (a - match[TRAVEL]) / dt_s
    terms = np.ones((match.shape[0] - SECONDS, n))
    terms[BEYOND - SECONDS] = np.maximum(np.abs(b - a) - honest, 0.0) ** 2
    terms[SAID_SQUARE - SECONDS] = b * b
    terms[CHANGE_SQUARE - SECONDS] = change * change
    terms[CHANGE_TRAVEL - SECONDS] = change * a
    terms[CHANGE_SAID - SECONDS] = change * b
    others = a.reshape(n, 1)
    terms[SQUARES - SECONDS : SQUARES - SECONDS + n] *= others * others
    terms[SQUARES - SECONDS + n :] = others * b
    weight = seen * 1.0
    after[SECONDS:] += weight * (
        dt_s * terms - (1.0 - math.exp(-dt_s / MEMORY_S)) * match[SECONDS:]
    )
    return after


@compiled
def differs(match: Matrix) -> bool:
    """Whether a velocity may not be the rate of its position; quick, and sure where it says no.

    Args:
        match: So far, shape (SQUARES + 2 n, n).
    """
    own = np.diag(match[SQUARES : SQUARES + match.shape[1]])
    beyond = match[BEYOND] > LEAST_BEYOND**2 * own
    return bool(np.any(beyond & (match[SECONDS] >= LEAST_SECONDS)))
