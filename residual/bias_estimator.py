"""Keeps the tare: records free motion, fits, subtracts, and says how far it may be trusted."""

from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from residual.bias_fit import FreeMotionFit
from residual.bias_model import BiasModel, Tare, TareBlocks, prior_tare
from residual.config import SensorConfig
from residual.errors import TareError
from residual.estimate import FORGOTTEN, TARE_EXPIRED
from residual.input_validation import ROUNDING_S
from residual.joint_states import JointStates
from residual.snapshot import copied
from residual.tare_check import check_free_of_contact
from residual.wrench_estimator import WrenchEstimator
from urdf import Robot

Array = NDArray[np.float64]
MOST_TORQUES = 1000
"""As many samples are kept between two renewals at most; then their sum is."""
MOST_BLOCKS = 400
"""When there are as many, the older half is merged in pairs: a fit takes a fraction of a second."""


@dataclass(slots=True, eq=False)
class TareRecorder:
    """Means of residual, position and joint states over short blocks of free motion.

    Memory is bounded: once there are `MOST_BLOCKS`, pairs of neighbours in the older half become
    one; the latest blocks stay short.
    """

    means: Array  # Of every block: position, residual, states; shape (m, 2 + states, n)
    time_s: Array  # Middle of every block [s], shape (m,)
    scatter: Array  # Variance within every block [Nm^2], shape (m, n)
    samples: tuple[int, ...]  # Number of samples of every block, shape (m,)
    sums: Array  # Of the open block, shape (2 + states, n)
    squares: Array  # Of its residuals [Nm^2], shape (n,)
    summed: int = 0  # Number of its samples
    age_s: float = 0.0  # Its length so far [s]

    @classmethod
    def of_size(cls, joints: int, states: int) -> Self:
        """Nothing recorded yet."""
        shape = (2 + states, joints)
        return cls(
            means=np.zeros((0, *shape)),
            time_s=np.zeros(0),
            scatter=np.zeros((0, joints)),
            samples=(),
            sums=np.zeros(shape),
            squares=np.zeros(joints),
        )

    @property
    def is_empty(self) -> bool:
        """Whether nothing has been recorded."""
        return not (self.samples or self.summed)

    def add(self, q: Array, states: Array, residual: Array, dt_s: float) -> None:
        """Add position [rad], joint states and residual [Nm] a time after the last ones."""
        self.sums[0] += q
        self.sums[1] += residual
        self.sums[2:] += states
        self.squares += residual * residual
        self.summed += 1
        self.age_s += dt_s

    def close_block(self, now_s: float) -> None:
        """End the open block; the next sample begins another."""
        means = self.sums / self.summed
        scatter = np.maximum(self.squares / self.summed - means[1] ** 2, 0.0)
        self.means = np.concatenate((self.means, means[None]))
        self.time_s = np.append(self.time_s, now_s - 0.5 * self.age_s)
        self.scatter = np.concatenate((self.scatter, scatter[None]))
        self.samples = (*self.samples, self.summed)
        self.sums, self.squares = np.zeros_like(self.sums), np.zeros_like(self.squares)
        self.summed, self.age_s = 0, 0.0
        if len(self.samples) >= MOST_BLOCKS:
            self._merge_older()

    def _merge_older(self) -> None:
        half = MOST_BLOCKS // 2
        first, second = slice(0, half, 2), slice(1, half, 2)
        counts = np.array(self.samples[:half])
        count = counts[::2] + counts[1::2]
        a, b = counts[::2] / count, counts[1::2] / count
        means, scatter, time_s = self.means, self.scatter, self.time_s
        between = (a * b)[:, None] * (means[first, 1] - means[second, 1]) ** 2
        merged = a[:, None, None] * means[first] + b[:, None, None] * means[second]
        spread = a[:, None] * scatter[first] + b[:, None] * scatter[second] + between
        self.means = np.concatenate((merged, means[half:]))
        self.scatter = np.concatenate((spread, scatter[half:]))
        self.time_s = np.append(a * time_s[first] + b * time_s[second], time_s[half:])
        self.samples = (*count.tolist(), *self.samples[half:])

    def blocks(self, now_s: float, window_s: float | None = None) -> TareBlocks:
        """What was recorded, or the last ``window_s`` of it [s]; there must be a block."""
        kept = np.ones(len(self.samples), dtype=bool)
        if window_s is not None:
            kept = now_s - self.time_s <= window_s
            kept[-1] = True
        means = self.means[kept]
        return TareBlocks(
            q_rad=means[:, 0],
            states=means[:, 2:],
            residual_Nm=means[:, 1],
            age_s=self.time_s[kept] - now_s,
            # The median, so that a knock in one block does not pass for noise in all.
            scatter_Nm2=np.median(self.scatter[kept], axis=0),
        )


