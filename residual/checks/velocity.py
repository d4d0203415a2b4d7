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

from foundation.arrays import Blocks, Matrix, Vector
from foundation.jit import compiled
from residual.errors import Array, named_joints

TRAVEL_S = 1.0  # in which travel fades: if less, slow strokes look short; if more, bias adds up
MEMORY_S = 10.0
"""Memory of the comparison; time at rest does not count, so an arm that waits for its
tare does not forget."""
LONGEST_S = 0.2  # a trapezoid over a longer step means nothing
MOST_ACCELERATION_RAD_S2 = 20.0  # as in `residual.checks.outliers`: a jump has no rate
LEAST_TRAVEL_RAD = (
    0.015  # ten steps of a very coarse encoder; 60 mm in air make thrice as much
)
DQ_RATIO = 20.0  # with so many times that travel by dq alone a joint is checked whatever q does
TOLERATED_LAG_S = (
    0.03  # a filtered velocity or position is late by 20 ms, a held one by ten
)
TOLERATED_RAD = (
    0.02  # 6 rad/s^2 of a vibration of 50 Hz, seen every 20 ms, make this travel
)
LEAST_SECONDS = 1.0  # of motion, before anything is reported
LEAST_BEYOND = 0.01  # least rms difference beyond the tolerated, relative to the travel

FACTORS = {
    math.degrees(1.0): "is it in deg/s?",
    math.radians(1.0): "is q in degrees?",
    30.0 / math.pi: "is it in revolutions per minute?",
    0.5 / math.pi: "is it in revolutions per second?",
    1.0: "is its sign the other one?",
}
"""Factors with a likely reason; each may come with the other sign."""
OTHER_FACTOR = (
    "is it in other units, or of the motor before its gear, or are time stamps wrong?"
)
NEAR = 0.05
"""Relative distance within which a factor is one of these, or dq's travel is another
joint's."""
MOST_OFF = (
    0.4  # relative rms difference of dq's travel from q's that noise does not reach
)
LEAST_OFF = 0.12  # the same if another joint or a lag explains the difference
UNEXPLAINED = 0.1
"""Fraction that may be left: by a factor of dq's mean square travel, by a lag of the
difference."""
LONGEST_LAG_S = 0.1
LAG_SECONDS = 2.0
"""A longer lag is reported, after so many seconds of motion; a filtered velocity is
late by only 20 ms."""
STILL = (
    1e-3  # a signal whose travel is less than this fraction of the other's stands still
)

Sums = tuple[Vector, Vector, Blocks, Matrix, Matrix]


class VelocityMatch(NamedTuple):
    """How velocities match positions; the sums fade over `MEMORY_S` and are taken in
    motion.

    Attributes:
        motion: Position [rad], velocity as measured and rate of the position [rad/s] at
            the last check; then fading travel of q and of dq [rad]; shape (5, n).
        seconds: Time for which a joint has been checked [s], shape (n,).
        beyond: Sum of squares of the difference of both travels beyond the tolerated
            [rad^2 s], shape (n,).
        moments: Sums of pairwise products of dq's travel, q's, and the rate of q's;
            shape (n, 3, 3).
        squares: Row i, column j: square of the travel of joint j while joint i is
            judged [rad^2 s]; (n, n).
        products: Row i, column j: product of that travel with dq's of joint i, shape
            (n, n).
    """

    motion: Array
    seconds: Array
    beyond: Array
    moments: Array
    squares: Array
    products: Array


def first_match(q: Array, dq: Array) -> VelocityMatch:
    """A match that knows one check only, of position [rad] and velocity [rad/s],
    shape (n,).
    """
    n = len(q)
    still = np.zeros(len(q))
    sums = still, still, np.zeros((n, 3, 3)), np.zeros((n, n)), np.zeros((n, n))
    return VelocityMatch(np.stack((q, dq, still, still, still)), *sums)


@compiled
def travels(motion: Matrix) -> NDArray[np.bool_]:
    """Which joints have moved far enough to be checked, shape (n,)."""
    most = np.maximum(DQ_RATIO * np.abs(motion[3]), np.abs(motion[4]))
    return most > DQ_RATIO * LEAST_TRAVEL_RAD


@compiled
def travel_step(
    motion: Matrix, q: Vector, dq: Vector, dt_s: float
) -> tuple[Array, bool]:
    """``motion`` of a `VelocityMatch` at the next check, and whether any joint
    travels.
    """
    way = q - motion[0]
    way_dq = 0.5 * dt_s * (dq + motion[1])
    now = np.zeros_like(motion)
    now[0] = q
    now[1] = dq
    now[2] = way / dt_s
    jump = np.abs(now[2] - motion[2]).max()
    if jump <= MOST_ACCELERATION_RAD_S2 * dt_s and dt_s <= LONGEST_S:
        kept = math.exp(-dt_s / TRAVEL_S)
        now[3] = kept * motion[3] + way
        now[4] = kept * motion[4] + way_dq
    return now, bool(travels(now).any())


