"""Holds back samples that are sound numbers and yet no measurement: spikes, frozen, saturated.

A jump is judged against what an arm can do in the time and against the noise of the signal itself,
learnt in the first half second; before that nothing counts as a spike or as frozen. What is held
back is treated like a lost sample: time passes, the estimate stays.
"""

import math
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from needleforce.jit import Vector, compiled
from residual.errors import SuspectSampleError
from residual.estimate import SensorWarning
from residual.input_validation import ROUNDING_S
from residual.stuck_signals import (
    AloneState,
    AloneWatch,
    NoiseProbe,
    NoiseState,
    RepeatState,
    StuckSignalDetector,
    new_rows,
    stands_out,
    white_noise,
)
from urdf import Robot

# How far a joint signal may jump between two samples.


SIGMAS = 12.0
"""A jump within this many standard deviations of the signal's noise is noise."""
TORQUE_SHARE = 0.02
"""Share of the effort limit by which a torque may step for no reason. On the LWR that is 3.5 Nm at
the shoulder, 5 N at 0.65 m, and 0.8 Nm at the wrist; what a force on the tool explains may step by
more, see `residual.fault_detection`."""
LEAST_TORQUE_NM = 0.7
"""Never less than this: the gears of a moving wrist of 12 Nm make as much in a millisecond."""
TORQUE_SHARE_PER_S = 2.0
"""Share of the effort limit per second, beyond the step: for lost samples."""
ACCELERATION_RAD_S2 = 20.0
"""An arm that inserts a needle stays far below."""
LEAST_POSITION_RAD = 1e-4
UNKNOWN_EFFORT_NM = 300.0
"""Stands in where a description gives no effort limit: the shoulder of an arm for ten kilograms.
Torques from motor currents step by 20 Nm there where the friction of its gears turns round."""
CLOCK_S = 5e-3
"""Time by which the stamps of a computer may be off from those of the robot [s]. At the speeds of a
needle it is nothing: 0.1 rad/s make half a milliradian of it."""
LONGEST_HELD_S = 0.1
"""No source of positions is slower than ten samples a second."""
HELD_ACCELERATION_RAD_S2 = 4.0
"""Change of an estimated velocity that positions do not tell while they repeat. Far less than what
a single step may be off by: an arm at rest repeats its positions for ever."""


@compiled
def fresh_distance(now: Vector, last: Vector, weight: Vector, joints: int) -> float:
    """Root of the sum of squares of the weighted differences of two samples.

    Infinite if all positions or all torques repeat.

    Args:
        now: A sample, positions first and torques last, shape (2 n,) or (3 n,).
        last: The one before.
        weight: What differences are multiplied with, not 0.
        joints: n.
    """
    off = (now - last) * weight
    if (off[0] == 0.0 and not off[:joints].any()) or (off[-1] == 0.0 and not off[-joints:].any()):
        return math.inf
    return math.sqrt(np.vdot(off, off))  # `dot` warns of an overflow


