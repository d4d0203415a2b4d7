"""Holds back samples that are sound numbers and yet no measurement: spikes, frozen, saturated.

A jump is judged against what an arm can do in the time and against the noise of the signal itself,
learnt in the first half second; before that nothing counts as a spike or as frozen. What is held
back is treated like a lost sample: time passes, the estimate stays.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.errors import SuspectSampleError
from residual.noise_probe import NoiseProbe, NoiseState
from residual.sample_check import check_joint_vector
from residual.spike_gates import SpikeGates
from residual.wrench_estimate import Caution
from urdf import Robot

LOOK_S = 0.02
"""Every so often the torques since the last look are looked at together [s]."""
LEAST_ROWS, MOST_ROWS = 8, 64
"""How many samples such a look needs, and takes at most."""
STAYED_S = 5e-3
"""A jump that has stayed for this long is believed: the signal is elsewhere now [s]."""
LONGEST_HOLD_S = 0.1
"""Whatever the signal does, it is not held back for longer than this [s]."""
SATURATED_SHARE = 0.99
"""Share of the effort limit from which a torque counts as clipped."""
LOADED_SHARE = 0.9
"""Share of the effort limit from which every torque is watched."""


class GuardState(NamedTuple):
    """All that a `SampleGuard` remembers.

    Attributes:
        last: Last accepted sample: position, velocity if there is one, torque; shape (2 n,) or
            (3 n,); zeros before the first.
        velocity: Velocity that it left off with [rad/s], shape (n,).
        noise: Learnt noise of the same signals; None until learnt.
        probe: What is known of the noise so far; None once it is learnt.
        rejected: Last sample held back as a spike, or None.
        held_s: Time since the last accepted sample [s].
        stayed_s: Time for which samples held back agree with each other [s].
        rows: Samples since the torques were last looked at, shape (m, 2 n) or (m, 3 n).
        age_s: Time since then [s].
        stuck: Torques that repeat, not finite elsewhere, shape (n,); None if none does.
        is_loaded: Whether a torque was near its limit at that look.
    """

    last: NDArray[np.float64]
    velocity: NDArray[np.float64]
    noise: NDArray[np.float64] | None
    probe: NoiseState | None
    rejected: NDArray[np.float64] | None
    held_s: float
    stayed_s: float
    rows: NDArray[np.float64]
    age_s: float
    stuck: NDArray[np.float64] | None
    is_loaded: bool


class SampleGuard:
    """Judges the samples of one stream before anything absorbs them.

    Args:
        robot: Gives the effort limits.
        has_velocity: Whether samples carry a velocity.
        velocity_delay_s: Age of the velocity that `accept` is told [s].
    """

    def __init__(self, robot: Robot, *, has_velocity: bool, velocity_delay_s: float = 0.0) -> None:
        n = self._joints = robot.nv
        self._has_velocity = has_velocity
        size = (3 if has_velocity else 2) * n
        self._gates = SpikeGates(robot, has_velocity=has_velocity, delay_s=velocity_delay_s)
        # A sample is written into the next row and stays there once it is accepted.
        self._rows = np.zeros((MOST_ROWS + 1, size))
        self._views = list(self._rows)
        self.restore(_fresh(n, size))

    def check(self, q: ArrayLike, dq: ArrayLike | None, tau: ArrayLike, dt_s: float) -> bool:
        """Judge a sample; what it is compared with changes only with `accept`.

        Samples that are no vectors of numbers pass: they are refused where they are absorbed.

        Args:
            q: Positions [rad], shape (n,).
            dq: Velocities [rad/s], shape (n,), or None.
            tau: Torques [Nm], shape (n,).
            dt_s: Time since the last accepted sample [s].

        Returns:
            Whether it has jumped and is believed only because it stayed where it is.

        Raises:
            SampleError: For numbers that are not finite.
            SuspectSampleError: For a spike, a frozen or a saturated torque.
        """
        n, now = self._joints, self._views[self._count]
        try:
            now[:n] = q
            now[-n:] = tau
            if self._has_velocity:
                if dq is None:
                    return False
                now[n:-n] = dq
        except (TypeError, ValueError):
            return False
        if self._is_careful:
            self._check_torque(now[-n:])
        if self._noise is None or self._gates.surely_pass(now - self._last):
            return False
        return self._check_jump(now, dt_s)

    def accept(self, velocity: NDArray[np.float64], dt_s: float) -> None:
        """The sample last checked has been absorbed.

        Args:
            velocity: Joint velocity that it leaves off with, measured or estimated [rad/s].
            dt_s: Time since the one before [s]; 0 for the first.
        """
        self._velocity = velocity
        self._last = self._views[self._count]
        self._count += 1
        self._age_s += dt_s
        if self._held_s:
            self._rejected, self._held_s, self._stayed_s = None, 0.0, 0.0
        if self._probe is not None:
            self._learn(dt_s)
        if self._count == MOST_ROWS or (self._age_s >= LOOK_S and self._count >= LEAST_ROWS):
            self._look()

    def _learn(self, dt_s: float) -> None:
        assert self._probe is not None
        noise = self._probe.add(self._last, dt_s)
        if noise is not None:
            self._noise, self._probe = noise, None
            self._gates.learn(noise)

    def _look(self) -> None:
        """Every so often: does a torque repeat itself, is one near its limit?"""
        torque, self._stuck = self._rows[: self._count, -self._joints :], None
        if self._noise is not None:
            # A signal without noise may repeat itself.
            stuck = (torque == torque[0]).all(axis=0) & (self._noise[-self._joints :] > 0.0)
            if stuck.any():
                self._stuck = np.where(stuck, torque[0], np.nan)
        self._is_loaded = bool((np.abs(torque[-1]) >= LOADED_SHARE * self._gates.effort_Nm).any())
        self._is_careful = self._is_loaded or self._stuck is not None
        # The last row is what the next sample is compared with, and must not be overwritten.
        self._rows[MOST_ROWS] = self._last
        self._last = self._views[MOST_ROWS]
        self._count, self._age_s = 0, 0.0

    def _check_torque(self, torque: NDArray[np.float64]) -> None:
        limit = SATURATED_SHARE * self._gates.effort_Nm
        clipped = [int(i) for i in np.flatnonzero(np.abs(torque) >= limit)]
        if clipped:
            raise SuspectSampleError(
                f"tau is at the effort limit at joint index {clipped}: the true torque may be "
                "anything beyond; unload the arm, or correct the limits of the robot's description",
                Caution.SATURATED,
            )
        if self._stuck is None:
            return
        stuck = [int(i) for i in np.flatnonzero(torque == self._stuck)]
        if stuck:
            raise SuspectSampleError(
                f"tau at joint index {stuck} repeats bit for bit although its sensor is noisy; "
                "check the sensor and the connection",
                Caution.FROZEN,
            )
        self._stuck, self._is_careful = None, self._is_loaded

    def _check_jump(self, now: NDArray[np.float64], dt_s: float) -> bool:
        if not np.isfinite(now).all():
            n, names = self._joints, ("q", "dq", "tau") if self._has_velocity else ("q", "tau")
            for name, part in zip(names, now.reshape(-1, n), strict=True):
                check_joint_vector(name, part, n)
        self._check_torque(now[-self._joints :])
        if dt_s > LONGEST_HOLD_S:
            return self._held_s > 0.0
        jumped = self._jumped(now, self._last, dt_s)
        if not jumped:
            return False
        since = dt_s - self._held_s
        agrees = self._rejected is not None and not self._jumped(now, self._rejected, since)
        self._stayed_s = self._stayed_s + since if agrees else 0.0
        self._held_s = dt_s
        self._rejected = now.copy()
        if self._stayed_s >= STAYED_S:
            return True
        raise SuspectSampleError(
            f"a signal jumped further than an arm can at joint index {jumped}; held back "
            f"unless it stays for {STAYED_S:g} s",
            Caution.SPIKE,
        )

    def _jumped(
        self, now: NDArray[np.float64], before: NDArray[np.float64], dt_s: float
    ) -> list[int]:
        off = now - before
        off[: self._joints] -= self._velocity * dt_s
        return self._gates.joints(off, self._velocity, dt_s)

    @property
    def state(self) -> GuardState:
        """All that the guard remembers, as copies."""
        return GuardState(
            self._last.copy(),
            self._velocity.copy(),
            self._noise,
            None if self._probe is None else self._probe.state,
            self._rejected,
            self._held_s,
            self._stayed_s,
            self._rows[: self._count].copy(),
            self._age_s,
            self._stuck,
            self._is_loaded,
        )

    def restore(self, state: GuardState) -> None:
        """Go on from a `state` taken earlier."""
        self._rows[MOST_ROWS] = state.last
        self._last = self._views[MOST_ROWS]
        self._count, self._age_s = len(state.rows), state.age_s
        self._rows[: self._count] = state.rows
        self._velocity, self._noise = state.velocity, state.noise
        self._gates.learn(np.zeros_like(self._last) if state.noise is None else state.noise)
        self._probe = None
        if state.probe is not None:
            self._probe = NoiseProbe(len(self._last))
            self._probe.restore(state.probe)
        self._rejected = state.rejected
        self._held_s, self._stayed_s = state.held_s, state.stayed_s
        self._stuck, self._is_loaded = state.stuck, state.is_loaded
        self._is_careful = self._is_loaded or self._stuck is not None


def _fresh(joints: int, size: int) -> GuardState:
    return GuardState(
        last=np.zeros(size),
        velocity=np.zeros(joints),
        noise=None,
        probe=NoiseProbe(size).state,
        rejected=None,
        held_s=0.0,
        stayed_s=0.0,
        rows=np.zeros((0, size)),
        age_s=0.0,
        stuck=None,
        is_loaded=False,
    )
