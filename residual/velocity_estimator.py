"""Joint velocity when the robot sends none, with torque delayed to match.

Position and torque pass the same two lags F(s) = (w / (s + w))^2. The filtered position has an
exact derivative, w (x1 - x2), so M, C and g are evaluated on one consistent, delayed motion, and
the torque is delayed by exactly as much: motion does not read as force. The common delay is 2/w.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.errors import ConfigurationError
from residual.input_validation import (
    ROUNDING_S,
    check_choice,
    check_interval,
    check_positive,
    check_rows,
    read_rows,
)
from residual.momentum_observer import ALIGNMENTS, Alignment

Array = NDArray[np.float64]
ROWS = 4
"""Rows of a step: output of the first lag, of the second, input at the start and at the end."""
REMEMBERED = 3
"""So many of them are known before the tick."""
_NAMES = ("q", "tau")


def lag_pair_coefficients(bandwidth_per_s: float, dt_s: float) -> Array:
    """Factors of the exact step of two equal first-order lags in a row.

    The input runs straight over the tick; a held one is the case of equal ends.

    Args:
        bandwidth_per_s: w of each lag [1/s].
        dt_s: Length of the tick [s].

    Returns:
        Shape (3, ROWS): times the rows, both outputs at the end of the tick, and the rate of the
        second one.
    """
    tick = bandwidth_per_s * dt_s
    decay, gained, per_tick = math.exp(-tick), -math.expm1(-tick), 1.0 / tick
    first = np.array([decay, 0.0, gained * per_tick - decay, 1.0 - gained * per_tick])
    second = np.array(
        [
            decay * tick,
            decay,
            2.0 * (gained * per_tick - decay) - tick * decay,
            1.0 + decay - 2.0 * gained * per_tick,
        ]
    )
    return np.stack((first, second, bandwidth_per_s * (first - second)))


class MatchedSample(NamedTuple):
    """One consistent, delayed sample.

    Attributes:
        q: Filtered position [rad], shape (n,).
        dq: Its exact derivative [rad/s], shape (n,).
        tau: Torque through the same filter [Nm], shape (n,).
        settled: Whether the start of the filter has faded; before that ``dq`` is not usable.
    """

    q: Array
    dq: Array
    tau: Array
    settled: bool


class VelocityState(NamedTuple):
    """All that a `VelocityEstimator` remembers.

    Attributes:
        rows: Output of both lags and the last sample, position then torque, shape (3, 2 n); None
            before a sample.
        age_s: Time since the filter started [s].
    """

    rows: Array | None
    age_s: float = 0.0


class VelocityEstimator:
    """Causal velocity from position, with torque through the same filter.

    Args:
        joints: Number of joints.
        bandwidth_per_s: w of the two lags [1/s], 1e6 at most; the common delay is 2/w, the
            velocity noise from white position noise s at period dt is ``s sqrt(dt w^3 / 4)``.
        alignment: How torque fills a tick, see `residual.momentum_observer.Alignment`. The filtered
            torque is continuous: feed the observer with ``trapezoid``.
        max_gap_s: A longer time step starts the filter anew [s].

    Raises:
        ConfigurationError: For a setting that cannot work.
    """

    SETTLING_LAGS = 10.0
    """Lags after which the start has faded to 5e-4 of itself."""

    def __init__(
        self,
        joints: int,
        bandwidth_per_s: float = 200.0,
        *,
        alignment: Alignment = "trapezoid",
        max_gap_s: float = 0.1,
    ) -> None:
        check_bandwidth("bandwidth_per_s", bandwidth_per_s)
        check_positive("joints", joints)
        check_choice("alignment", alignment, ALIGNMENTS)
        check_positive("max_gap_s", max_gap_s)
        self._joints = int(joints)
        self._bandwidth = float(bandwidth_per_s)
        self._held = alignment == "hold"
        self._max_gap_s = max_gap_s
        self._settling_s = self.SETTLING_LAGS / bandwidth_per_s
        self._rows = np.zeros((ROWS, 2 * self._joints))
        self._dt_s = math.nan
        self.reset()

    @property
    def delay_s(self) -> float:
        """Common delay of position, velocity and torque [s]."""
        return 2.0 / self._bandwidth

    def noise_per_position_noise(self, dt_s: float) -> float:
        """Velocity noise [rad/s] per rad of white position noise at a sample period [s]."""
        return math.sqrt(dt_s * self._bandwidth**3 / 4.0)

    def update(self, q: ArrayLike, tau: ArrayLike, dt_s: float) -> MatchedSample:
        """Take one sample of position [rad] and torque [Nm], each (n,).

        Raises:
            SampleError: For a bad sample; the state is then unchanged.
        """
        rows = read_rows(_NAMES, (q, tau), self._joints)
        check_rows(_NAMES, rows)
        dt_s = check_interval(dt_s) if self._initialized else 0.0
        return MatchedSample(*self.absorb(rows, dt_s))

    def absorb(self, sample: Array, dt_s: float) -> tuple[Array, Array, Array, bool]:
        """As `update`, for finite numbers and a checked time step.

        Args:
            sample: Position and torque, shape (2, n), contiguous.
            dt_s: Time since the previous sample [s].

        Returns:
            The fields of a `MatchedSample`.
        """
        n, rows, given = self._joints, self._rows, sample.ravel()
        if not self._initialized or (dt_s != self._dt_s and self._is_gap(dt_s)):
            rows[:] = given
            self._age_s = 0.0
            self._initialized = True
            return sample[0].copy(), np.zeros(n), sample[1].copy(), False
        rows[3] = given
        if self._held:
            rows[3, n:] = rows[2, n:]
        out = self._coefficients.dot(rows)
        rows[:2] = out[:2]
        rows[2] = given
        self._age_s += dt_s
        settled = self._age_s >= self._settling_s - ROUNDING_S
        second = out[1]
        return second[:n], out[2, :n], second[n:], settled

    def _is_gap(self, dt_s: float) -> bool:
        """Whether a new time step is too long; renews the coefficients if it is not."""
        if dt_s > self._max_gap_s:
            return True
        self._coefficients = lag_pair_coefficients(self._bandwidth, dt_s)
        self._dt_s = dt_s
        return False

    @property
    def state(self) -> VelocityState:
        """All that the estimator remembers, as copies."""
        rows = self._rows[:REMEMBERED].copy() if self._initialized else None
        return VelocityState(rows, self._age_s)

    def restore(self, state: VelocityState) -> None:
        """Go on from a `state` taken earlier.

        Raises:
            ConfigurationError: If it belongs to another number of joints.
        """
        if state.rows is not None:
            expected = (REMEMBERED, 2 * self._joints)
            if state.rows.shape != expected:
                raise ConfigurationError(
                    f"state has rows of shape {state.rows.shape}, expected {expected}"
                )
            self._rows[:REMEMBERED] = state.rows
        self._initialized = state.rows is not None
        self._age_s = state.age_s

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.restore(VelocityState(None))


def check_bandwidth(name: str, value: object) -> None:
    """Refuse a bandwidth [1/s] that no sampled signal has: its square or cube would overflow.

    Raises:
        ConfigurationError: With the name and what came.
    """
    check_positive(name, value, most=1e6, least=1e-3)
