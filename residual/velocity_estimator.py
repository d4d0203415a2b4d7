"""Joint velocity when the robot sends none, with torque delayed to match."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.momentum_step import Alignment
from residual.sample_check import check_interval, check_joint_vector
from residual.settings_check import check_alignment, check_gap, check_positive
from residual.velocity_step import lag_pair_step


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


class VelocityEstimator:
    """Causal velocity from position, with torque through the same filter.

    Args:
        joints: Number of joints.
        bandwidth_per_s: w of the two lags [1/s]; the common delay is 2/w, the velocity noise
            from white position noise s at period dt is ``s sqrt(dt w^3 / 4)``.
        alignment: How torque fills a tick, see `residual.momentum_step.Alignment`. The filtered
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
        self._bandwidth = bandwidth_per_s
        self._held = alignment == "hold"
        self._max_gap_s = max_gap_s
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
        sample = np.stack(
            (check_joint_vector("q", q, self._joints), check_joint_vector("tau", tau, self._joints))
        )
        if self._sample is not None:
            check_interval(dt_s)
        if self._sample is None or dt_s > self._max_gap_s:
            self._first = self._second = sample
            self._age_s = 0.0
        else:
            end = np.stack((sample[0], self._sample[1])) if self._held else sample
            self._first, self._second = lag_pair_step(
                self._first, self._second, self._sample, end, self._bandwidth, dt_s
            )
            self._age_s += dt_s
        self._sample = sample
        return MatchedSample(
            q=self._second[0],
            dq=self._bandwidth * (self._first[0] - self._second[0]),
            tau=self._second[1],
            settled=self._age_s * self._bandwidth >= self.SETTLING_LAGS,
        )

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self._sample: NDArray[np.float64] | None = None
        self._first = self._second = np.zeros((2, self._joints))
        self._age_s = 0.0
