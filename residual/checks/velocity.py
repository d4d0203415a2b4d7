"""Checks measured velocities: they should be the rate of the measured positions.

To check this, the travel of the last second (fading) is summed from the differences of
q, and from dq by trapezoids between two checks. A coarse or held position is then off
by one step at most, noise and vibration of the velocity average out, and a valid pair
differs only by the lag between the two. Travel of a joint that hardly moves means
nothing and is not used.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Vector
from foundation.jit import compiled
from residual.errors import named_joints


class VelocityMatch(NamedTuple):
    """How measured velocities match positions; arrays of shape (n,), not written again.

    Attributes:
        q: Position at the last check [rad].
        dq: Velocity as measured there [rad/s].
        rate: Rate of the position since the check before [rad/s].
        travel: Travel of the position, fading [rad].
        travel_dq: Travel by the measured velocity, fading [rad].
        checked_s: Time in motion for which a joint has been checked; it fades over 10
            s, like the next ones, and an arm that waits for its tare does not forget.
        excess: Sum of the squared difference of both travels beyond what is tolerated
            [rad^2 s].
        square: Sum of the squared travel of the position [rad^2 s].
        square_dq: The same by the measured velocity.
        product: Sum of the products of both.
    """

    q: Vector
    dq: Vector
    rate: Vector
    travel: Vector
    travel_dq: Vector
    checked_s: Vector
    excess: Vector
    square: Vector
    square_dq: Vector
    product: Vector


def first_match(q: Array, dq: Array) -> VelocityMatch:
    """Return the match after a first check, of position [rad] and velocity [rad/s]."""
    zeros = np.zeros(len(q))
    return VelocityMatch(q.copy(), dq.copy(), *[zeros] * 8)


@compiled
def velocity_match_step(
    before: VelocityMatch, q: Vector, dq: Vector, dt_s: float
) -> VelocityMatch:
    """Return the match after the next check, a time ``dt_s`` > 0 later.

    Where a position has jumped, or the step is too long, travel begins anew.

    Args:
        before: The match at the check before.
        q: Position [rad], shape (n,).
        dq: Velocity as measured [rad/s], shape (n,).
        dt_s: Time since the check before.
    """
    travel_s = 1.0  # if less, slow strokes would look short; if more, bias adds up
    memory_s = 10.0
    max_trapezoid_s = 0.2  # over which two velocities give a travel
    max_acceleration_rad_s2 = 20.0  # a position that is faster has jumped
    # Ten steps of a very coarse encoder; with twenty times as much by dq alone a joint
    # is checked, whatever q does.
    min_travel_rad = 0.015
    dq_ratio = 20.0
    # A filtered velocity is late by 20 ms, a held one by ten; 6 rad/s^2 of a vibration
    # of 50 Hz, seen every 20 ms, make 0.02 rad.
    tolerated_lag_s = 0.03
    tolerated_rad = 0.02
    step_rad = q - before.q
    step_dq_rad = 0.5 * dt_s * (dq + before.dq)
    rate = step_rad / dt_s
    has_jumped = np.abs(rate - before.rate) > max_acceleration_rad_s2 * dt_s
    travel = np.zeros(len(q))
    travel_dq = np.zeros(len(q))
    if dt_s <= max_trapezoid_s and not has_jumped.any():
        fading = math.exp(-dt_s / travel_s)
        travel = fading * before.travel + step_rad
        travel_dq = fading * before.travel_dq + step_dq_rad
    larger_step_rad = np.maximum(np.abs(step_rad), np.abs(step_dq_rad))
    tolerated = tolerated_rad + tolerated_lag_s / dt_s * larger_step_rad
    excess = np.maximum(np.abs(travel_dq - travel) - tolerated, 0.0)
    moved_rad = np.maximum(np.abs(travel), np.abs(travel_dq) / dq_ratio)
    weight_s = np.where(moved_rad > min_travel_rad, dt_s, 0.0)
    faded = np.where(moved_rad > min_travel_rad, 1.0 - math.exp(-dt_s / memory_s), 0.0)
    return VelocityMatch(
        q.copy(),
        dq.copy(),
        rate,
        travel,
        travel_dq,
        before.checked_s + (weight_s - faded * before.checked_s),
        before.excess + (weight_s * excess * excess - faded * before.excess),
        before.square + (weight_s * travel * travel - faded * before.square),
        before.square_dq
        + (weight_s * travel_dq * travel_dq - faded * before.square_dq),
        before.product + (weight_s * travel * travel_dq - faded * before.product),
    )


def velocity_fault(match: VelocityMatch) -> str:
    """Return which velocities are not the rate of positions; "" if all are."""
    min_checked_s = 1.0  # of motion, before anything is reported
    # Smallest rms difference beyond the tolerated one, relative to the travel: a factor
    # of 1.2 between both is no fault. What no factor explains is one sooner: a lag.
    min_ratio = 0.15
    min_late_ratio = 0.02
    min_unexplained = 0.1
    unexplained = match.square * match.square_dq - np.square(match.product)
    is_late = unexplained > min_unexplained * match.square * match.square_dq
    ratio = np.where(is_late, min_late_ratio, min_ratio)
    is_wrong = match.excess > np.square(ratio) * match.square
    joints = np.flatnonzero(is_wrong & (match.checked_s >= min_checked_s))
    if not joints.size:
        return ""
    return f"dq at {named_joints(joints)} is not the rate of q [rad/s] in these samples"
