"""Joint velocity when the robot sends none, with torque delayed to match.

Position and torque pass the same two lags F(s) = (w / (s + w))^2. The filtered position
has an exact derivative, w (x1 - x2), so M, C and g are evaluated on one consistent,
delayed motion, and the torque is delayed by exactly as much: motion does not read as
force. The common delay is 2/w.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array, Matrix, Vector, WrittenMatrix
from foundation.jit import compile_waiting, compiled
from foundation.linear_algebra import dot
from residual.checks.input import (
    ROUNDING_S,
    check_choice,
    check_interval,
    check_positive,
    check_rows,
    read_rows,
)
from residual.momentum_observer import Alignment

_NAMES = ("q", "tau")

# The filter's output after a tick is linear in four numbers of each signal, the columns
# of a step.

FIRST_LAG = 0
"""Column of the output of the first lag."""

SECOND_LAG = 1
"""Column of the output of the second lag."""

INPUT_BEFORE = 2
"""Column of the input at the start of the tick."""

INPUT = 3
"""Column of the input at its end."""

COLUMNS = 4
"""Number of columns."""


@compiled
def lag_pair_coefficients(bandwidth_per_s: float, dt_s: float) -> Array:
    """Return the factors of the exact step of two equal lags in a row, (3, COLUMNS).

    Times the columns they give both outputs at the end of the tick, and the rate of the
    second one. The input runs straight over the tick; a held one is the case of equal
    ends.
    """
    tick = bandwidth_per_s * dt_s
    decay = math.exp(-tick)
    gained = -math.expm1(-tick)
    per_tick = 1.0 / tick
    from_start = gained * per_tick - decay
    from_end = 1.0 + decay - 2.0 * gained * per_tick
    factors = np.zeros((3, COLUMNS))
    factors[0] = np.array([decay, 0.0, from_start, 1.0 - gained * per_tick])
    factors[1] = np.array(
        [decay * tick, decay, 2.0 * from_start - tick * decay, from_end]
    )
    factors[2] = bandwidth_per_s * (factors[0] - factors[1])
    return factors


@compiled
def lag_pair_step(
    rows: WrittenMatrix, factors: Matrix, signals: Vector, is_held: bool
) -> Array:
    """Bring the numbers of position and torque to the end of a tick.

    Args:
        rows: See `FIRST_LAG` and the others, shape (2 n, 4).
        factors: See `lag_pair_coefficients`.
        signals: Position [rad], then torque [Nm] of this tick, shape (2 n,).
        is_held: Whether torque is held over the tick, see `Alignment`.

    Returns:
        Position behind both lags, its rate, and torque behind both lags, shape (3, n).
    """
    n = len(signals) // 2
    matched = np.zeros((3, n))
    for j in range(2 * n):
        is_torque = j >= n
        row = rows[j]
        row[INPUT] = row[INPUT_BEFORE] if is_torque and is_held else signals[j]
        first = dot(factors[0], row)
        second = dot(factors[1], row)
        rate = dot(factors[2], row)
        row[FIRST_LAG] = first
        row[SECOND_LAG] = second
        row[INPUT_BEFORE] = signals[j]
        if is_torque:
            matched[2, j - n] = second
        else:
            matched[0, j] = second
            matched[1, j] = rate
    return matched


class MatchedSample(NamedTuple):
    """One consistent, delayed sample; arrays (n,).

    Attributes:
        q: Filtered position [rad].
        dq: Its exact derivative [rad/s].
        tau: Torque through the same filter [Nm].
        settled: Whether the start of the filter has faded; before that dq is not
            usable.
    """

    q: Array
    dq: Array
    tau: Array
    settled: bool


@dataclass(slots=True, eq=False)
class VelocityState:
    """State of a `VelocityEstimator`.

    Attributes:
        rows: Columns of the last step; a row per position, then per torque, shape
            (2 n, COLUMNS).
        started: Whether there was a sample.
        age_s: Time since the filter started.
    """

    rows: Array
    started: bool = False
    age_s: float = 0.0


class VelocityEstimator:
    """Causal velocity from position, with torque through the same filter.

    Args:
        joints: Number of joints.
        bandwidth_per_s: w of the two lags [1/s], 1e6 at most; the common delay is 2/w,
            the velocity noise from white position noise s at period dt is ``s sqrt(dt
            w^3 / 4)``.
        alignment: How torque fills a tick, see `residual.momentum_observer.Alignment`.
            The filtered torque is continuous: feed the observer with ``trapezoid``.
        max_gap_s: A longer time step starts the filter anew [s].

    Attributes:
        memory: Its state; one of the same settings and joints may replace it.

    Raises:
        ConfigurationError: For a setting that cannot work.
    """

    SETTLING_LAGS = 10.0
    """Lags after which the start has faded to 5e-4 of itself."""

    MIN_BANDWIDTH_PER_S = 1e-3
    """Smallest bandwidth: its cube is calculated with."""

    MAX_BANDWIDTH_PER_S = 1e6
    """Largest bandwidth: its cube is calculated with."""

    def __init__(
        self,
        joints: int,
        bandwidth_per_s: float = 200.0,
        *,
        alignment: Alignment = "trapezoid",
        max_gap_s: float = 0.1,
    ) -> None:
        compile_waiting()
        check_positive(
            "bandwidth_per_s",
            bandwidth_per_s,
            minimum=self.MIN_BANDWIDTH_PER_S,
            maximum=self.MAX_BANDWIDTH_PER_S,
        )
        check_positive("joints", joints)
        check_choice("alignment", alignment, get_args(Alignment))
        check_positive("max_gap_s", max_gap_s)
        self._joints = int(joints)
        self._bandwidth = float(bandwidth_per_s)
        self._is_held = alignment == "hold"
        self._max_gap_s = max_gap_s
        self._settling_s = self.SETTLING_LAGS / bandwidth_per_s
        self._dt_s = math.nan
        self.memory = VelocityState(np.zeros((2 * self._joints, COLUMNS)))

    @property
    def delay_s(self) -> float:
        """Common delay of position, velocity and torque [s]."""
        return 2.0 / self._bandwidth

    def noise_per_position_noise(self, dt_s: float) -> float:
        """Return the velocity noise [rad/s] per rad of white position noise.

        The samples come at a period ``dt_s``.
        """
        return math.sqrt(dt_s * self._bandwidth**3 / 4.0)

    def update(self, q: ArrayLike, tau: ArrayLike, dt_s: float) -> MatchedSample:
        """Take one sample of position [rad] and torque [Nm], each (n,).

        Raises:
            SampleError: For a bad sample; the state is then unchanged.
        """
        rows = read_rows(_NAMES, (q, tau), self._joints)
        check_rows(_NAMES, rows)
        dt_s = check_interval(dt_s) if self.memory.started else 0.0
        matched, is_settled = self.step(rows, dt_s)
        return MatchedSample(
            q=matched[0], dq=matched[1], tau=matched[2], settled=is_settled
        )

    def step(self, sample: Array, dt_s: float) -> tuple[Array, bool]:
        """Take position and torque as one array, shape (2, n), of finite numbers.

        Like `update`, with a checked time step and a contiguous array.

        Returns:
            The arrays of a `MatchedSample` as one, shape (3, n), and whether it is
            settled.
        """
        memory = self.memory
        signals = sample.ravel()
        if not memory.started or dt_s > self._max_gap_s:
            memory.rows[:] = signals[:, None]
            memory.age_s = 0.0
            memory.started = True
            return np.stack((sample[0], np.zeros(self._joints), sample[1])), False
        if dt_s != self._dt_s:  # on an even clock that is once
            self._coefficients = lag_pair_coefficients(self._bandwidth, dt_s)
            self._dt_s = dt_s
        matched = lag_pair_step(memory.rows, self._coefficients, signals, self._is_held)
        memory.age_s += dt_s
        return matched, memory.age_s >= self._settling_s - ROUNDING_S

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.memory.started = False
