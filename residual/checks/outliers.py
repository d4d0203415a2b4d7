"""Rejects valid numbers that are no measurements: spikes, frozen or saturated signals.

A measured velocity that the positions contradict for a moment is replaced by their
rate: positions and torques of that sample are right.

A jump is judged against what an arm can do in the time and against the noise of the
signal itself, learnt in the first half second; before that nothing counts as a spike or
as frozen. A rejected sample is treated like a lost one: time passes, the estimate
stays.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector, WrittenMatrix
from foundation.jit import compiled
from residual.checks.input import MAX_PLAUSIBLE, ROUNDING_S, known_limits
from residual.checks.stuck_signals import (
    LEARNING_S,
    MAX_USUAL_S,
    NoiseProbe,
    SingleSignalDetector,
    StuckSignalDetector,
    drop_repeats,
    is_noise_resolved,
    white_noise,
)
from residual.errors import SampleError, named_joints
from residual.estimate import SensorWarning
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

SIGMAS = 12.0
"""A jump within this many standard deviations of the signal's noise is noise."""

TORQUE_RATIO = 0.02
"""Fraction of the effort limit by which a torque may step for no reason. On the LWR
that is 3.5 Nm at the shoulder, 5 N at 0.65 m, and 0.8 Nm at the wrist; what a force on
the tool explains may step by more, see `is_contact`."""

MIN_TORQUE_STEP_NM = 0.7
"""Smallest torque step that is held back: the gears of a moving wrist of 12 Nm make as
much in a millisecond."""

TORQUE_RATIO_PER_S = 2.0
"""Fraction of the effort limit per second, beyond the step: for lost samples."""

MAX_ACCELERATION_RAD_S2 = 20.0
"""Largest acceleration of a joint: an arm that inserts a needle stays far below."""

MIN_POSITION_STEP_RAD = 1e-4
"""Smallest step of a position that is held back."""

COARSE_STEP_RAD = 5e-4
"""A position that has repeated may make as large a step: three of an encoder on the
link, which resolves 0.01 degrees."""

UNKNOWN_EFFORT_NM = 300.0
"""Stands in where a description gives no effort limit: the shoulder of an arm for ten
kilograms. Torques from motor currents step by 20 Nm there where the friction of its
gears turns round."""

CLOCK_ERROR_S = 5e-3
"""Time by which the stamps of a computer may be off from those of the robot. At the
speeds of a needle it is nothing: 0.1 rad/s make half a milliradian of it."""

HELD_ACCELERATION_RAD_S2 = 4.0
"""Change of an estimated velocity that positions do not show while they repeat. Far
less than what a single step may be off by: an arm at rest repeats its positions for
ever."""

MAX_FORCE_STEP_N = 100.0
"""Largest force that may come or go within a sample: a rupture is newtons, a contact
tens."""

MAX_UNEXPLAINED_RATIO = 0.35
"""Fraction of a jump that a force may leave over; a spike of one joint leaves most of
itself."""

CHECK_S = 0.02
"""Interval at which each torque is checked by itself."""

STAYED_S = 5e-3
"""A jump that has stayed for this long is accepted: the signal is elsewhere now."""

MAX_HOLD_S = 0.1
"""Longest time for which a signal that jumps is held back, whatever it does."""

SATURATED_RATIO = 0.99
"""Fraction of the effort limit from which a torque counts as clipped."""

LOADED_RATIO = 0.9
"""Fraction of the effort limit from which every torque is watched."""

MAX_LOAD_RATIO = 10.0
"""Largest ratio of a torque to its limit: only other units read beyond."""

STILL_S = 1.0
"""A torque unchanged for so long may be missing, or come from a simulation."""

USUAL_DEVIATION_S = 2.0
"""Time constant of the usual deviation of velocities from the rate of positions."""

SURE_STEP_S = 1e-4
"""Time step for which a velocity may change without a check: shorter than any clock's,
so that a sample within it needs no other check."""


class Repeats(NamedTuple):
    """Which signals of a sample repeat bit for bit in all joints.

    Attributes:
        position: All positions.
        motion: All positions and, if there are any, velocities.
        torque: All torques.
    """

    position: bool
    motion: bool
    torque: bool


NO_REPEATS = Repeats(position=False, motion=False, torque=False)
"""Nothing repeats."""