class TareNumbers(NamedTuple):
    """A fitted `Tare` without its basis, which robot and settings give; see there."""

    mean: Array
    covariance: Array
    noise_Nm2: Array
    walk_Nm2_per_s: Array


@dataclass(slots=True, kw_only=True, eq=False)
class BiasState:
    """All that a `BiasEstimator` remembers."""

    recorder: TareRecorder  # Free motion recorded for the next tare
    # Of hysteresis and friction, see `residual.joint_states`; None before a sample
    joint_memory: Array | None = None
    states: Array  # What follows from it, shape (states, n)
    torque_sum: Array  # Of the torques since the last renewal [Nm], shape (n,)
    bias: Array  # Offset that is subtracted [Nm], shape (n,)
    q: Array  # Last position [rad], shape (n,)
    tare: TareNumbers | None = None  # The tare in force; None before the first
    tared: bool = False  # Whether it is the current one
    tared_s: float = 0.0  # When it was taken [s]
    now_s: float = 0.0  # Time since the start [s]
    renewed_s: float = 0.0  # When states and offset were renewed last [s]
    due_s: float = 0.0  # When they are renewed next [s]
    summed: int = 0  # Number of torques in the sum
    # Time in steps longer than `BiasEstimator.LEAP_S` since the tare, or since free motion is
    # recorded [s]
    leapt_s: float = 0.0


