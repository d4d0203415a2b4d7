"""What makes a force doubtful and changes slowly: limits, singular poses, a misfit, velocities."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.jit import Matrix, Vector, compiled
from residual.errors import VelocityError
from residual.estimate import SensorWarning, WrenchEstimate
from residual.wrench_estimator import WrenchEstimator
from urdf import Robot

# Whether measured velocities are the rate of the measured positions, one look (pure functions).
#
# Both are summed to travel that fades within a second, q by its differences, dq by trapezoids
# between two looks. So a position that is coarse or held is off by one step at most, noise and
# vibration of the velocity average out, and what is left of a sound pair is the time by which one
# is later than the other. Travel of a joint that hardly moves tells nothing and is not looked at.


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
"""As in `residual.fault_detection`: a position that jumps has no rate."""
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


# Says in words what is wrong with a velocity that is not the rate of its position.


FACTORS = {
    math.degrees(1.0): "is it in deg/s?",
    math.radians(1.0): "is q in degrees?",
    30.0 / math.pi: "is it in revolutions per minute?",
    0.5 / math.pi: "is it in revolutions per second?",
    1.0: "is its sign the other one?",
}
"""Factors with a likely reason; each may come with the other sign."""
OTHER_FACTOR = "is it in other units, or of the motor before its gear, or are time stamps wrong?"
OTHER_JOINT = "is the order of the joints another?"
NEAR = 0.05
"""So near to one of these a factor is that one, to another joint's travel dq's is that one's."""
MOST_OFF = 0.4
"""Root mean square difference of dq's travel from q's, in times of it, that noise does not make."""
LEAST_OFF = 0.12
"""The same where another joint or a lag is just what makes it."""
UNEXPLAINED = 0.1
"""Share of dq's mean square travel that a factor may leave over, or a lag of the difference."""
LONGEST_LAG_S, LAG_SECONDS = 0.1, 2.0
"""A filtered velocity is late by 20 ms; what is late by more, over that much motion, is told."""
STILL = 1e-3
"""What moves by less than this share of the other stands still."""


class _Sums(NamedTuple):
    """What a match knows of one joint; squares and products as in `residual.consistency_checks`."""

    seconds: float
    beyond: float
    said: float
    change: float
    change_own: float
    change_said: float
    own: float
    product: float

    @property
    def difference(self) -> float:
        return self.said - 2.0 * self.product + self.own


def velocity_fault(match: NDArray[np.float64]) -> str:
    """What is wrong, joint by joint, with the likely reasons; empty if nothing surely is.

    Args:
        match: See `residual.consistency_checks`.
    """
    if not differs(match):
        return ""
    joints: dict[str, list[int]] = {}
    is_sure = False
    sums = [_sums_of(match, i) for i in range(match.shape[1])]
    off = [s.seconds >= LEAST_SECONDS and s.difference > LEAST_OFF**2 * s.own for s in sums]
    for i in np.flatnonzero(off).tolist():
        one = sums[i]
        fault, is_plain = _other(match, i, off) or _late(one), True
        if not fault and one.difference > MOST_OFF**2 * one.own:
            fault, is_plain = _factor(one), False
        if fault:
            joints.setdefault(fault, []).append(i)
            is_sure |= one.beyond > (LEAST_BEYOND if is_plain else MOST_OFF) ** 2 * one.own
    if not is_sure:
        return ""
    return "; ".join(f"dq at joint index {found} {fault}" for fault, found in joints.items())


def _sums_of(match: NDArray[np.float64], i: int) -> _Sums:
    rows = (SECONDS, BEYOND, SAID_SQUARE, CHANGE_SQUARE, CHANGE_TRAVEL, CHANGE_SAID)
    rows += (SQUARES + i, SQUARES + match.shape[1] + i)
    return _Sums(*match[list(rows), i].tolist())