@compiled
def fresh_distance(
    signals: Vector, signals_before: Vector, weights: Vector, joints: int
) -> float:
    """Return the largest weighted difference of the signals of two samples.

    It is infinite for a NaN, and if all positions or all torques repeat. Samples have
    positions first and torques last, shape (2 n,) or (3 n,), n joints; no weight is 0.
    """
    size = len(signals)
    position_repeats = True
    torque_repeats = True
    largest = 0.0
    for k in range(size):
        difference = (signals[k] - signals_before[k]) * weights[k]
        if math.isnan(difference):
            return math.inf
        largest = max(largest, abs(difference))
        if difference != 0.0:
            position_repeats = position_repeats and k >= joints
            torque_repeats = torque_repeats and k < size - joints
    if position_repeats or torque_repeats:
        return math.inf
    return largest


@compiled
def velocity_error(
    sample: Matrix,
    before: Vector,
    deviation_before: Vector,
    usual_square: Vector,
    dt_s: float,
    learned_s: float,
    found: WrittenMatrix,
) -> float:
    """Return how far velocities are from the rate of positions, beside their usual.

    Velocities may be late: what counts is how far their deviation from the rate has
    changed since the sample before, and at most how far they have changed themselves:
    a position may have jumped.

    Args:
        sample: q [rad], dq [rad/s] and torque, shape (3, n).
        before: The sample before, in one row, shape (3 n,).
        deviation_before: Deviation of its velocity from the rate [rad/s], shape (n,).
        usual_square: Usual square of a change of this deviation, shape (n,).
        dt_s: Time between the two samples, > 0.
        learned_s: Time over which that was learned.
        found: Output, shape (3, n): the velocity that replaces dq, the deviation of dq
            from the rate, and the usual square with that of this sample.

    Returns:
        The sum over the joints of the squared changes, in units of the usual ones.
    """
    jerk_rad_s2 = 0.2  # a change of acceleration beside the noise
    acceleration_rad_s2 = 0.5  # of an arm that drives a needle
    largest_ratio = 9.0  # of what is learned, so that one error teaches nothing
    is_learning = learned_s < LEARNING_S
    weight = min(dt_s / min(learned_s + dt_s, USUAL_DEVIATION_S), 1.0)
    total = 0.0
    joints = sample.shape[1]
    for j in range(joints):
        rate = (sample[0, j] - before[j]) / dt_s
        deviation = sample[1, j] - rate
        change = deviation - deviation_before[j]
        own_change = sample[1, j] - before[joints + j]
        square = change * change
        smallest = min(square, own_change * own_change)
        total += smallest / (usual_square[j] + (jerk_rad_s2 * dt_s) ** 2)
        if not is_learning:
            square = min(square, largest_ratio * usual_square[j])
        # The velocity before and the rate now, by what either may be off.
        square_held = (acceleration_rad_s2 * dt_s) ** 2
        share = square_held / (square_held + 0.5 * usual_square[j])
        found[0, j] = before[joints + j] + share * (rate - before[joints + j])
        found[1, j] = deviation
        found[2, j] = usual_square[j] + weight * (square - usual_square[j])
    return 0.0 if is_learning else total


def is_contact(jacobian: Array, jump: Array, scale: Array) -> bool:
    """Return whether a plausible force on the tool explains a jump of the torques.

    Args:
        jacobian: Of the tool's linear velocity, shape (3, n).
        jump: Of the torques [Nm], shape (n,).
        scale: Jump that each joint may make without a reason [Nm], shape (n,).
    """
    rows = jacobian.T / scale[:, None]
    scaled_jump = jump / scale
    force = np.linalg.lstsq(rows, scaled_jump, rcond=None)[0]
    remaining = scaled_jump - rows.dot(force)
    is_explained = remaining.dot(remaining) <= (
        MAX_UNEXPLAINED_RATIO**2 * scaled_jump.dot(scaled_jump)
    )
    return bool(is_explained and force.dot(force) <= MAX_FORCE_STEP_N**2)


