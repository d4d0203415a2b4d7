"""A stretch of joint signals that can be cut, bent and joined."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from groundtruth import Run

Array = NDArray[np.float64]

SERIES = ("dt_s", "q_rad", "dq_rad_s", "tau_Nm", "reference_N")
"""Fields of a stream with one entry per sample."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FaultStream:
    """m samples of an arm with n joints, and what the force would be without the fault.

    Attributes:
        dt_s: Time since the sample before, as the caller would tell it, shape (m,).
        q_rad: Positions, shape (m, n).
        dq_rad_s: Velocities, shape (m, n).
        tau_Nm: Torques, shape (m, n).
        reference_N: Axial force to compare with, shape (m,).
        start: First sample of the fault.
        stop: First sample after it.
    """

    dt_s: Array
    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    reference_N: Array
    start: int = 0
    stop: int = 0

    def bent(self, start: int, stop: int) -> "FaultStream":
        """A copy with a fault from ``start`` to before ``stop``, whose arrays may be written."""
        copies = {name: getattr(self, name).copy() for name in SERIES}
        return replace(self, **copies, start=start, stop=stop)

    def without(self, first: int, last: int) -> "FaultStream":
        """The stream without the samples from ``first`` to before ``last``: they were lost.

        The time they took is that of the sample after them, and the fault ends with it.
        """
        kept = np.r_[0:first, last : len(self.dt_s)]
        dt_s = self.dt_s.copy()
        dt_s[last] += dt_s[first:last].sum()
        parts = {name: getattr(self, name)[kept] for name in SERIES} | {"dt_s": dt_s[kept]}
        return replace(self, **parts, start=first, stop=first + 1)

    def then(self, other: "FaultStream") -> "FaultStream":
        """Both, one after the other; the fault of the first counts."""
        joined = {n: np.concatenate((getattr(self, n), getattr(other, n))) for n in SERIES}
        return replace(self, **joined)


def stream_of(run: Run, first: int, last: int, reference_N: Array) -> FaultStream:
    """The samples of a run from ``first`` to before ``last``.

    Args:
        run: An insertion on an arm that sends velocities.
        first: First sample.
        last: First sample after.
        reference_N: For every sample of the run, shape (n,).
    """
    sent, part = run.signals, slice(first, last)
    assert sent.dq_rad_s is not None
    return FaultStream(
        dt_s=np.full(last - first, 1e-3),
        q_rad=sent.q_rad[part],
        dq_rad_s=sent.dq_rad_s[part],
        tau_Nm=sent.tau_Nm[part],
        reference_N=reference_N[part],
    )


def tare_index(run: Run) -> int:
    """The first sample of a run after the tare."""
    return int(np.searchsorted(run.signals.t_s, run.tare_end_s))