class OutlierGate:
    """Largest believable jump of position (less its velocity times the time), velocity and torque.

    Args:
        robot: Gives the effort limits.
        has_velocity: Whether samples carry a velocity.
        delay_s: Age of the velocity that positions are foretold with [s].
    """

    def __init__(self, robot: Robot, *, has_velocity: bool, delay_s: float) -> None:
        n = self._joints = robot.nv
        self._has_velocity, self._delay_s = has_velocity, delay_s
        limit = robot.effort_limit_Nm
        self.effort_Nm = np.where(np.isfinite(limit) & (limit > 0), limit, np.inf)
        """Effort limits [Nm], infinite where the description gives none, shape (n,)."""
        self._effort = np.where(np.isfinite(self.effort_Nm), limit, UNKNOWN_EFFORT_NM)
        self.learn(np.zeros((3 if has_velocity else 2) * n))

    def learn(self, noise: NDArray[np.float64]) -> None:
        """Tell the noise of all signals: position, velocity if there is one, torque."""
        n = self._joints
        # The difference of two samples has sqrt(2) times the noise of one.
        self._base = SIGMAS * np.sqrt(2.0) * noise
        self._base[:n] += LEAST_POSITION_RAD
        self._base[-n:] += np.maximum(TORQUE_SHARE * self._effort, LEAST_TORQUE_NM)
        sure = self._base.copy()
        if self._has_velocity:
            sure[n:-n] += ACCELERATION_RAD_S2 * 1e-4
        self.narrowest = float(sure.min())
        """What is surely nearer than this is within all gates; a NaN is not."""
        self.weight = self.narrowest / sure
        """What differences are multiplied with before, at most 1, shape of a sample."""

    def is_near(self, off: NDArray[np.float64]) -> bool:
        """Whether a difference is within the narrowest gates, all signals together."""
        return math.hypot(*(off * self.weight).tolist()) < self.narrowest

    @property
    def torque_Nm(self) -> NDArray[np.float64]:
        """Torque that may step within no time, shape (n,)."""
        return self._base[-self._joints :]

    def beyond(
        self,
        off: NDArray[np.float64],
        velocity: NDArray[np.float64],
        dt_s: float,
        swept_rad: NDArray[np.float64] | None = None,
    ) -> NDArray[np.bool_]:
        """Which differences are beyond what an arm can do.

        Args:
            off: Differences of all signals, positions less what the velocity foretells.
            velocity: Joint velocity [rad/s], shape (n,).
            dt_s: Time between the two samples [s].
            swept_rad: See `sweep`; None if positions had not repeated.

        Returns:
            A row for each signal, shape (k, n).
        """
        n = self._joints
        gate = self._base.copy()
        late_s = dt_s + self._delay_s
        # A tick too: a sample that comes twice is no spike.
        unsure_s = dt_s + CLOCK_S
        gate[:n] += np.abs(velocity) * unsure_s + ACCELERATION_RAD_S2 * dt_s * late_s
        if swept_rad is not None:
            gate[:n] += swept_rad
        if self._has_velocity:
            gate[n:-n] += ACCELERATION_RAD_S2 * dt_s
        gate[-n:] += TORQUE_SHARE_PER_S * dt_s * self._effort
        return (np.abs(off) > gate).reshape(-1, n)

    def sweep(
        self,
        swept_rad: NDArray[np.float64] | None,
        velocity: NDArray[np.float64],
        dt_s: float,
        held_s: float,
    ) -> NDArray[np.float64]:
        """Way that positions may owe after one more sample in which they repeated [rad].

        A source of positions that is slower than the clock makes up for it in one step.

        Args:
            swept_rad: After the sample before, shape (n,); None if that one was new.
            velocity: Of this sample [rad/s], shape (n,).
            dt_s: Time between the two [s].
            held_s: Time for which positions have repeated [s].
        """
        speed = np.abs(velocity)
        if not self._has_velocity:
            speed = speed + HELD_ACCELERATION_RAD_S2 * min(held_s, LONGEST_HELD_S)
        if swept_rad is None:
            return speed * dt_s
        # Forgets, so that noise of the velocity does not add up while an arm rests.
        return swept_rad * max(1.0 - dt_s / LONGEST_HELD_S, 0.0) + speed * dt_s


# Whether torques that jump do so as a force on the tool makes them.


MOST_STEP_N = 100.0
"""A force that may come or go within one sample: a rupture is newtons, a stiff contact tens."""
MOST_UNEXPLAINED = 0.35
"""Share of the jump that the force may leave over; a spike of one joint leaves most of itself."""


class ContactTransient:
    """Tells a contact, felt by all joints according to their levers, from a spike of a sensor.

    Args:
        robot: The arm; forces act on its tool frame.
    """

    def __init__(self, robot: Robot) -> None:
        self._model, self._data = robot.model, robot.create_data()
        self._frame_id = robot.tool_frame_id

    def explains(
        self, q: NDArray[np.float64], jump: NDArray[np.float64], scale: NDArray[np.float64]
    ) -> bool:
        """Whether a believable force explains a jump of the torques.

        Args:
            q: Configuration [rad], shape (n,).
            jump: Of the torques [Nm], shape (n,).
            scale: Jump that each joint is believed without a reason [Nm], shape (n,).
        """
        axes = pin.ReferenceFrame.LOCAL
        jacobian = pin.computeFrameJacobian(self._model, self._data, q, self._frame_id, axes)[:3]
        levers, wanted = jacobian.T / scale[:, None], jump / scale
        force = np.linalg.lstsq(levers, wanted, rcond=None)[0]
        left = wanted - levers.dot(force)
        is_explained = left.dot(left) <= MOST_UNEXPLAINED**2 * wanted.dot(wanted)
        return bool(is_explained and force.dot(force) <= MOST_STEP_N**2)