@dataclass(slots=True, kw_only=True, eq=False)
class GuardState:
    """State of a `FaultDetector`.

    Attributes:
        last: Last accepted sample: position, velocity if there is one, torque; shape (2
            n,) or (3 n,); zeros before the first.
        before: The accepted sample before it.
        velocity: Velocity that belongs to the last one [rad/s], shape (n,).
        alone: Of the check for single torques that repeat.
        noise: Learnt noise of the same signals; None until learnt.
        probe: Samples of which the noise is learnt; None once it is.
        rejected: Last sample held back as a spike, or None.
        step_s: Time between the last two accepted samples; 0 before two.
        missed_s: Time since the last accepted sample.
        stayed_s: Time for which samples held back agree with each other.
        motion: Of the check for positions and velocities that repeat.
        torque: Of the check for torques that repeat.
        age_s: Time since each torque was checked; it begins half an interval late, so
            that the checks do not fall into the ticks in which the bias is renewed.
        is_loaded: Whether a torque was near its limit at that check.
        warning: Which signals seemed frozen at that check.
        question: Which signals may be missing: they have not changed for long.
        held_s: Time for which positions have repeated now.
        swept: Travel that they may lag by meanwhile [rad], shape (n,); None if they do
            not repeat.
        deviation: Of the last velocity from the rate of positions [rad/s], shape (n,).
        usual_square: Usual square of a change of it, shape (n,).
        compared_s: Time over which that was learned.
        replaced_s: Time for which velocities are replaced now.
        replaced: Number of samples whose velocity was replaced.
    """

    last: Array
    before: Array
    velocity: Array
    alone: SingleSignalDetector
    noise: Array | None = None
    probe: NoiseProbe | None = None
    rejected: Array | None = None
    step_s: float = 0.0
    missed_s: float = 0.0
    stayed_s: float = 0.0
    motion: StuckSignalDetector = field(default_factory=StuckSignalDetector)
    torque: StuckSignalDetector = field(default_factory=StuckSignalDetector)
    age_s: float = 0.5 * CHECK_S
    is_loaded: bool = False
    warning: str = ""
    question: str = ""
    held_s: float = 0.0
    swept: Array | None = None
    deviation: Array
    usual_square: Array
    compared_s: float = 0.0
    replaced_s: float = 0.0
    replaced: int = 0

    def find_damage(self) -> str:
        """Return which array has not the shape of a sample, "" if all have it."""
        for name in ("noise", "rejected"):
            signals = getattr(self, name)
            if signals is not None and signals.shape != self.last.shape:
                return f"{name} has shape {signals.shape}, expected {self.last.shape}"
        if self.swept is not None and self.swept.shape != self.velocity.shape:
            return f"swept has shape {self.swept.shape}"
        return ""


