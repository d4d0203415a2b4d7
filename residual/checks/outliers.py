"""Holds back samples that are valid numbers and yet no measurement: spikes, frozen,
saturated.

A jump is judged against what an arm can do in the time and against the noise of the
signal itself, learnt in the first half second; before that nothing counts as a spike or
as frozen. What is held back is treated like a lost sample: time passes, the estimate
stays.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Vector
from foundation.jit import compiled
from residual.checks import stuck_signals as stuck
from residual.checks.input import ROUNDING_S, known_limits
from residual.checks.stuck_signals import (
    NoiseProbe,
    SingleSignalDetector,
    StuckSignalDetector,
)
from residual.errors import Array, SampleError, named_joints
from residual.estimate import SensorWarning
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

SIGMAS = (
    12.0  # A jump within this many standard deviations of the signal's noise is noise
)
TORQUE_RATIO = 0.02
"""Fraction of the effort limit by which a torque may step for no reason. On the LWR
that is 3.5 Nm at the shoulder, 5 N at 0.65 m, and 0.8 Nm at the wrist; what a force on
the tool explains may step by more, see `is_contact`."""
LEAST_TORQUE_NM = (
    0.7  # the gears of a moving wrist of 12 Nm make as much in a millisecond
)
TORQUE_RATIO_PER_S = 2.0  # of the effort limit, beyond the step: for lost samples
ACCELERATION_RAD_S2 = 20.0  # an arm that inserts a needle stays far below
LEAST_POSITION_RAD = 1e-4
COARSE_RAD = 5e-4
"""A position that has repeated may make as large a step [rad]: three of an encoder on
the link, which resolves 0.01 degrees."""
UNKNOWN_EFFORT_NM = 300.0
"""Stands in where a description gives no effort limit: the shoulder of an arm for ten
kilograms. Torques from motor currents step by 20 Nm there where the friction of its
gears turns round."""
CLOCK_S = 5e-3
"""Time by which the stamps of a computer may be off from those of the robot [s]. At the
speeds of a needle it is nothing: 0.1 rad/s make half a milliradian of it."""
HELD_ACCELERATION_RAD_S2 = 4.0
"""Change of an estimated velocity that positions do not show while they repeat. Far
less than what a single step may be off by: an arm at rest repeats its positions for
ever."""
MOST_STEP_N = (
    100.0  # may come or go within a sample: a rupture is newtons, a contact tens
)
MOST_UNEXPLAINED = 0.35
"""Fraction of the jump that the force may leave over; a spike of one joint leaves most
of itself."""
CHECK_S = 0.02  # every so often each torque is checked by itself [s]
STAYED_S = 5e-3  # A jump that has stayed for this long is accepted: the signal is elsewhere now [s]
LONGEST_HOLD_S = (
    0.1  # whatever a signal that jumps does, it is not held back for longer
)
SATURATED_RATIO = (
    0.99  # fraction of the effort limit from which a torque counts as clipped
)
MOST_LOAD = 10.0  # times the effort limit: only other units read beyond
_NO_REPEATS = (False, False, False)
"""Whether all positions, positions with velocities, and all torques of a sample
repeat."""
STILL_S = (
    1.0  # a torque unchanged for so long may be missing, or come from a simulation
)
LOADED_RATIO = 0.9  # fraction of the effort limit from which every torque is watched


@compiled
def fresh_distance(now: Vector, last: Vector, weight: Vector, joints: int) -> float:
    """Root of the sum of squares of the weighted differences of two samples.

    Infinite if all positions or all torques repeat. Samples have positions first and
    torques last, shape (2 n,) or (3 n,), n joints; no weight is 0.
    """
    off = (now - last) * weight
    if (off[0] == 0.0 and not off[:joints].any()) or (
        off[-1] == 0.0 and not off[-joints:].any()
    ):
        return math.inf
    return math.sqrt(np.vdot(off, off))  # `dot` warns of an overflow


def is_contact(jacobian: Array, jump: Array, scale: Array) -> bool:
    """Whether a plausible force on the tool explains a jump of the torques [Nm], shape
    (n,).

    The Jacobian is that of the tool's linear velocity, shape (3, n), the scale the jump
    that each joint may make without a reason [Nm], shape (n,).
    """
    levers = jacobian.T / scale[:, None]
    wanted = jump / scale
    force = np.linalg.lstsq(levers, wanted, rcond=None)[0]
    left = wanted - levers.dot(force)
    is_explained = left.dot(left) <= MOST_UNEXPLAINED**2 * wanted.dot(wanted)
    return bool(is_explained and force.dot(force) <= MOST_STEP_N**2)


@dataclass(slots=True, kw_only=True, eq=False)
class GuardState:
    """All that a `FaultDetector` remembers.

    Attributes:
        last: Last accepted sample: position, velocity if there is one, torque; shape (2
            n,) or (3 n,); zeros before the first.
        before: The accepted sample before it.
        velocity: Velocity that it left off with [rad/s], shape (n,).
        alone: Of the check for single torques that repeat.
        noise: Learnt noise of the same signals; None until learnt.
        rejected: Last sample held back as a spike, or None.
        step_s: Time between the last two accepted samples [s]; 0 before two.
        missed_s: Time since the last accepted sample [s].
        stayed_s: Time for which samples held back agree with each other [s].
        motion: Of the check for positions and velocities that repeat.
        torque: Of the check for torques that repeat.
        age_s: Time since each torque was checked; not when bias is renewed [s].
        is_loaded: Whether a torque was near its limit at that check.
        warning: What seemed frozen at that check.
        question: What may be missing: it has not changed for long.
        held_s: Time for which positions have repeated now [s].
        swept: Travel that they may lag by meanwhile [rad], shape (n,); None if they do
            not repeat.
    """

    last: Array
    before: Array
    velocity: Array
    alone: SingleSignalDetector
    noise: Array | None = None
    probe: NoiseProbe | None = (
        None  # What is known of the noise so far; None once it is learnt
    )
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


class FaultDetector:
    """Judges the samples of one stream before anything uses them.

    A sample is one array of finite positions [rad], velocities [rad/s] if there are
    any, and torques [Nm], one after the other, shape (2 n,) or (3 n,).

    Args:
        robot: Gives the effort limits.
        tool: What forces act on.
        velocity_delay_s: Age of the velocity that `accept` gets [s].
        has_velocity: Whether samples carry a velocity.

    Attributes:
        memory: All that it remembers.
    """

    def __init__(
        self,
        robot: Robot,
        tool: ToolKinematics,
        velocity_delay_s: float,
        *,
        has_velocity: bool,
    ) -> None:
        n = self._joints = robot.nv
        size = (3 if has_velocity else 2) * n
        self._has_velocity = has_velocity
        self._delay_s = velocity_delay_s
        # Infinite, or those of a large arm, where the description gives none.
        self._limit_Nm = known_limits(robot.effort_limit_Nm, np.inf)
        self._effort_Nm = known_limits(robot.effort_limit_Nm, UNKNOWN_EFFORT_NM)
        self._tool = tool
        self.restore(
            GuardState(
                last=np.zeros(size),
                before=np.zeros(size),
                velocity=np.zeros(n),
                alone=SingleSignalDetector(
                    np.zeros(n), np.zeros(n), np.full(n, np.inf)
                ),
                probe=NoiseProbe(np.zeros((stuck.MOST_SAMPLES, size))),
            )
        )

    def _set_gates(self, noise: Array) -> None:
        """Largest plausible jump within no time, of signals with a noise; shape of a
        sample.
        """
        n = self._joints
        # The difference of two samples has sqrt(2) times the noise of one.
        self._gates = SIGMAS * np.sqrt(2.0) * noise
        self._gates[:n] += LEAST_POSITION_RAD
        self._gates[-n:] += np.maximum(TORQUE_RATIO * self._effort_Nm, LEAST_TORQUE_NM)
        sure = self._gates.copy()
        if self._has_velocity:
            sure[n:-n] += ACCELERATION_RAD_S2 * 1e-4
        # A weighted difference that is smaller than the narrowest gate is within all.
        self._narrowest = float(sure.min())
        self._weight = self._narrowest / sure

    def surely_passes(self, now: Array) -> bool:
        """Whether a sample, of any numbers, need not be checked: nearly all that
        come are such.
        """
        self._repeats = _NO_REPEATS
        memory = self.memory
        distance = fresh_distance(now, memory.last, self._weight, self._joints)
        return distance < self._narrowest and not memory.is_loaded

    def check(self, now: Array, dt_s: float) -> bool:
        """Judge a sample; what it is compared with changes only with `accept`.

        Returns whether its position has jumped and is accepted only because it stayed
        where it is; `SampleError` for a spike, frozen signals or a saturated torque.
        """
        memory = self.memory
        off = now - memory.last
        if memory.is_loaded:
            self._check_saturated(now)
        self._repeats = _NO_REPEATS
        if off.item(0) == 0.0 or off.item(-1) == 0.0:
            n = self._joints
            position_repeats = not off[:n].any()
            motion_repeats = position_repeats and not off[n:-n].any()
            torque_repeats = not off[-n:].any()
            self._repeats = position_repeats, motion_repeats, torque_repeats
            frozen = ["position"] * (motion_repeats and memory.motion.is_stuck(dt_s))
            frozen += ["torque"] * (torque_repeats and memory.torque.is_stuck(dt_s))
            if frozen:
                raise SampleError(
                    f"{' and '.join(frozen)} of all joints repeat bit for bit although they are "
                    "noisy; check the sensors and the connection",
                    SensorWarning.FROZEN,
                )
        return memory.noise is not None and self._check_jump(now, dt_s)

    def accept(self, now: Array, velocity: Array, dt_s: float) -> None:
        """The sample last checked has been used; the arrays are kept, not copied.

        Its joint velocity [rad/s] is measured or estimated; ``dt_s`` is 0 for the first
        sample.
        """
        memory = self.memory
        probe = self.memory.probe
        memory.before = memory.last
        memory.step_s = dt_s
        memory.last = now
        memory.velocity = velocity
        position_repeats, motion_repeats, torque_repeats = self._repeats
        if position_repeats:
            memory.held_s += dt_s
            memory.swept = self._sweep(velocity, dt_s)
        elif memory.held_s:
            memory.held_s = 0.0
            memory.swept = None
        learning = probe is not None
        if motion_repeats or memory.motion.repeats:
            memory.motion.accept(motion_repeats, dt_s, learning=learning)
        if torque_repeats or memory.torque.repeats:
            memory.torque.accept(torque_repeats, dt_s, learning=learning)
        if memory.missed_s:
            memory.rejected = None
            memory.missed_s = 0.0
            memory.stayed_s = 0.0
        if probe is not None and (rows := probe.add(now, dt_s)) is not None:
            self._learn(rows)
        memory.age_s += dt_s
        if memory.age_s >= CHECK_S - ROUNDING_S:
            self._check_each()

    def _sweep(self, velocity: Array, dt_s: float) -> Array:
        """Travel that positions may lag by after one more sample in which they repeated
        [rad].

        A source of positions that is slower than the clock makes up for it in one step.
        """
        memory = self.memory
        speed = np.abs(velocity)
        if not self._has_velocity:
            speed = speed + HELD_ACCELERATION_RAD_S2 * min(
                memory.held_s, stuck.LONGEST_USUAL_S
            )
        if memory.swept is None:
            return speed * dt_s
        # Forgets, so that noise of the velocity does not add up while an arm rests.
        return (
            memory.swept * max(1.0 - dt_s / stuck.LONGEST_USUAL_S, 0.0) + speed * dt_s
        )

    def _learn(self, rows: Array) -> None:
        """The first half second, shape (m, size), is over: learn noise and
        resolution.
        """
        n = self._joints
        memory = self.memory
        # Each signal by its own clock: what mostly repeats would seem to have no noise.
        signals = np.split(rows, rows.shape[1] // n, axis=1)
        memory.noise = np.concatenate(
            [stuck.white_noise(stuck.new_rows(each)) for each in signals]
        )
        memory.probe = None
        self._set_gates(memory.noise)
        torque = stuck.stands_out(rows[:, -n:])
        memory.torque.is_telling = bool(torque.all())
        memory.alone.learn(torque, memory.torque.usual_s)
        # Encoders may be too coarse for noise where velocities are not.
        motion = stuck.stands_out(rows[:, :-n]).reshape(-1, n)
        memory.motion.is_telling = bool(motion.any(axis=0).all())

    def _check_each(self) -> None:
        """Every so often: does one torque repeat by itself, is one near its limit?"""
        memory = self.memory
        torque = memory.last[-self._joints :]
        alone = memory.alone.check(torque, memory.age_s)
        memory.is_loaded = bool((np.abs(torque) >= LOADED_RATIO * self._limit_Nm).any())
        memory.age_s = 0.0
        memory.warning = memory.question = ""
        if alone and not memory.torque.repeats:
            memory.warning = (
                f"tau at {named_joints(alone)} repeats bit for bit: check its sensor"
            )
        elif memory.torque.seems_stuck or memory.motion.seems_stuck:
            memory.warning = "all joints still repeat bit for bit; no longer held back, the arm may rest"
        elif memory.alone.longest_s >= STILL_S:
            still = np.flatnonzero(memory.alone.still_s >= STILL_S)
            is_all = memory.held_s >= STILL_S and len(still) == self._joints
            what = (
                "neither q nor tau has"
                if is_all
                else f"tau at {named_joints(still)} has not"
            )
            memory.question = f"{what} changed for a second: is it stale?"

    def _check_saturated(self, now: Array) -> None:
        load = np.abs(now[-self._joints :]) / self._limit_Nm
        clipped = np.flatnonzero(load >= SATURATED_RATIO)
        if clipped.size:
            what = (
                "it seems to be in mNm"
                if load.max() > MOST_LOAD
                else "the true one may be more"
            )
            raise SampleError(
                f"tau is at the effort limit at {named_joints(clipped)}: {what}; unload the arm, "
                "or correct the limits of the robot's description",
                SensorWarning.SATURATED,
            )

    def _check_jump(self, now: Array, dt_s: float) -> bool:
        self._check_saturated(now)
        memory = self.memory
        beyond = self._beyond(now, memory.last, dt_s)
        if not beyond.any():
            return False
        has_moved = bool(beyond[0].any())
        if dt_s > LONGEST_HOLD_S:
            return has_moved and memory.missed_s > 0.0
        since_s = dt_s - memory.missed_s
        rejected = memory.rejected
        agrees = rejected is not None and not self._beyond(now, rejected, since_s).any()
        memory.stayed_s = memory.stayed_s + since_s if agrees else 0.0
        memory.missed_s = dt_s
        memory.rejected = now
        if memory.stayed_s >= STAYED_S - ROUNDING_S:
            return has_moved
        jumped = named_joints(np.flatnonzero(beyond.any(axis=0)))
        raise SampleError(
            f"a signal jumped further than an arm can at {jumped}; held back unless it stays for "
            f"{STAYED_S:g} s",
            SensorWarning.SPIKE,
        )

    def _beyond(self, now: Array, last: Array, dt_s: float) -> NDArray[np.bool_]:
        """Which signals have jumped further than an arm or a contact can, shape
        (signals, n).
        """
        n = self._joints
        memory = self.memory
        velocity = self.memory.velocity
        change = now - last
        gates = self._gates.copy()
        # A tick too: a sample that comes twice is no spike.
        gates[:n] += np.abs(velocity) * (dt_s + CLOCK_S)
        # Positions are predicted with a velocity that is late.
        gates[:n] += ACCELERATION_RAD_S2 * dt_s * (dt_s + self._delay_s)
        if memory.swept is not None:
            gates[:n] += memory.swept
        if memory.step_s > 0.0:
            # A joint at rest shows its encoder's step at times, and not in the learnt
            # noise.
            step = np.abs(memory.last[:n] - memory.before[:n])
            gates[:n] += np.where(step == 0.0, COARSE_RAD, np.minimum(step, COARSE_RAD))
        if self._has_velocity:
            gates[n:-n] += ACCELERATION_RAD_S2 * dt_s
        gates[-n:] += TORQUE_RATIO_PER_S * dt_s * self._effort_Nm
        off = change.copy()
        off[:n] -= velocity * dt_s
        beyond = np.abs(off) > gates
        if beyond.any() and memory.step_s > 0.0:
            # A fast arm goes on as it did: no single sample that is far off does.
            course = (memory.last - memory.before) * (dt_s / memory.step_s)
            beyond &= np.abs(change - course) > gates
        beyond = beyond.reshape(-1, n)
        if beyond[-1].any() and not beyond[:-1].any():
            self._tool.update(now[:n])
            if is_contact(self._tool.jacobian[:3], change[-n:], self._gates[-n:]):
                beyond[-1] = False
        return beyond

    def restore(self, memory: GuardState) -> None:
        """Go on from a `memory`, which is kept, of a detector of the same robot and
        signals.
        """
        self.memory = memory
        self._set_gates(
            np.zeros_like(memory.last) if memory.noise is None else memory.noise
        )
        self._repeats = _NO_REPEATS
