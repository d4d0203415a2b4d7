"""Slow checks: joint limits, singular poses, model mismatch, pushes on the arm,
velocities.

Measured velocities should be the rate of the measured positions. To check this, the
travel of the last second (fading) is summed from the differences of q, and from dq by
trapezoids between two checks. A coarse or held position is then off by one step at
most, noise and vibration of the velocity average out, and a valid pair differs only by
the lag between the two. Travel of a joint that hardly moves means nothing and is not
used.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.jit import Blocks, Matrix, Vector, compiled
from residual.errors import Array, named_joints
from residual.estimate import SensorWarning, WrenchEstimate
from residual.wrench_estimator import WrenchEstimator
from urdf import Robot

TRAVEL_S = 1.0  # in which travel fades: if less, slow strokes look short; if more, bias adds up
MEMORY_S = 10.0
"""Memory of the comparison; time at rest does not count, so an arm that waits for its
tare does not forget."""
LONGEST_S = 0.2  # a trapezoid over a longer step means nothing
MOST_ACCELERATION_RAD_S2 = 20.0  # as in `residual.fault_detection`: a jump has no rate
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

LIMIT_MARGIN_RAD = 0.01  # half a degree from its limit a joint counts as being there
MOST_RAD = (
    4.0 * math.pi
)  # two turns: beyond a limit and this a position is hardly in radians
LEAST_SINGULAR_VALUE = 0.05
"""[m] At this value a newton makes a twentieth of a newton metre in all joints
together, as much as the noise of one torque sample; below it the pose is near singular."""
MISMATCH_MEMORY_S = 0.2  # a knock of a few milliseconds is no model mismatch
MOST_MISMATCH = 4.0  # so many standard deviations in all joints together are no chance
# memory of the torque now, before, of their difference
NOW_S = 0.06
BEFORE_S = 0.6
USUAL_S = 8.0
PUSHED = 15.0
LET_GO = 12.0
USUAL = 6.0
BESIDE = 4.0
"""Mean square of a torque change that no wrench explains, in units of the usual one.
From PUSHED on the arm is pushed, until below LET_GO; below USUAL it is learnt as usual.
From BESIDE on, for what no axial force explains, a rupture is not reported."""
LONGEST_PUSH_S = 2.5  # what lasts longer is no hand's push: a cable, or another load
LEARNED_S = 1.0  # learning time before anything is called unusual
LEAST_CHANGE_NM = 3e-4
CHANGE_ERROR = 0.02
"""A change up to this may be hysteresis of a joint's sensor; one up to this fraction of
the largest explained change may be an error of the lever arms."""


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


class TorqueChange(NamedTuple):
    """Joint torque without its offset, now and before, both smoothed.

    Attributes:
        torques: Torque now; torque before, kept while the arm is pushed [Nm]; then the
            mean product of their differences [Nm^2]; shape (n + 2, n).
        learned_s: Time over which that product was learned.
        pushed_s: Time since the arm has been pushed.
    """

    torques: Array
    learned_s: float = 0.0
    pushed_s: float = 0.0


@compiled
def unexplained_change(
    rows: Matrix, covariance: Matrix, change: Vector
) -> tuple[float, Array]:
    """Like `unusual_change`, for a given covariance [Nm^2]; also the explained part
    [Nm], (n,).
    """
    precision = np.linalg.inv(covariance).T  # the same, with its rows in order
    weighted = rows.dot(precision)
    information = weighted.dot(rows.T)
    # What no joint feels is left at zero.
    information += (1e-12 * np.trace(information) + 1e-30) * np.eye(len(rows))
    explained = np.linalg.solve(information, weighted.dot(change)).dot(rows)
    left = change - explained
    return left.dot(precision).dot(left) / (len(change) - len(rows)), explained


@compiled
def unusual_change(rows: Matrix, change: Vector, usual: Matrix, enough: float) -> float:
    """Mean square of a change of joint torque [Nm], shape (n,), that no wrench
    explains.

    Unknowns make torque by ``rows``, (k, n). The unit is ``usual``, the mean product of
    changes without a push [Nm^2], shape (n, n), shrunk towards its diagonal. A value
    beyond ``enough`` is computed again with errors of sensors and lever arms in the
    explained part, which lowers it.
    """
    if len(rows) >= len(change):
        return 0.0
    covariance = 0.8 * usual + np.diag(0.2 * np.diag(usual) + LEAST_CHANGE_NM**2)
    square, explained = unexplained_change(rows, covariance, change)
    if square > enough:
        covariance += (CHANGE_ERROR * np.abs(explained).max()) ** 2 * np.eye(
            len(change)
        )
        square, explained = unexplained_change(rows, covariance, change)
    return square


@compiled
def change_step(
    rows: Matrix,
    residual: Vector,
    last: Matrix,
    learned_s: float,
    pushed_s: float,
    dt_s: float,
) -> tuple[Array, float, float]:
    """The next `TorqueChange` after the last, from a residual [Nm] a time ``dt_s`` >
    0 later.
    """
    torques = last.copy()
    square = 0.0
    now = torques[0]
    before = torques[1]
    usual = torques[2:]
    now -= math.expm1(-dt_s / NOW_S) * (residual - now)
    change = now - before
    if learned_s >= LEARNED_S:
        square = unusual_change(rows, change, usual, USUAL)
    if square > (LET_GO if pushed_s > 0.0 else PUSHED):
        if pushed_s < LONGEST_PUSH_S:
            return torques, learned_s, pushed_s + dt_s
        before[:] = now
    if square < USUAL:
        learned_s += dt_s
        usual += min(dt_s / min(learned_s, USUAL_S), 1.0) * (
            np.outer(change, change) - usual
        )
    before -= math.expm1(-dt_s / BEFORE_S) * (now - before)
    return torques, learned_s, 0.0


class MonitorState(NamedTuple):
    """All that a `ConsistencyMonitor` remembers.

    Attributes:
        widening: Factor by which the covariance in use was widened.
        warnings: Of the last check, as a number.
        at_limit: Indices of joints at a position limit in that check.
        match: Of measured velocities with positions; None before a check, and where
            velocities are estimated.
        change: None before the tare.
    """

    mismatch_squared: float = (
        0.0  # Smoothed, in units of the covariance before it was widened
    )
    widening: float = 1.0
    warnings: int = 0
    at_limit: tuple[int, ...] = ()
    match: VelocityMatch | None = None
    change: TorqueChange | None = None


class ConsistencyMonitor:
    """Checks, every few samples, what changes slowly and costs too much for every
    sample.

    Attributes:
        state: All that it remembers; its arrays are never written again.
        mismatch: Smoothed model mismatch, see `WrenchEstimate`.
        velocity_fault: What is surely wrong with measured velocities, in words; empty
            if nothing is.
        warnings: Warnings of the last check.
        message: The same in words.
    """

    def __init__(self, robot: Robot, wrench: WrenchEstimator) -> None:
        lower = robot.position_lower_rad + LIMIT_MARGIN_RAD
        upper = robot.position_upper_rad - LIMIT_MARGIN_RAD
        # A joint without a range has no limit: descriptions write 0 and 0 for
        # "unknown".
        free = upper <= lower
        self._lower = np.where(free, -np.inf, lower).tolist()
        self._upper = np.where(free, np.inf, upper).tolist()
        self._wrench = wrench
        self.restore(MonitorState())

    def check(
        self, q: Array, dq: Array | None, residual: Array, dt_s: float, *, tared: bool
    ) -> None:
        """Check the sample for which a wrench was just estimated.

        Its configuration [rad], its velocity as measured [rad/s], None where it is
        estimated, and its residual after offset removal [Nm] have shape (n,); ``dt_s``
        is the time since the last check [s], ``tared`` says whether the residual's
        covariance is a fitted one.
        """
        found = SensorWarning.NONE
        lower = self._lower
        upper = self._upper
        at_limit = tuple(
            i for i, at in enumerate(q.tolist()) if not lower[i] < at < upper[i]
        )
        if at_limit:
            found |= SensorWarning.JOINT_LIMIT
        if self._wrench.gain.weakest_m < LEAST_SINGULAR_VALUE:
            found |= SensorWarning.NEAR_SINGULAR
        widening = self.state.widening
        last = self.state.mismatch_squared
        now = widening * self._wrench.mismatch_squared(residual) if tared else 0.0
        square = last - math.expm1(-dt_s / MISMATCH_MEMORY_S) * (now - last)
        if square > MOST_MISMATCH**2:
            found |= SensorWarning.MODEL_MISMATCH
        change = self._changed(residual, dt_s) if tared else None
        if change is not None and change.pushed_s > 0.0:
            found |= SensorWarning.ARM_PUSHED
        match = self.state.match
        if dq is None:
            match = None
        elif match is None or dt_s <= 0.0:
            match = first_match(q, dq)
        else:
            match = velocity_match_step(match, q, dq, dt_s)
        last_match = self.state.match
        fault = self.velocity_fault
        self.state = MonitorState(square, widening, int(found), at_limit, match, change)
        # While nothing moves the sums stay.
        if match is None or last_match is None or match.beyond is not last_match.beyond:
            fault = "" if match is None else velocity_fault(match)
        self._report(fault)

    def _changed(self, residual: Array, dt_s: float) -> TorqueChange:
        """The next `TorqueChange`: how far torques have changed as no wrench changes
        them.
        """
        last = self.state.change
        n = len(residual)
        if last is None or dt_s <= 0.0:
            return last or TorqueChange(
                np.vstack((residual, residual, np.zeros((n, n))))
            )
        return TorqueChange(*change_step(self._wrench.rows, residual, *last, dt_s))

    @property
    def _wanted(self) -> float:
        return 1.0 + 2.0 * max(0.0, self.state.mismatch_squared - 1.0)

    @property
    def wants_widening(self) -> bool:
        """Whether the covariance in use is clearly too small for what is seen now."""
        return self._wanted > 1.1 * self.state.widening

    def widened(self, covariance_Nm2: Array) -> Array:
        """A covariance widened by what no wrench explains: a push on the arm, a wrong
        model.

        This is the variance factor of least squares: errors seen in directions that no
        wrench explains are likely in the other directions, too. Twice that, since four
        directions show a variance only within a factor of two.
        """
        self.state = self.state._replace(widening=self._wanted)
        return self.state.widening * covariance_Nm2

    def forget_velocity(self) -> None:
        """Compare velocities with positions anew."""
        warnings = int(self.warnings & ~SensorWarning.VELOCITY)
        self.restore(self.state._replace(match=None, warnings=warnings))

    def recheck(self, last: WrenchEstimate, before: WrenchEstimate) -> WrenchEstimate:
        """The last estimate, with a warning if its torques, or their change, fit no
        needle force.

        Meant for alarms and for the end of a gap, not for every sample: a knock raises
        it, too. The sample before must show it as well, since an arm that brakes hard
        raises it for one sample.
        """
        square = min(
            self._wrench.mismatch_squared(each.residual) for each in (last, before)
        )
        is_off = self.state.widening * square > MOST_MISMATCH**2
        found = SensorWarning.MODEL_MISMATCH if is_off else SensorWarning.NONE
        if (change := self.state.change) is not None and change.learned_s >= LEARNED_S:
            axial = self._wrench.kinematics.axial_jacobian[None]
            torques = change.torques
            if (
                unusual_change(axial, torques[0] - torques[1], torques[2:], BESIDE)
                > BESIDE
            ):
                found |= SensorWarning.ARM_PUSHED
        reasons = [text for one, text in _REASONS.items() if one in found]
        message = "; ".join(filter(None, (last.message, *reasons)))
        return last._replace(warnings=last.warnings | found, message=message)

    @property
    def limit(self) -> str:
        """Which joints are at a position limit, in words; empty if none is."""
        at_limit = self.state.at_limit
        return f"at a position limit: {named_joints(at_limit)}" if at_limit else ""

    @property
    def question(self) -> str:
        """The same if positions are so far beyond that they are hardly in radians;
        else empty.
        """
        is_far = (
            self.state.at_limit and np.abs(self._wrench.gain.rows[0]).max() > MOST_RAD
        )
        return f"{self.limit}: is q in degrees?" if is_far else ""

    def restore(self, state: MonitorState) -> None:
        """Go on from a `state` taken earlier."""
        self.state = state
        self._report("" if state.match is None else velocity_fault(state.match))

    def _report(self, velocity_fault: str) -> None:
        self.velocity_fault = velocity_fault
        self.message = ""
        self.mismatch = math.sqrt(self.state.mismatch_squared)
        self.warnings = SensorWarning(self.state.warnings)
        if self.velocity_fault:
            self.warnings |= SensorWarning.VELOCITY
        if self.warnings:
            reasons = [text for one, text in _REASONS.items() if one in self.warnings]
            self.message = "; ".join(
                filter(
                    None, (self.velocity_fault, self.question or self.limit, *reasons)
                )
            )


_REASONS = {
    SensorWarning.NEAR_SINGULAR: "the joints hardly feel a force in this pose",
    SensorWarning.MODEL_MISMATCH: "the joint torques do not fit the assumed contact",
    SensorWarning.ARM_PUSHED: "the joint torques change as no force at the tip changes them",
}
