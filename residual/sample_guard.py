"""Holds back samples that are sound numbers and yet no measurement: spikes, frozen, saturated.

A jump is judged against what an arm can do in the time and against the noise of the signal itself,
learnt in the first half second; before that nothing counts as a spike or as frozen. What is held
back is treated like a lost sample: time passes, the estimate stays.
"""

import numpy as np
from numpy.typing import NDArray

from residual.contact_step import ContactStep
from residual.errors import SuspectSampleError
from residual.guard_state import GuardState, fresh_guard
from residual.noise_probe import NoiseProbe, new_rows, white_noise
from residual.repeat_watch import AloneWatch, RepeatWatch, stands_out
from residual.sample_clock import ROUNDING_S
from residual.spike_gates import SpikeGates, fresh_distance
from residual.wrench_estimate import Caution
from urdf import Robot

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


class SampleGuard:
    """Judges the samples of one stream before anything absorbs them.

    Args:
        robot: Gives the effort limits, and the levers of a force on its tool.
        has_velocity: Whether samples carry a velocity.
        velocity_delay_s: Age of the velocity that `accept` is told [s].
    """

    def __init__(self, robot: Robot, *, has_velocity: bool, velocity_delay_s: float = 0.0) -> None:
        n = self._joints = robot.nv
        self._gates = SpikeGates(robot, has_velocity=has_velocity, delay_s=velocity_delay_s)
        self._contact = ContactStep(robot)
        self._motion, self._torque, self._alone = RepeatWatch(), RepeatWatch(), AloneWatch(n)
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
                Caution.SATURATED,
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
                Caution.FROZEN,
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
            Caution.SPIKE,
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