@compiled
def sums_step(
    last: Matrix, motion: Matrix, sums: Sums, dt_s: float
) -> tuple[Array, ...]:
    """What follows ``motion`` in a `VelocityMatch`, a time ``dt_s`` > 0 after the
    last motion.
    """
    a = motion[3]
    b = motion[4]
    way = motion[0] - last[0]
    way_dq = 0.5 * dt_s * (motion[1] + last[1])
    tolerated = TOLERATED_RAD + TOLERATED_LAG_S / dt_s * np.maximum(
        np.abs(way), np.abs(way_dq)
    )
    beyond = np.maximum(np.abs(b - a) - tolerated, 0.0) ** 2
    own = np.stack((b, a, (a - last[3]) / dt_s), axis=1)
    pairs = own.reshape(-1, 3, 1) * own.reshape(-1, 1, 3)
    faded = 1.0 - math.exp(-dt_s / MEMORY_S)
    moves = 1.0 * travels(motion)
    each = moves.reshape(-1, 1)
    row = (a * a).reshape(1, -1)
    return (
        sums[0] + moves * (dt_s - faded * sums[0]),
        sums[1] + moves * (dt_s * beyond - faded * sums[1]),
        sums[2] + each.reshape(-1, 1, 1) * (dt_s * pairs - faded * sums[2]),
        sums[3] + each * (dt_s * row - faded * sums[3]),
        sums[4] + each * (dt_s * np.outer(b, a) - faded * sums[4]),
    )


def velocity_match_step(
    match: VelocityMatch, q: Array, dq: Array, dt_s: float
) -> VelocityMatch:
    """The match after the next check, q [rad] and dq [rad/s], a time ``dt_s`` > 0
    later.
    """
    motion, is_moving = travel_step(match.motion, q, dq, dt_s)
    if not is_moving:
        return match._replace(motion=motion)
    return VelocityMatch(motion, *sums_step(match.motion, motion, match[1:], dt_s))


def velocity_fault(match: VelocityMatch) -> str:
    """What is wrong with velocities, joint by joint, with likely reasons; empty if
    nothing is.
    """
    square_dq = match.moments[:, 0, 0]
    product = match.moments[:, 0, 1]
    own = match.moments[:, 1, 1]
    differs = (match.beyond > LEAST_BEYOND**2 * own) & (match.seconds >= LEAST_SECONDS)
    if not differs.any():
        return ""
    difference = square_dq - 2.0 * product + own
    off = (match.seconds >= LEAST_SECONDS) & (difference > LEAST_OFF**2 * own)
    joints: dict[str, list[int]] = {}
    is_sure = False
    for i in np.flatnonzero(off).tolist():
        fault = _other_joint(match, i, off) or _late(match, i)
        least = LEAST_BEYOND
        if not fault and difference[i] > MOST_OFF**2 * own[i]:
            fault = _factor(match, i)
            least = MOST_OFF
        if fault:
            joints.setdefault(fault, []).append(i)
            is_sure |= bool(match.beyond[i] > least**2 * own[i])
    if not is_sure:
        return ""
    return "; ".join(
        f"dq at {named_joints(found)} {fault}" for fault, found in joints.items()
    )


def _other_joint(match: VelocityMatch, i: int, off: NDArray[np.bool_]) -> str:
    """The joint whose rate dq of joint i is, if there is one; its own dq must be
    wrong, too.
    """
    squares = match.squares[i]
    products = match.products[i]
    square_dq = match.moments[i, 0, 0]
    is_right = (match.seconds >= LEAST_SECONDS) & ~off
    moves = squares > match.seconds[i] * (0.2 * LEAST_TRAVEL_RAD) ** 2
    left = np.where(moves & ~is_right, square_dq - 2.0 * products + squares, np.inf)
    left[i] = np.inf
    other = int(np.argmin(left))
    if left[other] > NEAR**2 * square_dq:
        return ""
    return f"is the rate of q at {named_joints([other])}: is the order of the joints another?"


def _late(match: VelocityMatch, i: int) -> str:
    """Lag of a velocity, if that is all that is wrong.

    Found by least squares of dq's travel on q's and on the rate of q's.
    """
    (square_dq, *others), (product, own, _), (_, _, change) = match.moments[i]
    normal = match.moments[i, 1:, 1:]
    if np.linalg.det(normal) <= 0.0 or match.seconds[i] < LAG_SECONDS:
        return ""
    found = np.linalg.solve(normal, others)
    late_s = -found[1]
    left = square_dq - found.dot(others)
    difference = square_dq - 2.0 * product + own
    explained = late_s**2 * change
    is_all = left < UNEXPLAINED * difference < 2.0 * UNEXPLAINED * explained
    if abs(late_s) < LONGEST_LAG_S or not is_all:
        return ""
    where = "behind" if late_s > 0.0 else "ahead of"
    return f"is {abs(late_s):.1f} s {where} q: is one of them late?"


def _factor(match: VelocityMatch, i: int) -> str:
    """Likely reason of a constant factor between velocity and rate, or that there is
    none.
    """
    (square_dq, product, _), (_, own, _), _ = match.moments[i]
    if square_dq < STILL**2 * own:
        return "stands still while q moves: is it sent at all?"
    if own < STILL**2 * square_dq:
        return "moves while q stands still: is q sent at all?"
    if product**2 < (1.0 - UNEXPLAINED) * square_dq * own:
        return "does not follow q: is it late, stale, or another joint's?"
    factor = float(f"{product / own:.2g}")
    reason = OTHER_FACTOR
    for known, text in FACTORS.items():
        if abs(abs(product) / own / known - 1.0) < NEAR:
            factor = math.copysign(known, product)
            reason = text
    if factor < 0.0 and factor != -1.0:
        reason = f"is its sign the other one, and {reason}"
    return f"is {factor:.3g} times the rate of q: {reason}"
