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
from numpy.typing import NDArray

from foundation.arrays import Array, Blocks, Matrix, Vector
from foundation.jit import compiled, compiled_inside
from residual.errors import named_joints

TRAVEL_S = 1.0
"""Time constant with which travel fades: if it were less, slow strokes would look
short; if more, bias would add up."""

MEMORY_S = 10.0
"""Time constant of the sums that compare both travels. Time at rest does not count, so
an arm that waits for its tare does not forget."""

MAX_TRAPEZOID_S = 0.2
"""Longest time step over which a trapezoid of two velocities is a travel."""

MAX_ACCELERATION_RAD_S2 = 20.0
"""Largest acceleration of a joint, as in `residual.checks.outliers`: a position that
changes its rate faster has jumped."""

MIN_TRAVEL_RAD = 0.015
"""Smallest travel that is checked: ten steps of a very coarse encoder; 60 mm in air
make three times as much."""

DQ_TRAVEL_RATIO = 20.0
"""With so many times `MIN_TRAVEL_RAD` by dq alone a joint is checked, whatever q
does."""

TOLERATED_LAG_S = 0.03
"""Lag between position and velocity that is no fault: a filtered one is late by 20 ms,
a held one by ten."""

TOLERATED_RAD = 0.02
"""Difference of both travels that is no fault: 6 rad/s^2 of a vibration of 50 Hz, seen
every 20 ms, make it."""

MIN_CHECKED_S = 1.0
"""Time of motion before anything is reported."""

MIN_EXCESS_RATIO = 0.01
"""Smallest rms difference beyond what is tolerated that is a fault, relative to the
travel."""

FACTORS = {
    math.degrees(1.0): "is it in deg/s?",
    math.radians(1.0): "is q in degrees?",
    30.0 / math.pi: "is it in revolutions per minute?",
    0.5 / math.pi: "is it in revolutions per second?",
    1.0: "is its sign the other one?",
}
"""Factors between velocity and rate with a likely reason; each may come with the other
sign."""

OTHER_FACTOR = (
    "is it in other units, or of the motor before its gear, or are time stamps wrong?"
)
"""Likely reasons of any other factor."""

FACTOR_TOLERANCE = 0.05
"""Relative distance within which a factor is one of `FACTORS`, or the travel of dq is
that of another joint."""

MAX_DIFFERENCE_RATIO = 0.4
"""Relative rms difference of both travels that noise does not reach."""

MIN_DIFFERENCE_RATIO = 0.12
"""The same where another joint or a lag explains the difference."""

MAX_UNEXPLAINED_RATIO = 0.1
"""Fraction that an explanation may leave over: a factor, of the mean square travel of
dq; a lag, of the difference."""

MIN_REPORTED_LAG_S = 0.1
"""Shortest lag that is reported; a filtered velocity is late by only 20 ms."""

MIN_LAG_CHECKED_S = 2.0
"""Time of motion before a lag is reported."""

STANDS_STILL = "stands still while q moves: is it sent at all?"
"""The fault of velocities that are zeros or another constant."""

STILL_RATIO = 1e-3
"""A signal whose travel is less than this fraction of the other's stands still."""

MIN_OTHER_TRAVEL_RATIO = 0.2
"""Travel of another joint that may be the one meant, relative to `MIN_TRAVEL_RAD`."""


class JointTravel(NamedTuple):
    """Motion of the joints at a check; arrays of shape (n,), never written again.

    Attributes:
        q: Position [rad].
        dq: Velocity as measured [rad/s].
        rate: Rate of the position since the check before [rad/s].
        travel: Travel of the position, fading [rad].
        travel_dq: Travel by the measured velocity, fading [rad].
        excess: Square of the difference of both travels beyond the tolerated [rad^2].
    """

    q: Array
    dq: Array
    rate: Array
    travel: Array
    travel_dq: Array
    excess: Array


