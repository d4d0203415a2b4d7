"""Joint velocity when the robot sends none, with torque delayed to match."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.jit import COMPILER, Matrix, Vector, WrittenMatrix, compiled
from residual.errors import ConfigurationError
from residual.input_validation import (
    ROUNDING_S,
    check_alignment,
    check_gap,
    check_interval,
    check_positive,
    check_rows,
    read_rows,
)
from residual.momentum_observer import Alignment

# Velocity from position by a matched filter, one step (pure function).
#
# Position and torque pass the same two lags F(s) = (w / (s + w))^2. The filtered position has an
# exact derivative, w (x1 - x2), so M, C and g are evaluated on one consistent, delayed motion, and
# the torque is delayed by exactly as much: motion does not read as force. The common delay is 2/w.


ROWS = 4
"""Rows of a step: output of the first lag, of the second, input at the start and at the end."""


def lag_pair_coefficients(bandwidth_per_s: float, dt_s: float) -> NDArray[np.float64]:
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
    decay, share, per_tick = math.exp(-tick), -math.expm1(-tick), 1.0 / tick
    first = np.array([decay, 0.0, share * per_tick - decay, 1.0 - share * per_tick])
    second = np.array(
        [
            decay * tick,
            decay,
            2.0 * (share * per_tick - decay) - tick * decay,
            1.0 + decay - 2.0 * share * per_tick,
        ]
    )
    return np.stack((first, second, bandwidth_per_s * (first - second)))


def lag_pair_step(
    rows: NDArray[np.float64],
    q: NDArray[np.float64],
    tau: NDArray[np.float64],
    coefficients: NDArray[np.float64],
    held: bool,
) -> NDArray[np.float64]:
    """One step of both lags for position and torque.

    Args:
        rows: Output of both lags and the sample before, position then torque; brought up to date;
            shape (ROWS, 2 n), the last row to write in.
        q: Position at the end of the tick [rad], shape (n,).
        tau: Torque there [Nm], shape (n,).
        coefficients: See `lag_pair_coefficients`.
        held: Whether the torque of the sample before acts through the tick.

    Returns:
        Both outputs and the rate of the second one, shape (3, 2 n).
    """
    if COMPILER:
        out = np.empty((3, rows.shape[1]))
        lag_pair_loops(rows, q, tau, coefficients, held, out)
        return out
    n, earlier, now = len(q), rows[2], rows[3]
    now[:n], now[n:] = q, earlier[n:] if held else tau
    out = coefficients.dot(rows)
    rows[:2] = out[:2]
    earlier[:n], earlier[n:] = q, tau
    return out


@compiled
def lag_pair_loops(
    rows: WrittenMatrix,
    q: Vector,
    tau: Vector,
    coefficients: Matrix,
    held: bool,
    out: WrittenMatrix,
) -> None:
    """`lag_pair_step` in loops, as a compiler likes it and Python does not."""
    n = q.size
    for i in range(2 * n):
        given = q[i] if i < n else tau[i - n]
        before = rows[2, i]
        now = before if held and i >= n else given
        first, second = rows[0, i], rows[1, i]
        for k in range(3):
            out[k, i] = (
                coefficients[k, 0] * first
                + coefficients[k, 1] * second
                + coefficients[k, 2] * before
                + coefficients[k, 3] * now
            )
        rows[0, i], rows[1, i], rows[2, i] = out[0, i], out[1, i], given


_NAMES = ("q", "tau")


class MatchedSample(NamedTuple):
    """One consistent, delayed sample.

    Attributes:
        q: Filtered position [rad], shape (n,).
        dq: Its exact derivative [rad/s], shape (n,).
        tau: Torque through the same filter [Nm], shape (n,).
        settled: Whether the start of the filter has faded; before that ``dq`` is not usable.
    """

    q: NDArray[np.float64]
    dq: NDArray[np.float64]
    tau: NDArray[np.float64]
    settled: bool


class VelocityState(NamedTuple):
    """All that a `VelocityEstimator` remembers.

    Attributes:
        rows: Output of both lags and the last sample, position then torque, shape (3, 2 n); None
            before a sample.
        age_s: Time since the filter started [s].
    """

    rows: NDArray[np.float64] | None
    age_s: float = 0.0


class VelocityEstimator:
    """Causal velocity from position, with torque through the same filter.

    Args:
        joints: Number of joints.
        bandwidth_per_s: w of the two lags [1/s]; the common delay is 2/w, the velocity noise
            from white position noise s at period dt is ``s sqrt(dt w^3 / 4)``.
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
        check_positive("bandwidth_per_s", bandwidth_per_s)
        check_positive("joints", joints)
        check_alignment(alignment)
        check_gap(max_gap_s)
        self._joints = joints
        self._bandwidth = float(bandwidth_per_s)
        self._held = alignment == "hold"
        self._max_gap_s = max_gap_s
        self._settling_s = self.SETTLING_LAGS / bandwidth_per_s
        self._rows = np.zeros((ROWS, 2 * int(joints)))
        self._dt_s = math.nan
        self._coefficients = np.zeros((3, ROWS))
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
        dt_s = check_interval(dt_s) if self._seated else 0.0
        return MatchedSample(*self.absorb(rows[0], rows[1], dt_s))

    def absorb(
        self, q: NDArray[np.float64], tau: NDArray[np.float64], dt_s: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], bool]:
        """As `update`, for finite arrays of the right shape, contiguous, and a checked time step.

        Returns:
            The fields of a `MatchedSample`.
        """
        n, rows, last = self._joints, self._rows, self._rows[3]
        if not self._seated or (dt_s != self._dt_s and self._is_gap(dt_s)):
            rows[:, :n], rows[:, n:] = q, tau
            self._age_s = 0.0
            self._seated = True
            still = last.copy()
            return still[:n], np.zeros(n), still[n:], False
        out = lag_pair_step(rows, q, tau, self._coefficients, self._held)
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
        return VelocityState(self._rows[:3].copy() if self._seated else None, self._age_s)

    def restore(self, state: VelocityState) -> None:
        """Go on from a `state` taken earlier.

        Raises:
            ConfigurationError: If it belongs to another number of joints.
        """
        if state.rows is not None:
            if state.rows.shape != (3, 2 * self._joints):
                raise ConfigurationError(
                    f"state has rows of shape {state.rows.shape}, expected {(3, 2 * self._joints)}"
                )
            self._rows[:3] = state.rows
        self._seated = state.rows is not None
        self._age_s = state.age_s

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.restore(VelocityState(None))