class FaultDetector:
    """Judges the samples of one stream before anything uses them.

    A sample is one array of finite positions [rad], velocities [rad/s] if there are
    any, and torques [Nm], one after the other, shape (2 n,) or (3 n,).

    Args:
        robot: Gives the effort limits.
        tool: What forces act on.
        velocity_delay_s: Age of the velocity that `accept` gets.
        has_velocity: Whether samples carry a velocity.

    Attributes:
        memory: Its state.
    """

    def __init__(
        self,
        robot: Robot,
        tool: ToolKinematics,
        velocity_delay_s: float,
        *,
        has_velocity: bool,
    ) -> None:
        self._joints = robot.nv
        self._has_velocity = has_velocity
        self._delay_s = velocity_delay_s
        # Infinite, or those of a large arm, where the description gives none.
        self._limit_Nm = known_limits(robot.effort_limit_Nm, np.inf)
        self._effort_Nm = known_limits(robot.effort_limit_Nm, UNKNOWN_EFFORT_NM)
        self._tool = tool
        size = (3 if has_velocity else 2) * robot.nv
        self.restore(
            GuardState(
                last=np.zeros(size),
                before=np.zeros(size),
                velocity=np.zeros(robot.nv),
                deviation=np.zeros(robot.nv),
                usual_square=np.zeros(robot.nv),
                alone=SingleSignalDetector.of_size(robot.nv),
                probe=NoiseProbe.of_size(size),
            )
        )

    def _set_gates(self, noise: Array) -> None:
        """Set the largest plausible jumps within no time, for signals with a noise.

        The noise has the shape of a sample.
        """
        n = self._joints
        # The difference of two samples has sqrt(2) times the noise of one.
        self._gates = SIGMAS * np.sqrt(2.0) * noise
        self._gates[:n] += MIN_POSITION_STEP_RAD
        self._gates[-n:] += np.maximum(
            TORQUE_RATIO * self._effort_Nm, MIN_TORQUE_STEP_NM
        )
        sure_gates = self._gates.copy()
        if self._has_velocity:
            sure_gates[n:-n] += MAX_ACCELERATION_RAD_S2 * SURE_STEP_S
        # A weighted difference that is smaller than the narrowest gate is within all.
        self._narrowest_gate = float(sure_gates.min())
        self._weights = self._narrowest_gate / sure_gates

    def correct_velocity(self, sample: Array, dt_s: float) -> None:
        """Replace velocities of a sample that cannot be the rate of q by an estimate.

        Args:
            sample: q, dq and torque, shape (3, n), written in place.
            dt_s: Time since the last accepted sample.
        """
        memory = self.memory
        self._is_replaced = False
        self._is_compared = memory.step_s > 0.0 and 0.0 < dt_s <= MAX_HOLD_S
        if not self._is_compared:
            return
        total = velocity_error(
            sample,
            memory.last,
            memory.deviation,
            memory.usual_square,
            dt_s,
            memory.compared_s,
            self._found,
        )
        # Noise of seven joints reaches 60 once in 1e9 samples.
        max_squares = 64.0
        is_wrong = total > max_squares and memory.replaced_s + dt_s <= MAX_HOLD_S
        if is_wrong and math.hypot(*sample[1].tolist()) < MAX_PLAUSIBLE:
            sample[1] = self._found[0]
            self._is_replaced = True

    def surely_passes(self, signals: Array) -> bool:
        """Return whether a sample, of any numbers, needs no check, as nearly all."""
        self._repeats = NO_REPEATS
        memory = self.memory
        distance = fresh_distance(signals, memory.last, self._weights, self._joints)
        return distance < self._narrowest_gate and not memory.is_loaded

    def check(self, signals: Array, dt_s: float) -> bool:
        """Judge a sample; it is compared with the last one that `accept` was given.

        Returns:
            Whether its position has jumped and is accepted only because it stayed where
            it is.

        Raises:
            SampleError: For a spike, frozen signals or a saturated torque.
        """
        if self.memory.is_loaded:
            self._check_saturated(signals)
        repeats = self._find_repeats(signals)
        self._repeats = repeats
        if repeats is not NO_REPEATS:
            self._check_frozen(repeats, dt_s)
        return self.memory.noise is not None and self._check_jump(signals, dt_s)

    def _find_repeats(self, signals: Array) -> Repeats:
        n = self._joints
        difference = signals - self.memory.last
        if difference.item(0) != 0.0 and difference.item(-1) != 0.0:
            return NO_REPEATS
        position_repeats = not difference[:n].any()
        return Repeats(
            position=position_repeats,
            motion=position_repeats and not difference[n:-n].any(),
            torque=not difference[-n:].any(),
        )

    def _check_frozen(self, repeats: Repeats, dt_s: float) -> None:
        memory = self.memory
        frozen = []
        if repeats.motion and memory.motion.is_stuck(dt_s):
            frozen.append("position")
        if repeats.torque and memory.torque.is_stuck(dt_s):
            frozen.append("torque")
        if frozen:
            raise SampleError(
                f"{' and '.join(frozen)} of all joints repeat bit for bit although "
                "they are noisy",
                "Check the sensors and the connection to the robot.",
                SensorWarning.FROZEN,
            )

    def accept(self, signals: Array, velocity: Array, dt_s: float) -> None:
        """Remember the sample that was last checked, which has been used.

        Args:
            signals: The sample; it is kept, not copied, like the velocity.
            velocity: Its joint velocity, measured or estimated [rad/s], shape (n,).
            dt_s: Time since the one before; 0 for the first sample.
        """
        memory = self.memory
        memory.before = memory.last
        memory.step_s = dt_s
        memory.last = signals
        memory.velocity = velocity
        if self._has_velocity:
            self._compare_velocity(dt_s)
        self._follow_repeats(velocity, dt_s)
        if memory.missed_s:
            memory.rejected = None
            memory.missed_s = 0.0
            memory.stayed_s = 0.0
        if memory.probe is not None:
            samples = memory.probe.add(signals, dt_s)
            if samples is not None:
                self._learn(samples)
        memory.age_s += dt_s
        if memory.age_s >= CHECK_S - ROUNDING_S:
            self._check_each_torque()

    def _compare_velocity(self, dt_s: float) -> None:
        """Remember how the velocity of an accepted sample deviates from the rate."""
        memory = self.memory
        if not self._is_compared:
            memory.deviation[:] = 0.0
            return
        memory.usual_square[:] = self._found[2]
        memory.compared_s += dt_s
        if self._is_replaced:
            memory.replaced += 1
            memory.replaced_s += dt_s
        else:
            memory.deviation[:] = self._found[1]
            memory.replaced_s = 0.0

    def _follow_repeats(self, velocity: Array, dt_s: float) -> None:
        """Count for how long signals have repeated; arguments of `accept`."""
        memory = self.memory
        repeats = self._repeats
        if repeats.position:
            memory.held_s += dt_s
            memory.swept = self._swept_travel(velocity, dt_s)
        elif memory.held_s:
            memory.held_s = 0.0
            memory.swept = None
        is_learning = memory.probe is not None
        if repeats.motion or memory.motion.repeats:
            memory.motion.accept(repeats.motion, dt_s, learning=is_learning)
        if repeats.torque or memory.torque.repeats:
            memory.torque.accept(repeats.torque, dt_s, learning=is_learning)

    def _swept_travel(self, velocity: Array, dt_s: float) -> Array:
        """Return the travel that repeating positions may lag by now [rad], shape (n,).

        A source of positions that is slower than the clock makes up for it in one step.
        """
        memory = self.memory
        speed = np.abs(velocity)
        if not self._has_velocity:
            speed = speed + HELD_ACCELERATION_RAD_S2 * min(memory.held_s, MAX_USUAL_S)
        if memory.swept is None:
            return speed * dt_s
        # It fades, so that noise of the velocity does not add up while an arm rests.
        fading = max(1.0 - dt_s / MAX_USUAL_S, 0.0)
        return memory.swept * fading + speed * dt_s

    def _learn(self, rows: Array) -> None:
        """Learn noise and resolution of the first half second, shape (m, size)."""
        n = self._joints
        memory = self.memory
        # Each signal by its own clock: what mostly repeats would seem to have no noise.
        signals = np.split(rows, rows.shape[1] // n, axis=1)
        memory.noise = np.concatenate(
            [white_noise(drop_repeats(signal)) for signal in signals]
        )
        memory.probe = None
        self._set_gates(memory.noise)
        is_informative = is_noise_resolved(rows[:, -n:])
        memory.torque.is_informative = bool(is_informative.all())
        memory.alone.learn(is_informative, memory.torque.usual_s)
        # Encoders may be too coarse for noise where velocities are not.
        is_motion_informative = is_noise_resolved(rows[:, :-n]).reshape(-1, n)
        memory.motion.is_informative = bool(is_motion_informative.any(axis=0).all())

    def _check_each_torque(self) -> None:
        """Check whether a torque repeats by itself, or is near its limit."""
        memory = self.memory
        torque = memory.last[-self._joints :]
        stuck_joints = memory.alone.check(torque, memory.age_s)
        memory.is_loaded = bool((np.abs(torque) >= LOADED_RATIO * self._limit_Nm).any())
        memory.age_s = 0.0
        memory.warning = ""
        memory.question = ""
        if stuck_joints and not memory.torque.repeats:
            joints = named_joints(stuck_joints)
            memory.warning = f"tau at {joints} repeats bit for bit: check its sensor"
        elif memory.torque.seems_stuck or memory.motion.seems_stuck:
            memory.warning = (
                "all joints still repeat bit for bit; no longer held back, the arm may "
                "rest"
            )
        elif memory.alone.longest_s >= STILL_S:
            memory.question = self._stale_question()

    def _stale_question(self) -> str:
        """Return the question whether signals that have not changed are missing."""
        memory = self.memory
        still_joints = np.flatnonzero(memory.alone.still_s >= STILL_S)
        is_all = memory.held_s >= STILL_S and len(still_joints) == self._joints
        subject = (
            "neither q nor tau has"
            if is_all
            else f"tau at {named_joints(still_joints)} has not"
        )
        return f"{subject} changed for a second: is it stale?"

    def _check_saturated(self, signals: Array) -> None:
        load = np.abs(signals[-self._joints :]) / self._limit_Nm
        clipped = np.flatnonzero(load >= SATURATED_RATIO)
        if clipped.size:
            reason = (
                "it seems to be in mNm"
                if load.max() > MAX_LOAD_RATIO
                else "the true one may be more"
            )
            raise SampleError(
                f"tau is at the effort limit at {named_joints(clipped)}: {reason}",
                "Unload the arm, or correct the effort limits in the robot's "
                "description.",
                SensorWarning.SATURATED,
            )

    def _check_jump(self, signals: Array, dt_s: float) -> bool:
        """Reject a sample that has jumped; arguments, result and error of `check`."""
        self._check_saturated(signals)
        memory = self.memory
        has_jumped = self._find_jumps(signals, memory.last, dt_s)
        if not has_jumped.any():
            return False
        has_moved = bool(has_jumped[0].any())
        if dt_s > MAX_HOLD_S:
            return has_moved and memory.missed_s > 0.0
        since_s = dt_s - memory.missed_s
        agrees = (
            memory.rejected is not None
            and not self._find_jumps(signals, memory.rejected, since_s).any()
        )
        memory.stayed_s = memory.stayed_s + since_s if agrees else 0.0
        memory.missed_s = dt_s
        memory.rejected = signals
        if memory.stayed_s >= STAYED_S - ROUNDING_S:
            return has_moved
        joints = named_joints(np.flatnonzero(has_jumped.any(axis=0)))
        raise SampleError(
            f"a signal jumped further than an arm can at {joints}; held back unless it "
            f"stays for {STAYED_S:g} s",
            "Skip the sample; if it recurs, check the cables and the sensor.",
            SensorWarning.SPIKE,
        )

    def _find_jumps(
        self, signals: Array, reference: Array, dt_s: float
    ) -> NDArray[np.bool_]:
        """Return which signals have jumped further than an arm or a contact can.

        The reference is a sample a time ``dt_s`` before. Shape (2 or 3, n): positions,
        velocities if there are any, torques.
        """
        n = self._joints
        memory = self.memory
        change = signals - reference
        gates = self._gates_after(dt_s)
        deviation = change.copy()
        deviation[:n] -= memory.velocity * dt_s
        has_jumped = np.abs(deviation) > gates
        if has_jumped.any() and memory.step_s > 0.0:
            # A fast arm goes on as it did: no single sample that is far off does.
            course = (memory.last - memory.before) * (dt_s / memory.step_s)
            has_jumped &= np.abs(change - course) > gates
        has_jumped = has_jumped.reshape(-1, n)
        if has_jumped[-1].any() and not has_jumped[:-1].any():
            self._tool.update(signals[:n])
            if is_contact(self._tool.jacobian[:3], change[-n:], self._gates[-n:]):
                has_jumped[-1] = False
        return has_jumped

    def _gates_after(self, dt_s: float) -> Array:
        """Return the largest plausible jumps within a time, shape of a sample."""
        n = self._joints
        memory = self.memory
        gates = self._gates.copy()
        # A tick too: a sample that comes twice is no spike.
        gates[:n] += np.abs(memory.velocity) * (dt_s + CLOCK_ERROR_S)
        # Positions are predicted with a velocity that is late.
        gates[:n] += MAX_ACCELERATION_RAD_S2 * dt_s * (dt_s + self._delay_s)
        if memory.swept is not None:
            gates[:n] += memory.swept
        if memory.step_s > 0.0:
            # A joint at rest shows its encoder's step at times, and not in the learnt
            # noise.
            step = np.abs(memory.last[:n] - memory.before[:n])
            gates[:n] += np.where(
                step == 0.0, COARSE_STEP_RAD, np.minimum(step, COARSE_STEP_RAD)
            )
        if self._has_velocity:
            gates[n:-n] += MAX_ACCELERATION_RAD_S2 * dt_s
        gates[-n:] += TORQUE_RATIO_PER_S * dt_s * self._effort_Nm
        return gates

    def restore(self, memory: GuardState) -> None:
        """Go on from the `memory` of a detector of the same robot and signals.

        It is not copied.
        """
        self.memory = memory
        self._set_gates(
            np.zeros_like(memory.last) if memory.noise is None else memory.noise
        )
        self._repeats = NO_REPEATS
        self._found = np.zeros((3, self._joints))
        self._is_compared = False
        self._is_replaced = False