# What a sample guard remembers from one sample to the next.


class GuardState(NamedTuple):
    """All that a `FaultDetector` remembers.

    Attributes:
        last: Last accepted sample: position, velocity if there is one, torque; shape (2 n,) or
            (3 n,); zeros before the first.
        velocity: Velocity that it left off with [rad/s], shape (n,).
        noise: Learnt noise of the same signals; None until learnt.
        probe: What is known of the noise so far; None once it is learnt.
        rejected: Last sample held back as a spike, or None.
        missed_s: Time since the last accepted sample [s].
        stayed_s: Time for which samples held back agree with each other [s].
        motion: Of the watch for positions and velocities that repeat.
        torque: Of the watch for torques that repeat.
        alone: Of the watch for single torques that repeat.
        age_s: Time since each torque was looked at by itself [s].
        is_loaded: Whether a torque was near its limit at that look.
        warning: What seemed frozen at that look.
        held_s: Time for which positions have repeated now [s].
        swept: Way that they may owe meanwhile [rad], shape (n,); None if they do not repeat.
    """

    last: NDArray[np.float64]
    velocity: NDArray[np.float64]
    noise: NDArray[np.float64] | None
    probe: NoiseState | None
    rejected: NDArray[np.float64] | None
    missed_s: float
    stayed_s: float
    motion: RepeatState
    torque: RepeatState
    alone: AloneState
    age_s: float
    is_loaded: bool
    warning: str
    held_s: float = 0.0
    swept: NDArray[np.float64] | None = None


def fresh_guard(joints: int, size: int) -> GuardState:
    """Nothing seen yet.

    Args:
        joints: Number of joints.
        size: Length of a sample.
    """
    return GuardState(
        last=np.zeros(size),
        velocity=np.zeros(joints),
        noise=None,
        probe=NoiseProbe(size).state,
        rejected=None,
        missed_s=0.0,
        stayed_s=0.0,
        motion=RepeatState(),
        torque=RepeatState(),
        alone=AloneWatch(joints).state,
        age_s=0.0,
        is_loaded=False,
        warning="",
    )


LOOK_S = 0.02
"""Every so often each torque is looked at by itself [s]."""
STAYED_S = 5e-3
"""A jump that has stayed for this long is believed: the signal is elsewhere now [s]."""
LONGEST_HOLD_S = 0.1
"""Whatever a signal that jumps does, it is not held back for longer than this [s]."""
SATURATED_SHARE = 0.99
"""Share of the effort limit from which a torque counts as clipped."""
LOADED_SHARE = 0.9
"""Share of the effort limit from which every torque is watched."""


