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

from foundation.arrays import Matrix, Vector, WrittenMatrix
from foundation.jit import compiled
from residual.checks.input import (
    ROUNDING_S,
    check_choice,
    check_interval,
    check_positive,
    check_rows,
    read_rows,
)
from residual.errors import Array
from residual.momentum_observer import Alignment

ROWS = 4  # Rows of a step: outputs of the first and second lag, input at start and end
_NAMES = ("q", "tau")


def lag_pair_coefficients(bandwidth_per_s: float, dt_s: float) -> Array:
    """Factors of the exact step of two equal first-order lags in a row, shape (3,
    ROWS).

    Times the rows they give both outputs at the end of the tick, and the rate of the
    second one. The input runs straight over the tick; a held one is the case of equal
    ends.
    """
    tick = bandwidth_per_s * dt_s
    decay = math.exp(-tick)
    gained = -math.expm1(-tick)
    per_tick = 1.0 / tick
    start = gained * per_tick - decay
    first = np.array([decay, 0.0, start, 1.0 - gained * per_tick])
    end = 1.0 + decay - 2.0 * gained * per_tick
    second = np.array([decay * tick, decay, 2.0 * start - tick * decay, end])
    return np.stack((first, second, bandwidth_per_s * (first - second)))


@compiled
def lag_pair_step(
    rows: WrittenMatrix, factors: Matrix, given: Vector, held: bool
) -> Array:
    """Bring the rows up to date; position, its rate and torque behind both lags,
    shape (3, n).
    """
    n = len(given) // 2
    rows[3, :n] = given[:n]
    rows[3, n:] = rows[2, n:] if held else given[n:]
    out = factors.dot(rows)
    found = np.empty((3, n))
    rows[:2] = out[:2]
    rows[2] = given
    found[0] = out[1, :n]
    found[1] = out[2, :n]
    found[2] = out[1, n:]
    return found


class MatchedSample(NamedTuple):
    """One consistent, delayed sample; arrays (n,).

    Attributes:
        q: Filtered position [rad].
        dq: Its exact derivative [rad/s].
        tau: Torque through the same filter [Nm].
    """

    q: Array
    dq: Array
    tau: Array
    settled: (
        bool  # Whether the start of the filter has faded; before that dq is not usable
    )


@dataclass(slots=True, eq=False)
class VelocityState:
    """All that a `VelocityEstimator` remembers.

    Attributes:
        rows: Of the last step, position then torque, shape (ROWS, 2 n).
        started: Whether there was one.
        age_s: Time since the filter started [s].
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
        memory: All that it remembers; one of the same settings and joints may stand in
            its place.

    Raises:
        ConfigurationError: For a setting that cannot work.
    """

    SETTLING_LAGS = 10.0  # Lags after which the start has faded to 5e-4 of itself

    def __init__(
        self,
        joints: int,
        bandwidth_per_s: float = 200.0,
        *,
        alignment: Alignment = "trapezoid",
        max_gap_s: float = 0.1,
    ) -> None:
        # Its cube is calculated with.
        check_positive("bandwidth_per_s", bandwidth_per_s, least=1e-3, most=1e6)
        check_positive("joints", joints)
        check_choice("alignment", alignment, get_args(Alignment))
        check_positive("max_gap_s", max_gap_s)
        self._joints = int(joints)
        self._bandwidth = float(bandwidth_per_s)
        self._held = alignment == "hold"
        self._max_gap_s = max_gap_s
        self._settling_s = self.SETTLING_LAGS / bandwidth_per_s
        self._dt_s = math.nan
        self.memory = VelocityState(np.zeros((ROWS, 2 * self._joints)))

    @property
    def delay_s(self) -> float:
        """Common delay of position, velocity and torque [s]."""
        return 2.0 / self._bandwidth

    def noise_per_position_noise(self, dt_s: float) -> float:
        """Velocity noise [rad/s] per rad of white position noise at a sample period
        [s].
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
        found, settled = self.step(rows, dt_s)
        return MatchedSample(found[0], found[1], found[2], settled)

    def step(self, sample: Array, dt_s: float) -> tuple[Array, bool]:
        """As `update`, for finite numbers and a checked time step.

        The sample is position and torque, shape (2, n), contiguous; what a
        `MatchedSample` holds is returned, its arrays as one, shape (3, n).
        """
        memory = self.memory
        rows = self.memory.rows
        given = sample.ravel()
        if not memory.started or dt_s > self._max_gap_s:
            rows[:] = given
            memory.age_s = 0.0
            memory.started = True
            return np.stack((sample[0], np.zeros(self._joints), sample[1])), False
        if dt_s != self._dt_s:  # on an even clock that is once
            self._coefficients = lag_pair_coefficients(self._bandwidth, dt_s)
            self._dt_s = dt_s
        found = lag_pair_step(rows, self._coefficients, given, self._held)
        memory.age_s += dt_s
        return found, memory.age_s >= self._settling_s - ROUNDING_S

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.memory.started = False
