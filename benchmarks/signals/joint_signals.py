"""Joint signals of an arm, simulated or recorded: all that the virtual sensor gets."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundtruth import Run

Array = NDArray[np.float64]

CLOCK_DIGITS = 9
"""Time stamps are whole nanoseconds; differences of their floats are not, and a tick that differs
in its last bit looks like a clock that jitters."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointSignals:
    """n samples of an arm with j joints.

    Attributes:
        t_s: Time stamps, shape (n,), increasing.
        q_rad: Positions, shape (n, j).
        dq_rad_s: Velocities, shape (n, j), or None where the arm sends none.
        tau_Nm: Torques, shape (n, j).
    """

    t_s: Array
    q_rad: Array
    dq_rad_s: Array | None
    tau_Nm: Array

    @classmethod
    def of_run(cls, run: Run) -> "JointSignals":
        """What the arm of a simulated insertion sent."""
        sent = run.signals
        return cls(t_s=sent.t_s, q_rad=sent.q_rad, dq_rad_s=sent.dq_rad_s, tau_Nm=sent.tau_Nm)

    @property
    def dt_s(self) -> Array:
        """Time since the previous sample, shape (n,).

        The first sample has no previous one: its entry is 1, and nobody reads it.
        """
        return np.round(np.diff(self.t_s, prepend=self.t_s[0] - 1.0), CLOCK_DIGITS)

    def velocity(self, k: int) -> Array | None:
        """Velocities of sample k, or None."""
        return None if self.dq_rad_s is None else self.dq_rad_s[k]