def _other(match: NDArray[np.float64], i: int, off: list[bool]) -> str:
    """The joint whose rate a velocity is, if there is one: its own velocity is not sound either."""
    n = len(off)
    squares, products = match[SQUARES : SQUARES + n, i], match[SQUARES + n :, i]
    said, seconds = match[SAID_SQUARE, i], match[SECONDS]
    is_sound = (seconds >= LEAST_SECONDS) & ~np.array(off)
    moves = squares > seconds[i] * (0.2 * LEAST_TRAVEL_RAD) ** 2
    left = np.where(moves & ~is_sound, said - 2.0 * products + squares, np.inf)
    left[i] = np.inf
    other = int(np.argmin(left))
    if left[other] > NEAR**2 * said:
        return ""
    return f"is the rate of q at joint index {other}: {OTHER_JOINT}"


def _late(one: _Sums) -> str:
    """By how much a velocity is late, if that is all that is wrong.

    Least squares of dq's travel over q's and over the change of q's.
    """
    scale = one.own * one.change - one.change_own**2
    if scale <= 0.0 or one.seconds < LAG_SECONDS:
        return ""
    factor = (one.product * one.change - one.change_said * one.change_own) / scale
    late_s = (one.product * one.change_own - one.change_said * one.own) / scale
    left = one.said - factor * one.product + late_s * one.change_said
    explained = late_s**2 * one.change
    is_all = left < UNEXPLAINED * one.difference < 2.0 * UNEXPLAINED * explained
    if abs(late_s) < LONGEST_LAG_S or not is_all:
        return ""
    where = "behind" if late_s > 0.0 else "ahead of"
    return f"is {abs(late_s):.1f} s {where} q: is one of them late?"


def _factor(one: _Sums) -> str:
    """What a constant factor between velocity and rate stands for, or that there is none."""
    if one.said < STILL**2 * one.own:
        return "stands still while q moves: is it sent at all?"
    if one.own < STILL**2 * one.said:
        return "moves while q stands still: is q sent at all?"
    if one.product**2 < (1.0 - UNEXPLAINED) * one.said * one.own:
        return "does not follow q: is it late, stale, or another joint's?"
    factor, reason = float(f"{one.product / one.own:.2g}"), OTHER_FACTOR
    for known, text in FACTORS.items():
        if abs(abs(one.product) / one.own / known - 1.0) < NEAR:
            factor, reason = math.copysign(known, one.product), text
    if factor < 0.0 and factor != -1.0:
        reason = f"is its sign the other one, and {reason}"
    return f"is {factor:.3g} times the rate of q: {reason}"


LIMIT_MARGIN_RAD = 0.01
"""Half a degree from its limit a joint counts as being there."""
LEAST_SINGULAR_VALUE = 0.05
"""Below it a newton is a twentieth of a newton metre in all joints together: as much as the noise
of one torque sample."""
MISFIT_MEMORY_S = 0.2
"""A knock of a few milliseconds is no misfit."""
MOST_MISFIT = 4.0
"""The covariance holds for the arm that was tared; four times its standard deviation does not
happen by chance in all joints together."""

NO_TARE = (
    " No tare would hold: correct the velocities and move in free air anew, or force=True if you "
    "know better"
)
_REASONS = {
    SensorWarning.JOINT_LIMIT: "a joint is at its position limit",
    SensorWarning.NEAR_SINGULAR: "the joints hardly feel a force in this pose",
    SensorWarning.MODEL_MISMATCH: "the joint torques do not fit the assumed contact",
}


class SlowState(NamedTuple):
    """All that `ConsistencyMonitor` remember.

    Attributes:
        misfit_squared: Smoothed.
        cautions: Of the last look, as a number.
        match: Of measured velocities with positions, see `residual.consistency_checks`; None
            before a look, and where velocities are estimated.
    """

    misfit_squared: float = 0.0
    warnings: int = 0
    match: NDArray[np.float64] | None = None