class BiasEstimator:
    """Subtracts the residual's error without contact from the observer's output.

    Until the first `tare` the prior stands in: no offset, a large covariance.

    Attributes:
        memory: All that it remembers, for whoever reads it every tick: not to be written.
    """

    RENEW_S = 0.02
    """The offset changes with pose and torque, slowly: it is renewed this often."""
    LEAP_S = 60.0
    """A longer time step is a pause or a clock that was set: one step cannot show which. Drift is
    hundredths of a newton in a minute, newtons in an hour. It counts as a pause, and is reported
    until the next tare. Free motion recorded before it is forgotten."""
    BLOCK_LAGS = 2.0
    """Length of a recorded block in lags of the observer: blocks are then nearly independent."""

    def __init__(self, robot: Robot, config: SensorConfig) -> None:
        self._config = config
        self._basis = BiasModel(robot, config.tare, config.prior)
        self._block_s = self.BLOCK_LAGS / config.slowest_gain_per_s
        self._joints = robot.nv
        self.reset()

    @property
    def warning(self) -> str:
        """What a leap has made of the tare, or of the motion recorded for it; empty without one."""
        if self.memory.leapt_s == 0.0:
            return ""
        return TARE_EXPIRED if self.memory.tared else FORGOTTEN

    @property
    def is_fresh(self) -> bool:
        """Whether neither tare nor recorded motion is of any use now."""
        return not self.memory.tared and self.memory.recorder.is_empty

    def follow(self, q: Array, tau: Array, dt_s: float) -> bool:
        """Follow position [rad], torque [Nm], both kept, not copied, and time since the last [s].

        Returns:
            Whether joint states and offset have been renewed; the covariance may then be read anew.
        """
        memory = self.memory
        memory.q = q
        memory.now_s += dt_s
        if dt_s > self.LEAP_S:
            # A drift fitted to motion on both sides of it would be far off.
            if not self.is_fresh:
                memory.leapt_s += dt_s
            if not memory.tared:
                self._clear_recorder()
        self._torques.append(tau)
        if len(self._torques) >= MOST_TORQUES:  # a clock of nanoseconds
            self._sum_torques()
        if memory.now_s < memory.due_s - ROUNDING_S:
            return False
        self._renew()
        return True

    def _renew(self) -> None:
        """Renew what changes slowly: hysteresis, friction and the offset."""
        memory = self.memory
        dt_s = memory.now_s - memory.renewed_s
        self._sum_torques()
        torque = memory.torque_sum / memory.summed
        memory.torque_sum, memory.summed = np.zeros(self._joints), 0
        memory.renewed_s, memory.due_s = memory.now_s, memory.now_s + self.RENEW_S
        self._states.follow(memory.q, torque, dt_s)
        memory.states, memory.joint_memory = self._states.rows, self._states.memory
        memory.bias = self._tare.bias_Nm(memory.q, memory.states, self._age_s)

    def _sum_torques(self) -> None:
        """Keep the sum of the torques only."""
        memory = self.memory
        memory.torque_sum = np.add.reduce([memory.torque_sum, *self._torques])
        memory.summed += len(self._torques)
        self._torques.clear()

    def record(self, residual: Array, dt_s: float) -> None:
        """Record one settled residual [Nm] of free motion; ignored once tared."""
        memory = self.memory
        if not memory.tared:
            recorder = memory.recorder
            recorder.add(memory.q, memory.states, residual, dt_s)
            if recorder.age_s >= self._block_s - ROUNDING_S:
                recorder.close_block(memory.now_s)

    def _clear_recorder(self) -> None:
        self.memory.recorder = TareRecorder.of_size(self._joints, self._basis.states)

    def covariance_Nm2(self) -> Array:
        """Covariance of the corrected residual here and now [Nm^2], shape (n, n)."""
        return self._tare.covariance_Nm2(self.memory.q, self.memory.states, self._age_s)

    @property
    def _age_s(self) -> float:
        return self.memory.now_s - self.memory.tared_s

    def tare(
        self, wrench: WrenchEstimator, *, ignore_contact: bool, is_external: bool = False
    ) -> Tare:
        """Fit the offset to what was recorded; arguments as of `check_free_of_contact`.

        Raises:
            TareError: Without new data, or with contact in sight; the tare in force then stays.
        """
        memory = self.memory
        if memory.tared:
            raise TareError(
                "already tared, and nothing was recorded since; call "
                "start_tare_recording(), move in free air, then tare() again"
            )
        if not memory.recorder.samples:
            nothing = (
                f"no settled free motion has been recorded (less than {self._block_s:g} s of it); "
                "update() the sensor without contact first, in steps no longer than max_gap_s, "
                "then tare()"
            )
            raise TareError("; ".join(filter(None, (nothing, self.warning))))
        blocks = memory.recorder.blocks(memory.now_s, self._config.tare_window_s)
        fit = FreeMotionFit(self._basis, blocks)
        if not ignore_contact:
            check_free_of_contact(
                fit, wrench, self._config.contact_force_N, is_external=is_external
            )
        fitted = self._tare = fit.tare
        numbers = (getattr(fitted, name) for name in TareNumbers._fields)
        memory.tare = TareNumbers(*numbers)
        memory.tared, memory.tared_s, memory.leapt_s = True, memory.now_s, 0.0
        memory.bias = fitted.bias_Nm(memory.q, memory.states, 0.0)
        return fitted

    def start_tare_recording(self) -> None:
        """Forget what was recorded and record anew; the tare in force stays until the next."""
        self._clear_recorder()
        self.memory.tared, self.memory.leapt_s = False, 0.0

    @property
    def state(self) -> BiasState:
        """All that is remembered, as copies."""
        self._sum_torques()
        return copied(self.memory)

    def restore(self, state: BiasState) -> None:
        """Go on from a `state` taken earlier with the same robot and settings."""
        memory = self.memory = copied(state)
        self._torques: list[Array] = []
        self._tare = prior_tare(self._basis)
        self._states = JointStates(self._basis)
        self._states.memory, self._states.rows = memory.joint_memory, memory.states
        if memory.tare is not None:
            self._tare = Tare(basis=self._basis, **memory.tare._asdict())

    def reset(self) -> None:
        """Forget everything."""
        still = np.zeros(self._joints)
        self.restore(
            BiasState(
                recorder=TareRecorder.of_size(self._joints, self._basis.states),
                states=np.zeros((self._basis.states, self._joints)),
                torque_sum=still,
                bias=still,
                q=still,
            )
        )
