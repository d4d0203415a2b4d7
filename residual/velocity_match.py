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
"""From here n rows: square of the travel of joint j while joint i was looked at [rad^2 s], then n
rows: its product with dq's travel of joint i."""

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
    is_jump = np.abs(rate - match[RATE]).max() > MOST_ACCELERATION_RAD_S2 * dt_s
    if is_jump or dt_s > LONGEST_S:
        after[TRAVEL : SAID + 1] = 0.0
        return after
    kept = math.exp(-dt_s / TRAVEL_S)
    a, b = kept * match[TRAVEL] + way, kept * match[SAID] + said
    after[TRAVEL], after[SAID] = a, b
    seen = np.maximum(SAID_RATIO * np.abs(a), np.abs(b)) > SAID_RATIO * LEAST_TRAVEL_RAD
    if not seen.any():
        return after
    fade = np.where(seen, math.exp(-dt_s / MEMORY_S), 1.0)
    time_s = np.where(seen, dt_s, 0.0)
    honest = HONEST_RAD + HONEST_LAG_S / dt_s * np.maximum(np.abs(way), np.abs(said))
    beyond = np.maximum(np.abs(b - a) - honest, 0.0)
    after[SECONDS] = fade * match[SECONDS] + time_s
    after[BEYOND] = fade * match[BEYOND] + time_s * beyond**2
    after[SAID_SQUARE] = fade * match[SAID_SQUARE] + time_s * b**2
    change = np.where(seen, a - match[TRAVEL], 0.0)
    after[CHANGE_SQUARE] = fade * match[CHANGE_SQUARE] + change**2 / dt_s
    after[CHANGE_TRAVEL] = fade * match[CHANGE_TRAVEL] + change * a
    after[CHANGE_SAID] = fade * match[CHANGE_SAID] + change * b
    fade_of, time_of, said_of = fade.reshape(n, 1), time_s.reshape(n, 1), b.reshape(n, 1)
    squares, products = match[SQUARES : SQUARES + n], match[SQUARES + n :]
    after[SQUARES : SQUARES + n] = fade_of * squares + time_of * a**2
    after[SQUARES + n :] = fade_of * products + time_of * said_of * a
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