class TravelSums(NamedTuple):
    """Sums over the time in motion, fading over `MEMORY_S`; never written again.

    Attributes:
        checked_s: Time for which a joint has been checked, shape (n,).
        excess: Sum of `JointTravel.excess` [rad^2 s], shape (n,).
        moments: Sums of pairwise products of dq's travel, q's, and the rate of q's;
            shape (n, 3, 3).
        squares: Row i, column j: square of the travel of joint j while joint i is
            judged [rad^2 s]; (n, n).
        products: Row i, column j: product of that travel with dq's of joint i, shape
            (n, n).
    """

    checked_s: Array
    excess: Array
    moments: Array
    squares: Array
    products: Array


class VelocityMatch(NamedTuple):
    """How measured velocities match positions.

    Attributes:
        motion: At the last check.
        sums: Of all checks.
    """

    motion: JointTravel
    sums: TravelSums


def first_match(q: Array, dq: Array) -> VelocityMatch:
    """Return the match after a first check, of position [rad] and velocity [rad/s]."""
    n = len(q)
    zeros = np.zeros(n)
    motion = JointTravel(q.copy(), dq.copy(), zeros, zeros, zeros, zeros)
    sums = TravelSums(
        checked_s=zeros,
        excess=zeros,
        moments=np.zeros((n, 3, 3)),
        squares=np.zeros((n, n)),
        products=np.zeros((n, n)),
    )
    return VelocityMatch(motion, sums)


@compiled_inside
def is_travelling(travel: float, travel_dq: float) -> bool:
    """Return whether a joint has moved far enough to be checked."""
    scaled_rad = max(DQ_TRAVEL_RATIO * abs(travel), abs(travel_dq))
    return scaled_rad > DQ_TRAVEL_RATIO * MIN_TRAVEL_RAD


@compiled
def is_any_travelling(travel: Vector, travel_dq: Vector) -> bool:
    """Return whether any joint has moved far enough; arguments of shape (n,)."""
    is_any = False
    for j in range(len(travel)):
        is_any = is_any or is_travelling(travel[j], travel_dq[j])
    return is_any


@compiled
def travel_step(
    q_before: Vector,
    dq_before: Vector,
    rate_before: Vector,
    travel_before: Vector,
    travel_dq_before: Vector,
    q: Vector,
    dq: Vector,
    dt_s: float,
) -> JointTravel:
    """Return the motion at a check, a time ``dt_s`` > 0 after the check before.

    Arguments are fields of the `JointTravel` before and position and velocity now.
    Where a position has jumped, or the step is too long, travel begins anew.
    """
    joints = len(q)
    rate = np.zeros(joints)
    travel = np.zeros(joints)
    travel_dq = np.zeros(joints)
    excess = np.zeros(joints)
    max_rate_change = 0.0
    for j in range(joints):
        rate[j] = (q[j] - q_before[j]) / dt_s
        max_rate_change = max(max_rate_change, abs(rate[j] - rate_before[j]))
    is_smooth = max_rate_change <= MAX_ACCELERATION_RAD_S2 * dt_s
    is_continued = is_smooth and dt_s <= MAX_TRAPEZOID_S
    fading = math.exp(-dt_s / TRAVEL_S)
    for j in range(joints):
        step = q[j] - q_before[j]
        step_dq = 0.5 * dt_s * (dq[j] + dq_before[j])
        if is_continued:
            travel[j] = fading * travel_before[j] + step
            travel_dq[j] = fading * travel_dq_before[j] + step_dq
        larger_step = max(abs(step), abs(step_dq))
        tolerated = TOLERATED_RAD + TOLERATED_LAG_S / dt_s * larger_step
        excess[j] = max(abs(travel_dq[j] - travel[j]) - tolerated, 0.0) ** 2
    return JointTravel(q.copy(), dq.copy(), rate, travel, travel_dq, excess)