class ConsistencyMonitor:
    """Looks now and then at what is too slow, and too dear, for every sample.

    Args:
        robot: Gives the position limits.
        wrench: Of the estimates that are judged.
    """

    def __init__(self, robot: Robot, wrench: WrenchEstimator) -> None:
        self._lower = robot.position_lower_rad + LIMIT_MARGIN_RAD
        self._upper = robot.position_upper_rad - LIMIT_MARGIN_RAD
        # A joint without a range has no limit: descriptions write 0 and 0 for "unknown".
        free = self._upper <= self._lower
        self._lower[free], self._upper[free] = -np.inf, np.inf
        self._wrench = wrench
        self.restore(SlowState())

    def look(
        self,
        q: NDArray[np.float64],
        dq: NDArray[np.float64] | None,
        residual: NDArray[np.float64],
        dt_s: float,
        *,
        tared: bool,
    ) -> None:
        """Look at the sample for which a wrench was just estimated.

        Args:
            q: Its configuration [rad], shape (n,).
            dq: Its velocity as measured [rad/s], shape (n,); None where it is estimated from q.
            residual: After offset removal [Nm], shape (n,).
            dt_s: Time since the last look [s].
            tared: Whether the residual's covariance is a fitted one.
        """
        found = SensorWarning.NONE
        if (q <= self._lower).any() or (q >= self._upper).any():
            found |= SensorWarning.JOINT_LIMIT
        if self._wrench.smallest_singular_value() < LEAST_SINGULAR_VALUE:
            found |= SensorWarning.NEAR_SINGULAR
        now = self._wrench.misfit_squared(residual) if tared else 0.0
        share = -math.expm1(-dt_s / MISFIT_MEMORY_S)
        square = self._misfit_squared + share * (now - self._misfit_squared)
        if square > MOST_MISFIT**2:
            found |= SensorWarning.MODEL_MISMATCH
        match = None if dq is None else self._matched(q, dq, dt_s)
        self.restore(SlowState(square, int(found), match))

    def _matched(
        self, q: NDArray[np.float64], dq: NDArray[np.float64], dt_s: float
    ) -> NDArray[np.float64]:
        """How velocities match positions after one more look."""
        if self._match is None or dt_s <= 0.0:
            return first_match(q, dq)
        return velocity_match_step(self._match, q, dq, dt_s)

    def check_velocity(self, *, force: bool) -> None:
        """Refuse a tare with velocities that are not the rate of positions.

        Args:
            force: Take it all the same.

        Raises:
            VelocityError: With what is wrong with them.
        """
        if self.velocity_fault and not force:
            raise VelocityError(self.velocity_fault + NO_TARE)

    def forget_velocity(self) -> None:
        """Compare velocities with positions anew."""
        warnings = self.warnings & ~SensorWarning.VELOCITY
        self.restore(SlowState(self._misfit_squared, int(warnings)))

    def recheck(self, last: WrenchEstimate) -> WrenchEstimate:
        """The last estimate, its `SensorWarning.MODEL_MISMATCH` raised if this sample misfits.

        Too dear for every sample, and a knock does it too: for what must not wait.
        """
        if self._wrench.misfit_squared(last.residual) <= MOST_MISFIT**2:
            return last
        message = "; ".join(filter(None, (last.message, _REASONS[SensorWarning.MODEL_MISMATCH])))
        return last._replace(warnings=last.warnings | SensorWarning.MODEL_MISMATCH, message=message)

    @property
    def state(self) -> SlowState:
        """All that is remembered."""
        return SlowState(self._misfit_squared, int(self.warnings), self._match)

    def restore(self, state: SlowState) -> None:
        """Go on from a `state` taken earlier."""
        self._misfit_squared = state.misfit_squared
        self.model_mismatch = math.sqrt(state.misfit_squared)
        """Smoothed misfit, see `WrenchEstimate`."""
        self._match = state.match
        self.velocity_fault = "" if state.match is None else velocity_fault(state.match)
        """What is wrong with measured velocities, in words; empty if nothing surely is."""
        told = SensorWarning.VELOCITY if self.velocity_fault else SensorWarning.NONE
        self.warnings = SensorWarning(state.warnings) | told
        """What was found at the last look."""
        reasons = [text for one, text in _REASONS.items() if one in self.warnings]
        self.message = "; ".join(filter(None, (self.velocity_fault, *reasons)))
        """The same in words."""
