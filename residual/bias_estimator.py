"""Keeps the tare: records free motion, fits, subtracts, and says how far it may be trusted."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.bias_fit import check_free_of_contact, fit_tare
from residual.bias_model import BiasModel, Tare, TareBlocks, prior_tare
from residual.config import SensorConfig
from residual.errors import TareError
from residual.estimate import FORGOTTEN, TARE_EXPIRED
from residual.input_validation import ROUNDING_S
from residual.snapshot import copied
from residual.wrench_estimator import WrenchEstimator
from urdf import Robot

Array = NDArray[np.float64]
SMOOTHING_S = 0.15
"""Lag of the torque whose hysteresis is followed [s]: its noise is then well below the loop's
width."""
MOST_TORQUES = 1000
"""As many samples are kept between two renewals at most; then their sum is."""
MOST_BLOCKS = 400
"""When there are as many, the older half is merged in pairs: a fit takes a fraction of a second."""


def play_operator(state: Array, change: Array, half_width: Array) -> Array:
    """+1 once a signal has risen by the loop's width, -1 once it has fallen by it.

    It remembers at rest, as strain gauges do: friction of a joint would depend on its velocity,
    the hysteresis of its torque sensor depends on the torque.

    Args:
        state: Before the change, -1 to 1, shape (loops, n).
        change: Of the signal, shape (n,).
        half_width: Half of each loop's width, in the signal's unit, shape (loops, n).

    Returns:
        State after the change, -1 to 1, shape (loops, n).
    """
    return np.minimum(np.maximum(state + change / half_width, -1.0), 1.0)


@dataclass(slots=True, eq=False)
class RecorderState:
    """All that a `TareRecorder` remembers."""

    means: Array  # Of every block: position, residual, hysteresis; shape (m, 2 + loops, n)
    time_s: Array  # Middle of every block [s], shape (m,)
    scatter: Array  # Variance within every block [Nm^2], shape (m, n)
    samples: tuple[int, ...]  # Number of samples of every block, shape (m,)
    sums: Array  # Of the open block, shape (2 + loops, n)
    squares: Array  # Of its residuals [Nm^2], shape (n,)
    summed: int = 0  # Number of its samples
    age_s: float = 0.0  # Its length so far [s]


class TareRecorder:
    """Means of residual, position and hysteresis state over short blocks of free motion.

    Memory is bounded: once there are `MOST_BLOCKS`, pairs of neighbours in the older half become
    one; the latest blocks stay short.

    Args:
        joints: Number of joints.
        loops: Number of hysteresis loops.
        block_s: Length of a block [s]; longer than the observer's lag, so that blocks are nearly
            independent.
    """

    def __init__(self, joints: int, loops: int, block_s: float) -> None:
        self._shape = (2 + loops, joints)
        self._block_s = block_s
        self.clear()

    def clear(self) -> None:
        """Forget all blocks."""
        shape, n = self._shape, self._shape[1]
        self._memory = RecorderState(
            means=np.zeros((0, *shape)),
            time_s=np.zeros(0),
            scatter=np.zeros((0, n)),
            samples=(),
            sums=np.zeros(shape),
            squares=np.zeros(n),
        )

    @property
    def is_empty(self) -> bool:
        """Whether nothing has been recorded since `clear`."""
        return not (self._memory.samples or self._memory.summed)

    def add(self, q: Array, loops: Array, residual: Array, time_s: float, dt_s: float) -> None:
        """Add one sample.

        Args:
            q: Position [rad], shape (n,).
            loops: Hysteresis state of the torques, shape (loops, n).
            residual: Before offset removal [Nm], shape (n,).
            time_s: Its time [s].
            dt_s: Time since the sample before [s].
        """
        memory = self._memory
        memory.sums[0] += q
        memory.sums[1] += residual
        memory.sums[2:] += loops
        memory.squares += residual * residual
        memory.summed += 1
        memory.age_s += dt_s
        if memory.age_s >= self._block_s - ROUNDING_S:
            self._close_block(time_s - 0.5 * memory.age_s)

    def _close_block(self, middle_s: float) -> None:
        memory = self._memory
        means = memory.sums / memory.summed
        scatter = np.maximum(memory.squares / memory.summed - means[1] ** 2, 0.0)
        memory.means = np.concatenate((memory.means, means[None]))
        memory.time_s = np.append(memory.time_s, middle_s)
        memory.scatter = np.concatenate((memory.scatter, scatter[None]))
        memory.samples = (*memory.samples, memory.summed)
        memory.sums, memory.squares = np.zeros_like(memory.sums), np.zeros_like(memory.squares)
        memory.summed, memory.age_s = 0, 0.0
        if len(memory.samples) >= MOST_BLOCKS:
            self._merge_older()

    def _merge_older(self) -> None:
        memory, half = self._memory, MOST_BLOCKS // 2
        first, second = slice(0, half, 2), slice(1, half, 2)
        counts = np.array(memory.samples[:half])
        count = counts[::2] + counts[1::2]
        a, b = counts[::2] / count, counts[1::2] / count
        means, scatter, time_s = memory.means, memory.scatter, memory.time_s
        between = (a * b)[:, None] * (means[first, 1] - means[second, 1]) ** 2
        merged = a[:, None, None] * means[first] + b[:, None, None] * means[second]
        spread = a[:, None] * scatter[first] + b[:, None] * scatter[second] + between
        memory.means = np.concatenate((merged, means[half:]))
        memory.scatter = np.concatenate((spread, scatter[half:]))
        memory.time_s = np.append(a * time_s[first] + b * time_s[second], time_s[half:])
        memory.samples = (*count.tolist(), *memory.samples[half:])

    def blocks(self, now_s: float, window_s: float | None = None) -> TareBlocks:
        """What was recorded, or the last ``window_s`` of it [s]; at least one block.

        Raises:
            TareError: If there is not a single block.
        """
        memory = self._memory
        if not memory.samples:
            raise TareError(
                f"no settled free motion has been recorded (less than {self._block_s:g} s of it); "
                "update() the sensor without contact first, in steps no longer than max_gap_s, "
                "then tare()"
            )
        kept = np.ones(len(memory.samples), dtype=bool)
        if window_s is not None:
            kept = now_s - memory.time_s <= window_s
            kept[-1] = True
        means = memory.means[kept]
        return TareBlocks(
            q_rad=means[:, 0],
            hysteresis=means[:, 2:],
            residual_Nm=means[:, 1],
            age_s=memory.time_s[kept] - now_s,
            # The median, so that a knock in one block does not pass for noise in all.
            scatter_Nm2=np.median(memory.scatter[kept], axis=0),
        )

    @property
    def state(self) -> RecorderState:
        """All that is remembered, as copies."""
        return copied(self._memory)

    def restore(self, state: RecorderState) -> None:
        """Go on from a `state` taken earlier."""
        self._memory = copied(state)


class TareNumbers(NamedTuple):
    """A fitted `Tare` without its basis, which robot and settings give; see there."""

    mean: Array
    covariance: Array
    noise_Nm2: Array


@dataclass(slots=True, kw_only=True, eq=False)
class BiasState:
    """All that a `BiasEstimator` remembers."""

    recorder: RecorderState  # Free motion recorded for the next tare
    hysteresis: Array  # State of the torques' loops, shape (loops, n)
    torque_sum: Array  # Of the torques since the last renewal [Nm], shape (n,)
    bias: Array  # Offset that is subtracted [Nm], shape (n,)
    q: Array  # Last position [rad], shape (n,)
    tare: TareNumbers | None = None  # The tare in force; None before the first
    tared: bool = False  # Whether it is the current one
    tared_s: float = 0.0  # When it was taken [s]
    now_s: float = 0.0  # Time since the start [s]
    renewed_s: float = 0.0  # When hysteresis and offset were renewed last [s]
    due_s: float = 0.0  # When they are renewed next [s]
    # Torque whose hysteresis is followed [Nm], shape (n,); None before the first
    smooth_torque: Array | None = None
    summed: int = 0  # Number of torques in the sum
    # Time in steps longer than `BiasEstimator.LEAP_S` since the tare, or since free motion is
    # recorded [s]
    leapt_s: float = 0.0


class BiasEstimator:
    """Subtracts the residual's error without contact from the observer's output.

    Until the first `tare` the prior stands in: no offset, a large covariance.

    Args:
        robot: The arm with its payload.
        config: Settings of the sensor.

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
        self._recorder = TareRecorder(
            robot.nv, self._basis.loops, self.BLOCK_LAGS / config.slowest_gain_per_s
        )
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
        return not self.memory.tared and self._recorder.is_empty

    def follow(self, q: Array, tau: Array, dt_s: float) -> bool:
        """Follow position [rad], torque [Nm], both kept, not copied, and time since the last [s].

        Returns:
            Whether hysteresis and offset have been renewed; the covariance may then be read anew.
        """
        memory = self.memory
        memory.q = q
        memory.now_s += dt_s
        if dt_s > self.LEAP_S:
            # A drift fitted to motion on both sides of it would be far off.
            if not self.is_fresh:
                memory.leapt_s += dt_s
            if not memory.tared:
                self._recorder.clear()
        self._torques.append(tau)
        if len(self._torques) >= MOST_TORQUES:  # a clock of nanoseconds
            self._sum_torques()
        if memory.now_s < memory.due_s - ROUNDING_S:
            return False
        self._renew()
        return True

    def _renew(self) -> None:
        """Renew what changes slowly: the state of the torques' hysteresis and the offset."""
        memory = self.memory
        dt_s = memory.now_s - memory.renewed_s
        self._sum_torques()
        torque = memory.torque_sum / memory.summed
        memory.torque_sum, memory.summed = np.zeros(self._joints), 0
        memory.renewed_s, memory.due_s = memory.now_s, memory.now_s + self.RENEW_S
        if memory.smooth_torque is None:
            memory.smooth_torque = torque
        change = (torque - memory.smooth_torque) * (dt_s / (SMOOTHING_S + dt_s))
        memory.smooth_torque = memory.smooth_torque + change
        half_width = self._basis.half_width_Nm
        memory.hysteresis = play_operator(memory.hysteresis, change, half_width)
        memory.bias = self._tare.bias_Nm(memory.q, memory.hysteresis, self._age_s)

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
            self._recorder.add(memory.q, memory.hysteresis, residual, memory.now_s, dt_s)

    def covariance_Nm2(self) -> Array:
        """Covariance of the corrected residual here and now [Nm^2], shape (n, n)."""
        return self._tare.covariance_Nm2(self.memory.q, self.memory.hysteresis, self._age_s)

    @property
    def _age_s(self) -> float:
        return self.memory.now_s - self.memory.tared_s

    def tare(
        self, wrench: WrenchEstimator, *, ignore_contact: bool, is_external: bool = False
    ) -> Tare:
        """Fit the offset to what was recorded.

        Args:
            wrench: Reads axial force, to look for contact.
            ignore_contact: Take it even where contact is seen, or torques that cannot be.
            is_external: Whether the residual is an estimate that the robot sends itself.

        Raises:
            TareError: Without new data, or with contact in sight; the tare in force then stays.
        """
        memory = self.memory
        if memory.tared:
            raise TareError(
                "already tared, and nothing was recorded since; call "
                "start_tare_recording(), move in free air, then tare() again"
            )
        try:
            blocks = self._recorder.blocks(memory.now_s, self._config.tare_window_s)
        except TareError as error:
            raise TareError("; ".join(filter(None, (str(error), self.warning)))) from None
        if not ignore_contact:
            contact_N = self._config.contact_force_N
            prior = prior_tare(self._basis)
            check_free_of_contact(prior, blocks, wrench, contact_N, is_external=is_external)
        fitted = self._tare = fit_tare(self._basis, blocks)
        memory.tare = TareNumbers(fitted.mean, fitted.covariance, fitted.noise_Nm2)
        memory.tared, memory.tared_s, memory.leapt_s = True, memory.now_s, 0.0
        memory.bias = fitted.bias_Nm(memory.q, memory.hysteresis, 0.0)
        return fitted

    def start_tare_recording(self) -> None:
        """Forget what was recorded and record anew; the tare in force stays until the next."""
        self._recorder.clear()
        self.memory.tared, self.memory.leapt_s = False, 0.0

    @property
    def state(self) -> BiasState:
        """All that is remembered, as copies."""
        self._sum_torques()
        self.memory.recorder = self._recorder.state
        return copied(self.memory)

    def restore(self, state: BiasState) -> None:
        """Go on from a `state` taken earlier with the same robot and settings."""
        memory = self.memory = copied(state)
        self._torques: list[Array] = []
        self._recorder.restore(memory.recorder)
        self._tare = prior_tare(self._basis)
        if memory.tare is not None:
            self._tare = Tare(basis=self._basis, **memory.tare._asdict())

    def reset(self) -> None:
        """Forget everything."""
        self._recorder.clear()
        still = np.zeros(self._joints)
        self.restore(
            BiasState(
                recorder=self._recorder.state,
                hysteresis=np.zeros_like(self._basis.half_width_Nm),
                torque_sum=still,
                bias=still,
                q=still,
            )
        )