@compiled
def sums_step(
    checked_s: Vector,
    excess_sum: Vector,
    moments: Blocks,
    squares: Matrix,
    products: Matrix,
    travel_before: Vector,
    travel: Vector,
    travel_dq: Vector,
    excess: Vector,
    dt_s: float,
) -> TravelSums:
    """Return the sums after a check, a time ``dt_s`` > 0 after the check before.

    The first arguments are the fields of the `TravelSums` before; then follow travel at
    the check before, and fields of the `JointTravel` now.
    """
    joints = len(travel)
    faded = 1.0 - math.exp(-dt_s / MEMORY_S)
    sums = TravelSums(
        checked_s.copy(),
        excess_sum.copy(),
        moments.copy(),
        squares.copy(),
        products.copy(),
    )
    travels = np.zeros(3)
    for i in range(joints):
        if not is_travelling(travel[i], travel_dq[i]):
            continue
        sums.checked_s[i] += dt_s - faded * checked_s[i]
        sums.excess[i] += dt_s * excess[i] - faded * excess_sum[i]
        travels[0] = travel_dq[i]
        travels[1] = travel[i]
        travels[2] = (travel[i] - travel_before[i]) / dt_s
        for a in range(3):
            for b in range(3):
                sums.moments[i, a, b] += (
                    dt_s * travels[a] * travels[b] - faded * moments[i, a, b]
                )
        for j in range(joints):
            sums.squares[i, j] += dt_s * travel[j] ** 2 - faded * squares[i, j]
            sums.products[i, j] += (
                dt_s * travel_dq[i] * travel[j] - faded * products[i, j]
            )
    return sums


def velocity_match_step(
    match: VelocityMatch, q: Array, dq: Array, dt_s: float
) -> VelocityMatch:
    """Return the match after the next check, a time ``dt_s`` > 0 later.

    Position [rad] and velocity [rad/s] have shape (n,).
    """
    motion_before = match.motion
    motion = travel_step(
        motion_before.q,
        motion_before.dq,
        motion_before.rate,
        motion_before.travel,
        motion_before.travel_dq,
        q,
        dq,
        dt_s,
    )
    if not is_any_travelling(motion.travel, motion.travel_dq):
        return VelocityMatch(motion, match.sums)
    sums = sums_step(
        *match.sums,
        motion_before.travel,
        motion.travel,
        motion.travel_dq,
        motion.excess,
        dt_s,
    )
    return VelocityMatch(motion, sums)


@compiled
def has_excess(checked_s: Vector, excess: Vector, moments: Blocks) -> bool:
    """Return whether travels of any joint differ by far more than is tolerated.

    Arguments are fields of `TravelSums`.
    """
    for i in range(len(excess)):
        is_large = excess[i] > MIN_EXCESS_RATIO**2 * moments[i, 1, 1]
        if is_large and checked_s[i] >= MIN_CHECKED_S:
            return True
    return False


def velocity_fault(match: VelocityMatch) -> str:
    """Return the faults of velocities by joint, with likely reasons; "" without one."""
    sums = match.sums
    if not has_excess(sums.checked_s, sums.excess, sums.moments):
        return ""
    is_checked = sums.checked_s >= MIN_CHECKED_S
    square_dq = sums.moments[:, 0, 0]
    product = sums.moments[:, 0, 1]
    square = sums.moments[:, 1, 1]
    difference = square_dq - 2.0 * product + square
    differs = is_checked & (difference > MIN_DIFFERENCE_RATIO**2 * square)
    joints_by_fault: dict[str, list[int]] = {}
    is_sure = False
    for i in np.flatnonzero(differs).tolist():
        fault = _other_joint_fault(sums, i, differs) or _lag_fault(sums, i)
        min_ratio = MIN_EXCESS_RATIO
        if not fault and difference[i] > MAX_DIFFERENCE_RATIO**2 * square[i]:
            fault = _factor_fault(sums, i)
            min_ratio = MAX_DIFFERENCE_RATIO
        if fault:
            joints_by_fault.setdefault(fault, []).append(i)
            is_sure |= bool(sums.excess[i] > min_ratio**2 * square[i])
    if not is_sure:
        return ""
    return "; ".join(
        f"dq at {named_joints(joints)} {fault}"
        for fault, joints in joints_by_fault.items()
    )