class FaultDetector:
    """Judges the samples of one stream before anything absorbs them.

    Args:
        robot: Gives the effort limits, and the levers of a force on its tool.
        has_velocity: Whether samples carry a velocity.
        velocity_delay_s: Age of the velocity that `accept` is told [s].
    """

    def __init__(self, robot: Robot, *, has_velocity: bool, velocity_delay_s: float = 0.0) -> None:
        n = self._joints = robot.nv
        self._gates = OutlierGate(robot, has_velocity=has_velocity, delay_s=velocity_delay_s)
        self._contact = ContactTransient(robot)
        self._motion, self._torque, self._alone = (
            StuckSignalDetector(),
            StuckSignalDetector(),
            AloneWatch(n),
        )
        self.restore(fresh_guard(n, (3 if has_velocity else 2) * n))

    def surely_passes(self, now: NDArray[np.float64]) -> bool:
        """Whether a sample, of any numbers, need not be checked: nearly all that come are such.

        Args:
            now: As in `check`.
        """
        self._position_repeats = self._motion_repeats = self._torque_repeats = False
        gates = self._gates
        distance = fresh_distance(now, self._last, gates.weight, self._joints)
        return distance < gates.narrowest and not self._is_loaded

    def check(self, now: NDArray[np.float64], dt_s: float) -> bool:
        """Judge a sample; what it is compared with changes only with `accept`.

        Args:
            now: Finite positions [rad], velocities [rad/s] if there are any, and torques [Nm], one
                after the other, shape (2 n,) or (3 n,).
            dt_s: Time since the last accepted sample [s].

        Returns:
            Whether its position has jumped and is believed only because it stayed where it is.

        Raises:
            SuspectSampleError: For a spike, frozen signals or a saturated torque.
        """
        off = now - self._last
        if self._is_loaded:
            self._check_saturated(now)
        self._position_repeats = self._motion_repeats = self._torque_repeats = False
        if off.item(0) == 0.0 or off.item(-1) == 0.0:
            self._check_frozen(off, dt_s)
        if self._noise is None or self._gates.is_near(off):
            return False
        return self._check_jump(now, dt_s)

    def accept(self, now: NDArray[np.float64], velocity: NDArray[np.float64], dt_s: float) -> None:
        """The sample last checked has been absorbed; the arrays are kept, not copied.

        Args:
            now: The sample.
            velocity: Joint velocity that it leaves off with, measured or estimated [rad/s].
            dt_s: Time since the one before [s]; 0 for the first.
        """
        self._last, self._velocity = now, velocity
        learning = self._probe is not None
        if self._position_repeats:
            self._held_s += dt_s
            self._swept = self._gates.sweep(self._swept, velocity, dt_s, self._held_s)
        elif self._held_s:
            self._held_s, self._swept = 0.0, None
        if self._motion_repeats or self._motion.repeats:
            self._motion.accept(self._motion_repeats, dt_s, learning=learning)
        if self._torque_repeats or self._torque.repeats:
            self._torque.accept(self._torque_repeats, dt_s, learning=learning)
        if self._missed_s:
            self._rejected, self._missed_s, self._stayed_s = None, 0.0, 0.0
        if learning:
            self._learn(dt_s)
        self._age_s += dt_s
        if self._age_s >= LOOK_S - ROUNDING_S:
            self._look()

    def _what_seems_frozen(self) -> str:
        if self._alone.stuck and not self._torque.repeats:
            return f"tau at joint index {self._alone.stuck} repeats bit for bit: check its sensor"
        if self._torque.seems_stuck or self._motion.seems_stuck:
            return "all joints still repeat bit for bit; no longer held back, the arm may rest"
        return ""

    def _learn(self, dt_s: float) -> None:
        assert self._probe is not None
        if self._probe.add(self._last, dt_s) is None:
            return
        n, rows = self._joints, self._probe.rows
        # Each signal by its own clock: what mostly repeats would seem to have no noise.
        signals = np.split(rows, rows.shape[1] // n, axis=1)
        self._noise = np.concatenate([white_noise(new_rows(signal)) for signal in signals])
        self._probe = None
        self._gates.learn(self._noise)
        torque = stands_out(rows[:, -n:])
        self._torque.learn(bool(torque.all()))
        self._alone.learn(torque, self._torque.usual_s)
        # Encoders may be too coarse for noise where velocities are not.
        motion = stands_out(rows[:, :-n]).reshape(-1, n).any(axis=0)
        self._motion.learn(bool(motion.all()))

    def _look(self) -> None:
        """Every so often: does one torque repeat by itself, is one near its limit?"""
        torque = self._last[-self._joints :]
        self._alone.look(torque, self._age_s)
        self._is_loaded = bool((np.abs(torque) >= LOADED_SHARE * self._gates.effort_Nm).any())
        self._age_s = 0.0
        self.warning = self._what_seems_frozen()

    def _check_saturated(self, now: NDArray[np.float64]) -> None:
        limit = SATURATED_SHARE * self._gates.effort_Nm
        clipped = [int(i) for i in np.flatnonzero(np.abs(now[-self._joints :]) >= limit)]
        if clipped:
            raise SuspectSampleError(
                f"tau is at the effort limit at joint index {clipped}: the true torque may be "
                "anything beyond; unload the arm, or correct the limits of the robot's description",
                SensorWarning.SATURATED,
            )

    def _check_frozen(self, off: NDArray[np.float64], dt_s: float) -> None:
        n = self._joints
        self._position_repeats = not off[:n].any()
        self._motion_repeats = self._position_repeats and not off[n:-n].any()
        self._torque_repeats = not off[-n:].any()
        frozen = [
            name
            for name, repeats, watch in (
                ("position", self._motion_repeats, self._motion),
                ("torque", self._torque_repeats, self._torque),
            )
            if repeats and watch.is_stuck(dt_s)
        ]
        if frozen:
            raise SuspectSampleError(
                f"{' and '.join(frozen)} of all joints repeat bit for bit although they are noisy; "
                "check the sensors and the connection",
                SensorWarning.FROZEN,
            )

    def _check_jump(self, now: NDArray[np.float64], dt_s: float) -> bool:
        self._check_saturated(now)
        beyond = self._beyond(now, self._last, dt_s)
        if not beyond.any():
            return False
        has_moved = bool(beyond[0].any())
        if dt_s > LONGEST_HOLD_S:
            return has_moved and self._missed_s > 0.0
        since_s = dt_s - self._missed_s
        rejected = self._rejected
        agrees = rejected is not None and not self._beyond(now, rejected, since_s).any()
        self._stayed_s = self._stayed_s + since_s if agrees else 0.0
        self._missed_s, self._rejected = dt_s, now
        if self._stayed_s >= STAYED_S - ROUNDING_S:
            return has_moved
        jumped = [int(i) for i in np.flatnonzero(beyond.any(axis=0))]
        raise SuspectSampleError(
            f"a signal jumped further than an arm can at joint index {jumped}; held back "
            f"unless it stays for {STAYED_S:g} s",
            SensorWarning.SPIKE,
        )

    def _beyond(
        self, now: NDArray[np.float64], before: NDArray[np.float64], dt_s: float
    ) -> NDArray[np.bool_]:
        """Which signals have jumped further than an arm or a contact can, shape (signals, n)."""
        n = self._joints
        off = now - before
        off[:n] -= self._velocity * dt_s
        beyond = self._gates.beyond(off, self._velocity, dt_s, self._swept)
        if (
            beyond[-1].any()
            and not beyond[:-1].any()
            and self._contact.explains(now[:n], off[-n:], self._gates.torque_Nm)
        ):
            beyond[-1] = False
        return beyond

    @property
    def state(self) -> GuardState:
        """All that the guard remembers; its arrays are never written again."""
        return GuardState(
            self._last,
            self._velocity,
            self._noise,
            None if self._probe is None else self._probe.state,
            self._rejected,
            self._missed_s,
            self._stayed_s,
            self._motion.state,
            self._torque.state,
            self._alone.state,
            self._age_s,
            self._is_loaded,
            self.warning,
            self._held_s,
            self._swept,
        )

    def restore(self, state: GuardState) -> None:
        """Go on from a `state` taken earlier."""
        self._last, self._velocity, self._noise = state.last, state.velocity, state.noise
        self._gates.learn(np.zeros_like(self._last) if state.noise is None else state.noise)
        self._probe = None
        if state.probe is not None:
            self._probe = NoiseProbe(len(self._last))
            self._probe.restore(state.probe)
        self._rejected = state.rejected
        self._missed_s, self._stayed_s = state.missed_s, state.stayed_s
        self._motion.restore(state.motion)
        self._torque.restore(state.torque)
        self._alone.restore(state.alone)
        self._position_repeats = self._motion_repeats = self._torque_repeats = False
        self._held_s, self._swept = state.held_s, state.swept
        self._age_s, self._is_loaded = state.age_s, state.is_loaded
        self.warning = state.warning
        """What seems frozen in samples that are accepted all the same; empty if nothing does."""
