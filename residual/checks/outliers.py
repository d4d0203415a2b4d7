"""Rejects valid numbers that are no measurements: spikes, frozen or saturated signals.

A sample is predicted from the one before and from what an arm can do in the time. Where
a signal is further off than its own noise allows, learnt in the first half second, it
has jumped; before that nothing counts as a jump or as frozen. So has a velocity that
positions contradict for a moment. A rejected sample is treated like a lost one: time
passes, the estimate stays.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled, compiled_inside
from residual.checks.input import MAX_PLAUSIBLE, ROUNDING_S, check_rows, known_limits
from residual.checks.noise import (
    LEARNING_S,
    NoiseProbe,
    find_new,
    is_noise_resolved,
    white_noise,
)
from residual.errors import SampleError, named_joints
from residual.estimate import SensorWarning
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

MAX_ACCELERATION_RAD_S2 = 20.0
"""Largest acceleration of a joint: an arm that inserts a needle stays far below."""

UNKNOWN_EFFORT_NM = 300.0
"""Stands in where a description gives no effort limit: the shoulder of an arm for ten
kilograms. Torques from motor currents step by 20 Nm there where the friction of its
gears turns round."""

MAX_HOLD_S = 0.1
"""Longest time for which a signal that jumps is held back, whatever it does."""

MAX_USUAL_S = 0.1
"""Longest repeat that is learnt as usual: no source of positions or torques is slower
than ten samples a second."""

MAX_REFUSAL_S = 5.0
"""After this time nothing is rejected as frozen any more, only reported: should a valid
signal fall still after all, on an arm at rest, then not for ever."""

SATURATED_RATIO = 0.99
"""Fraction of the effort limit from which a torque counts as clipped."""

MIN_ALONE_S = 0.5
"""Shortest repeat of a single torque that is reported."""

# What is known of each signal of the samples: rows of a matrix, a column per signal.

LAST = 0
"""Row of the last accepted sample."""

BEFORE = 1
"""Row of the accepted sample before it."""

GATE = 2
"""Row of the largest jump within no time that is no fault."""

STILL = 3
"""Row of the time for which the signal has repeated bit for bit [s]."""

HELD = 4
"""Row of the last sample that was held back for a jump."""

SIGNAL_ROWS = 5
"""Number of these rows."""

# What is known of each joint: rows of another matrix, a column per joint.

VELOCITY = 0
"""Row of the velocity of the last sample, measured or estimated [rad/s]."""

DEVIATION = 1
"""Row of the deviation of that from the rate of positions [rad/s]."""

USUAL = 2
"""Row of the usual square of a change of this deviation [rad^2/s^2]."""

SWEPT = 3
"""Row of the travel that a position which repeats may lag by [rad]."""

JOINT_ROWS = 4
"""Number of these rows."""

INVALID = 1
"""Bit of `judge_step`: a number is not finite, or too large."""

JUMPED = 2
"""Bit of `judge_step`: a signal has jumped."""

NO_RATE = 4
"""Bit of `judge_step`: velocities are not the rate of positions."""

SATURATED = 8
"""Bit of `judge_step`: a torque is at its limit."""

FROZEN_MOTION = 16
"""Bit of `judge_step`: positions and velocities of all joints are stuck."""

FROZEN_TORQUE = 32
"""Bit of `judge_step`: torques of all joints are stuck."""


@compiled_inside
def largest_change(
    k: int,
    known: Matrix,
    joints: Matrix,
    effort_Nm: Vector,
    dt_s: float,
    step_s: float,
    delay_s: float,
) -> float:
    """Return how far a signal may be off from what is expected after a time.

    Arguments are those of `find_jumps`, and the signal's number.
    """
    # Stamps of a computer may be off from those of the robot by so much: at the speeds
    # of a needle that is nothing, 0.1 rad/s make half a milliradian of it.
    clock_error_s = 5e-3
    # A joint at rest shows its encoder's step at times, and not in the learnt noise:
    # three of an encoder on the link, which resolves 0.01 degrees.
    coarse_step_rad = 5e-4
    torque_ratio_per_s = 2.0  # of the effort limit, for lost samples
    count = joints.shape[1]
    of_torque = k - known.shape[1] + count
    gate = known[GATE, k]
    if of_torque >= 0:
        return gate + torque_ratio_per_s * dt_s * effort_Nm[of_torque]
    if k >= count:
        return gate + MAX_ACCELERATION_RAD_S2 * dt_s
    gate += abs(joints[VELOCITY, k]) * (dt_s + clock_error_s) + joints[SWEPT, k]
    gate += MAX_ACCELERATION_RAD_S2 * dt_s * (dt_s + delay_s)
    if step_s > 0.0:
        own_step = abs(known[LAST, k] - known[BEFORE, k])
        gate += coarse_step_rad if own_step == 0.0 else min(own_step, coarse_step_rad)
    return gate


@compiled
def find_jumps(
    has_jumped: WrittenVector,
    signals: Vector,
    reference: Vector,
    known: Matrix,
    joints: Matrix,
    effort_Nm: Vector,
    dt_s: float,
    step_s: float,
    delay_s: float,
) -> bool:
    """Find the signals that have changed further than an arm can move them.

    Args:
        has_jumped: Output: 1 for a signal that has, 0 for others, shape (size,).
        signals: A sample: n positions [rad], velocities if there are any [rad/s],
            torques [Nm].
        reference: An earlier one.
        known: See `LAST` and the others, shape (5, size).
        joints: See `VELOCITY` and the others, shape (4, n).
        effort_Nm: Effort limits, or what stands in for them, shape (n,).
        dt_s: Time from the reference to the sample.
        step_s: Time between the last two accepted samples; 0 before two.
        delay_s: Age of the velocity.

    Returns:
        Whether there is one.
    """
    count = joints.shape[1]
    is_any = False
    for k in range(len(signals)):
        gate = largest_change(k, known, joints, effort_Nm, dt_s, step_s, delay_s)
        change = signals[k] - reference[k]
        expected = joints[VELOCITY, k] * dt_s if k < count else 0.0
        is_off = abs(change - expected) > gate
        if step_s > 0.0:
            # A fast arm goes on as it did: no single sample that is far off does.
            course = (known[LAST, k] - known[BEFORE, k]) * (dt_s / step_s)
            is_off = is_off and abs(change - course) > gate
        has_jumped[k] = 1.0 if is_off else 0.0
        is_any = is_any or is_off
    return is_any


@compiled_inside
def rate_deviation(signals: Vector, known: Matrix, count: int, dt_s: float) -> Array:
    """Return the deviation of velocities from the rate of positions [rad/s], (n,).

    Arguments are those of `judge_step`, and the number n of joints.
    """
    return signals[count : 2 * count] - (signals[:count] - known[LAST, :count]) / dt_s


@compiled_inside
def rate_error(
    signals: Vector,
    known: Matrix,
    joints: Matrix,
    dt_s: float,
    step_s: float,
    compared_s: float,
) -> float:
    """Return how far velocities are from the rate of positions, beside their usual.

    Velocities may be late: what counts is how far their deviation from the rate of
    positions has changed since the last sample, and at most how far they have changed
    themselves, since a position may have jumped. Arguments are those of `judge_step`.

    Returns:
        The sum over the joints of the squared changes, in units of the usual ones; 0
        until these are known, and after a gap.
    """
    jerk_rad_s2 = 0.2  # a change of acceleration beside the noise
    count = joints.shape[1]
    if compared_s < LEARNING_S or not (0.0 < dt_s <= MAX_HOLD_S and step_s > 0.0):
        return 0.0
    change = rate_deviation(signals, known, count, dt_s) - joints[DEVIATION]
    own_change = signals[count : 2 * count] - known[LAST, count : 2 * count]
    smallest = np.minimum(change * change, own_change * own_change)
    return (smallest / (joints[USUAL] + (jerk_rad_s2 * dt_s) ** 2)).sum()


@compiled_inside
def is_stuck(repeated_s: float, limit_s: float, step_s: float) -> bool:
    """Return whether signals that have repeated for a time are to be rejected.

    The limit is that of `judge_step`, the step the time between two samples.
    """
    min_repeats = 8  # whatever the clock
    is_long = repeated_s >= max(limit_s, min_repeats * step_s)
    return is_long and repeated_s < limit_s + MAX_REFUSAL_S


@compiled
def judge_step(
    has_jumped: WrittenVector,
    signals: Vector,
    known: Matrix,
    joints: Matrix,
    limits_Nm: Matrix,
    stuck_s: Vector,
    dt_s: float,
    step_s: float,
    compared_s: float,
    delay_s: float,
    is_learnt: bool,
) -> int:
    """Return what is wrong with a sample, a sum of the bits from `INVALID` on.

    Args:
        has_jumped: As of `find_jumps`, like the next three.
        signals: The sample.
        known: See there.
        joints: See there.
        limits_Nm: Effort limits, infinite where they are not known, and below them what
            stands in, shape (2, n).
        stuck_s: Times of repeats from which motion and torques are stuck, shape (2,);
            infinite where a repeat means nothing.
        dt_s: Time since the last accepted sample.
        step_s: As of `find_jumps`.
        compared_s: Time for which velocities have been compared with positions.
        delay_s: As of `find_jumps`.
        is_learnt: Whether the noise is known.
    """
    max_squares = 64.0  # noise of seven joints reaches 60 once in 1e9 samples
    first_torque = len(signals) - joints.shape[1]
    found = 0
    squares = 0.0
    repeated_s = np.full(2, math.inf)
    for k in range(len(signals)):
        squares += signals[k] * signals[k]
        own_s = known[STILL, k] + dt_s if signals[k] == known[LAST, k] else 0.0
        group = int(k >= first_torque)
        repeated_s[group] = min(repeated_s[group], own_s)
    if not squares < MAX_PLAUSIBLE**2:  # written so that a NaN fails, too
        return INVALID
    for j in range(joints.shape[1]):
        if abs(signals[first_torque + j]) >= SATURATED_RATIO * limits_Nm[0, j]:
            found |= SATURATED
    for group in range(2):
        if is_stuck(repeated_s[group], stuck_s[group], step_s):
            found |= FROZEN_TORQUE if group else FROZEN_MOTION
    error = rate_error(signals, known, joints, dt_s, step_s, compared_s)
    found |= NO_RATE * int(error > max_squares)
    if is_learnt:
        last = known[LAST]
        effort_Nm = limits_Nm[1]
        found |= JUMPED * int(
            find_jumps(
                has_jumped,
                signals,
                last,
                known,
                joints,
                effort_Nm,
                dt_s,
                step_s,
                delay_s,
            )
        )
    return found


@compiled_inside
def compare_rate(
    signals: Vector,
    known: Matrix,
    joints: WrittenMatrix,
    dt_s: float,
    step_s: float,
    compared_s: float,
) -> None:
    """Remember how velocities deviate from the rate of positions.

    Arguments are those of `judge_step`.
    """
    usual_deviation_s = 2.0
    largest_ratio = 9.0  # of what is learned, so that one error teaches nothing
    count = joints.shape[1]
    if not (step_s > 0.0 and 0.0 < dt_s <= MAX_HOLD_S):
        joints[DEVIATION, :] = 0.0
        return
    weight = min(dt_s / min(compared_s + dt_s, usual_deviation_s), 1.0)
    deviation = rate_deviation(signals, known, count, dt_s)
    squares = (deviation - joints[DEVIATION]) ** 2
    if compared_s >= LEARNING_S:
        squares = np.minimum(squares, largest_ratio * joints[USUAL])
    joints[USUAL] += weight * (squares - joints[USUAL])
    joints[DEVIATION] = deviation


@compiled
def accept_step(
    signals: Vector,
    velocity: Vector,
    known: WrittenMatrix,
    joints: WrittenMatrix,
    dt_s: float,
    step_s: float,
    compared_s: float,
) -> float:
    """Remember an accepted sample; arguments are those of `judge_step`.

    Args:
        signals: See there.
        velocity: Its joint velocity, measured or estimated [rad/s], shape (n,).
        known: See there; written, like the next one.
        joints: See there.
        dt_s: See there.
        step_s: See there.
        compared_s: See there.

    Returns:
        The longest time for which a torque has repeated, or all positions have.
    """
    # Change of an estimated velocity that positions do not show while they repeat. Far
    # less than what a single step may be off by: an arm at rest repeats its positions
    # for ever.
    held_acceleration_rad_s2 = 4.0
    count = joints.shape[1]
    first_torque = len(signals) - count
    has_velocity = first_torque > count
    if has_velocity:
        compare_rate(signals, known, joints, dt_s, step_s, compared_s)
    for k in range(len(signals)):
        is_repeated = signals[k] == known[LAST, k]
        known[STILL, k] = known[STILL, k] + dt_s if is_repeated else 0.0
        known[BEFORE, k] = known[LAST, k]
        known[LAST, k] = signals[k]
    held_s = known[STILL, :count].min()
    # A source of positions that is slower than the clock makes up for it in one step.
    # It fades, so that noise of the velocity does not add up while an arm rests.
    fading = max(1.0 - dt_s / MAX_USUAL_S, 0.0)
    unseen_rad_s = held_acceleration_rad_s2 * min(held_s, MAX_USUAL_S)
    for j in range(count):
        joints[VELOCITY, j] = velocity[j]
        speed = abs(velocity[j]) + (0.0 if has_velocity else unseen_rad_s)
        swept = joints[SWEPT, j] * fading + speed * dt_s
        joints[SWEPT, j] = swept if held_s > 0.0 else 0.0
    return max(known[STILL, first_torque:].max(), held_s)


@dataclass(slots=True, kw_only=True, eq=False)
class GuardState:
    """State of a `FaultDetector`.

    Attributes:
        known: See `LAST` and the others, shape (5, 2 n) or (5, 3 n).
        joints: See `VELOCITY` and the others, shape (4, n).
        stuck_s: As of `judge_step`; infinite until the noise is learnt.
        alone_s: Times of repeats from which a single torque is reported, shape (n,).
        probe: Samples of which the noise is learnt; None once it is.
        step_s: Time between the last two accepted samples; 0 before two.
        missed_s: Time for which samples have been held back for a jump.
        stayed_s: Time for which these agree with each other.
        compared_s: Time for which velocities have been compared with positions.
    """

    known: Array
    joints: Array
    stuck_s: Array
    alone_s: Array
    probe: NoiseProbe | None
    step_s: float = 0.0
    missed_s: float = 0.0
    stayed_s: float = 0.0
    compared_s: float = 0.0


class FaultDetector:
    """Judges the samples of one stream before anything uses them.

    Args:
        robot: Gives the effort limits.
        tool: What forces act on.
        velocity_delay_s: Age of the velocity that `accept` gets.
        names: Of the signals of a sample: position, velocity if there is one, torque.

    Attributes:
        memory: Its state; one of the same robot and signals may replace it.
    """

    def __init__(
        self,
        robot: Robot,
        tool: ToolKinematics,
        velocity_delay_s: float,
        names: tuple[str, ...],
    ) -> None:
        self._names = names
        self._delay_s = velocity_delay_s
        self._limits_Nm = np.stack(
            [
                known_limits(robot.effort_limit_Nm, instead)
                for instead in (np.inf, UNKNOWN_EFFORT_NM)
            ]
        )
        self._tool = tool
        size = len(names) * robot.nv
        self._has_jumped = np.zeros(size)
        self.memory = GuardState(
            known=np.zeros((SIGNAL_ROWS, size)),
            joints=np.zeros((JOINT_ROWS, robot.nv)),
            stuck_s=np.full(2, np.inf),
            alone_s=np.full(robot.nv, np.inf),
            probe=NoiseProbe.of_size(size),
        )

    def check(self, rows: Array, dt_s: float) -> bool:
        """Judge a sample, of any numbers; it is compared with the last accepted one.

        Args:
            rows: Position [rad], velocity if there is one [rad/s] and torque [Nm],
                shape (2 or 3, n).
            dt_s: Time since the last accepted sample.

        Returns:
            Whether its position has jumped and is accepted only because it stayed where
            it is.

        Raises:
            SampleError: For numbers that are not finite, or, with a warning, for a
                spike, frozen signals or a saturated torque.
        """
        memory = self.memory
        signals = rows.ravel()
        found = judge_step(
            self._has_jumped,
            signals,
            memory.known,
            memory.joints,
            self._limits_Nm,
            memory.stuck_s,
            dt_s,
            memory.step_s,
            memory.compared_s,
            self._delay_s,
            memory.probe is None,
        )
        if not found:  # as nearly always
            return False
        if found == INVALID:
            check_rows(self._names, rows)
        self._refuse(found, rows[-1])
        return bool(found & JUMPED) and self._hold_jump(rows, dt_s)

    def _refuse(self, found: int, torque_Nm: Array) -> None:
        """Raise the error of bits of `judge_step` that no time makes good."""
        if found & SATURATED:
            ratios = np.abs(torque_Nm) / self._limits_Nm[0]
            clipped = np.flatnonzero(ratios >= SATURATED_RATIO)
            raise SampleError(
                f"tau is at the effort limit at {named_joints(clipped)}: the true one "
                "may be more",
                "Unload the arm, or correct the effort limits in the robot's "
                "description, or the unit of tau.",
                SensorWarning.SATURATED,
            )
        if found & (FROZEN_MOTION | FROZEN_TORQUE):
            motion = "position" if found & FROZEN_MOTION else ""
            torque = "torque" if found & FROZEN_TORQUE else ""
            raise SampleError(
                f"{' and '.join(filter(None, (motion, torque)))} of all joints repeat "
                "bit for bit although they are noisy",
                "Check the sensors and the connection to the robot.",
                SensorWarning.FROZEN,
            )
        if found & NO_RATE:
            raise SampleError(
                "dq is not the rate of q for a moment",
                "Skip the sample; if it recurs, check the robot's velocities.",
                SensorWarning.SPIKE,
            )

    def _hold_jump(self, rows: Array, dt_s: float) -> bool:
        """Reject a sample that has jumped; arguments, result and error of `check`."""
        stayed_s = 5e-3  # what has stayed for so long is accepted: it is elsewhere now
        memory = self.memory
        signals = rows.ravel()
        has_jumped = self._has_jumped.reshape(rows.shape) > 0.0
        has_moved = bool(has_jumped[0].any())
        if self._is_contact(has_jumped, rows, memory.known[LAST]):
            return False
        if dt_s > MAX_HOLD_S:
            return has_moved and memory.missed_s > 0.0
        since_s = dt_s - memory.missed_s
        agrees = False
        if memory.missed_s > 0.0:
            held = memory.known[HELD]
            again = np.zeros_like(signals)
            is_elsewhere = find_jumps(
                again,
                signals,
                held,
                memory.known,
                memory.joints,
                self._limits_Nm[1],
                since_s,
                memory.step_s,
                self._delay_s,
            )
            jumped_again = again.reshape(rows.shape) > 0.0
            agrees = not is_elsewhere or self._is_contact(jumped_again, rows, held)
        memory.stayed_s = memory.stayed_s + since_s if agrees else 0.0
        memory.missed_s = dt_s
        memory.known[HELD] = signals
        if memory.stayed_s >= stayed_s - ROUNDING_S:
            return has_moved
        joints = named_joints(np.flatnonzero(has_jumped.any(axis=0)))
        raise SampleError(
            f"a signal jumped further than an arm can at {joints}; held back unless it "
            f"stays for {stayed_s:g} s",
            "Skip the sample; if it recurs, check the cables and the sensor.",
            SensorWarning.SPIKE,
        )

    def _is_contact(
        self, has_jumped: NDArray[np.bool_], rows: Array, reference: Array
    ) -> bool:
        """Return whether only torques have jumped, and as by a force on the tool."""
        # A rupture is newtons, a contact tens.
        max_force_N = 100.0
        # A spike of one joint leaves most of itself.
        max_unexplained_ratio = 0.35
        if has_jumped[:-1].any():
            return False
        joints = rows.shape[1]
        scale_Nm = self.memory.known[GATE, -joints:]  # jumps without a reason
        self._tool.update(rows[0])
        levers = self._tool.jacobian[:3].T / scale_Nm[:, None]
        jump = (rows[-1] - reference[-joints:]) / scale_Nm
        force_N = np.linalg.lstsq(levers, jump, rcond=None)[0]
        remaining = np.linalg.norm(jump - levers.dot(force_N))
        is_explained = remaining <= max_unexplained_ratio * np.linalg.norm(jump)
        return bool(is_explained and np.linalg.norm(force_N) <= max_force_N)

    def accept(self, rows: Array, velocity: Array, dt_s: float) -> bool:
        """Remember the sample that was last checked, which has been used.

        Args:
            rows: The sample, as of `check`.
            velocity: Its joint velocity, measured or estimated [rad/s], shape (n,).
            dt_s: Time since the one before; 0 for the first sample.

        Returns:
            Whether signals have not changed for a while: see `stale_signals`.
        """
        memory = self.memory
        signals = rows.ravel()
        still_s = accept_step(
            signals,
            velocity,
            memory.known,
            memory.joints,
            dt_s,
            memory.step_s,
            memory.compared_s,
        )
        if len(self._names) > 2 and memory.step_s > 0.0 and dt_s <= MAX_HOLD_S:
            memory.compared_s += dt_s
        memory.step_s = dt_s
        memory.missed_s = 0.0
        memory.stayed_s = 0.0
        if memory.probe is not None:
            samples = memory.probe.add(signals, dt_s)
            if samples is not None:
                self._learn(samples, LEARNING_S - memory.probe.left_s)
        return still_s >= MIN_ALONE_S

    def _learn(self, samples: Array, seconds: float) -> None:
        """Learn noise and resolution of the first samples, shape (m, size).

        They took so many seconds.
        """
        sigmas = 12.0  # a jump within so many deviations of the noise is noise
        min_position_step_rad = 1e-4
        # A torque may step by this fraction of the effort limit for no reason. On the
        # LWR that is 3.5 Nm at the shoulder, 5 N at 0.65 m, and 0.8 Nm at the wrist;
        # what a force on the tool explains may step by more, see `_is_contact`.
        torque_ratio = 0.02
        # The gears of a moving wrist of 12 Nm make as much in a millisecond.
        min_torque_step_Nm = 0.7
        min_stuck_s = 0.02
        # A source counts as stuck when it repeats so many times longer than it ever did
        # while its noise was learnt.
        stuck_ratio = 20.0
        memory = self.memory
        joints = memory.joints.shape[1]
        # Each signal by its own clock: what mostly repeats would seem to have no noise.
        parts = np.split(samples, len(self._names), axis=1)
        noise = np.concatenate([white_noise(part[find_new(part)]) for part in parts])
        # The difference of two samples has sqrt(2) times the noise of one.
        gates = sigmas * math.sqrt(2.0) * noise
        gates[:joints] += min_position_step_rad
        gates[-joints:] += np.maximum(
            torque_ratio * self._limits_Nm[1], min_torque_step_Nm
        )
        memory.known[GATE] = gates
        memory.probe = None
        period_s = seconds / len(samples)
        usual_s = [
            min(longest_repeat(part) * period_s, MAX_USUAL_S)
            for part in (samples[:, :-joints], samples[:, -joints:])
        ]
        has_noise = is_noise_resolved(samples[:, -joints:])
        # Encoders may be too coarse for noise where velocities are not.
        motion_has_noise = is_noise_resolved(samples[:, :-joints]).reshape(-1, joints)
        is_informative = [motion_has_noise.any(axis=0).all(), has_noise.all()]
        limit_s = np.maximum(min_stuck_s, stuck_ratio * np.array(usual_s))
        memory.stuck_s = np.where(is_informative, limit_s, np.inf)
        alone_s = max(MIN_ALONE_S, stuck_ratio * usual_s[1])
        memory.alone_s = np.where(has_noise, alone_s, np.inf)

    def stale_signals(self) -> tuple[str, str]:
        """Return which accepted signals seem frozen, and which torques may be missing.

        In words; empty if none. Those that may be missing do not change.
        """
        memory = self.memory
        joints = memory.joints.shape[1]
        still_s = memory.known[STILL]
        frozen = ""
        stuck = np.flatnonzero(still_s[-joints:] >= memory.alone_s)
        if stuck.size:
            frozen = f"tau at {named_joints(stuck)} repeats: check its sensor"
        elif still_s[:-joints].min() > memory.stuck_s[0]:
            frozen = "q and dq of all joints still repeat: does the arm rest?"
        question = ""
        still = np.flatnonzero(still_s[-joints:] >= 1.0)
        if still.size:
            question = (
                f"tau at {named_joints(still)} has not changed for a second: is it "
                "stale?"
            )
        return frozen, question


def longest_repeat(rows: Array) -> int:
    """Return how many rows in a row repeat the one before, at most, of (m, size)."""
    ends = np.append(np.flatnonzero(find_new(rows)), len(rows))
    return int(np.diff(ends).max()) - 1