def is_velocity_missing(fault: str) -> bool:
    """Return whether a `velocity_fault` has velocities that stand still, and no others.

    There is then nothing in them to be corrected.
    """
    return all(text.endswith(STANDS_STILL) for text in fault.split("; "))


def _other_joint_fault(sums: TravelSums, i: int, differs: NDArray[np.bool_]) -> str:
    """Return that dq of joint i is the rate of another joint; "" if it is none's.

    The other joint's own dq must be wrong, too.
    """
    squares = sums.squares[i]
    square_dq = sums.moments[i, 0, 0]
    is_right = (sums.checked_s >= MIN_CHECKED_S) & ~differs
    min_travel_rad = MIN_OTHER_TRAVEL_RATIO * MIN_TRAVEL_RAD
    is_moving = squares > sums.checked_s[i] * min_travel_rad**2
    difference = square_dq - 2.0 * sums.products[i] + squares
    difference = np.where(is_moving & ~is_right, difference, np.inf)
    difference[i] = np.inf
    other = int(np.argmin(difference))
    if difference[other] > FACTOR_TOLERANCE**2 * square_dq:
        return ""
    return (
        f"is the rate of q at {named_joints([other])}: is the order of the joints "
        "another?"
    )


def _lag_fault(sums: TravelSums, i: int) -> str:
    """Return the lag of a velocity if that is all that is wrong, else "".

    It is found by least squares of dq's travel on q's and on the rate of q's.
    """
    moments = sums.moments[i]
    square_dq = moments[0, 0]
    normal_matrix = moments[1:, 1:]
    right_side = moments[0, 1:]
    if np.linalg.det(normal_matrix) <= 0.0 or sums.checked_s[i] < MIN_LAG_CHECKED_S:
        return ""
    coefficients = np.linalg.solve(normal_matrix, right_side)
    lag_s = -coefficients[1]
    remaining = square_dq - coefficients.dot(right_side)
    difference = square_dq - 2.0 * moments[1, 0] + moments[1, 1]
    explained = lag_s**2 * moments[2, 2]
    tolerated = MAX_UNEXPLAINED_RATIO * difference
    is_all = remaining < tolerated < 2.0 * MAX_UNEXPLAINED_RATIO * explained
    if abs(lag_s) < MIN_REPORTED_LAG_S or not is_all:
        return ""
    side = "behind" if lag_s > 0.0 else "ahead of"
    return f"is {abs(lag_s):.1f} s {side} q: is one of them late?"


def _factor_fault(sums: TravelSums, i: int) -> str:
    """Return the constant factor between velocity and rate, or that there is none."""
    square_dq = sums.moments[i, 0, 0]
    product = sums.moments[i, 0, 1]
    square = sums.moments[i, 1, 1]
    if square_dq < STILL_RATIO**2 * square:
        return STANDS_STILL
    if square < STILL_RATIO**2 * square_dq:
        return "moves while q stands still: is q sent at all?"
    if product**2 < (1.0 - MAX_UNEXPLAINED_RATIO) * square_dq * square:
        return "does not follow q: is it late, stale, or another joint's?"
    factor = float(f"{product / square:.2g}")
    reason = OTHER_FACTOR
    for known_factor, known_reason in FACTORS.items():
        if abs(abs(product) / square / known_factor - 1.0) < FACTOR_TOLERANCE:
            factor = math.copysign(known_factor, product)
            reason = known_reason
    if factor < 0.0 and factor != -1.0:
        reason = f"is its sign the other one, and {reason}"
    return f"is {factor:.3g} times the rate of q: {reason}"
