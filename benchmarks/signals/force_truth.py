"""What a force reading is judged against."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceTruth:
    """True axial force over a run, and the part of it that is judged.

    Attributes:
        t_s: Time, shape (n,), increasing.
        depth_m: Travel of the tip since first contact, shape (n,).
        axial_N: True axial force, shape (n,).
        zeroed_s: When the sensors were zeroed; what they said before means nothing.
        start_s: First contact.
        end_s: End of the withdrawal.
    """

    t_s: Array
    depth_m: Array
    axial_N: Array
    zeroed_s: float
    start_s: float
    end_s: float

    @property
    def judged(self) -> NDArray[np.bool_]:
        """The samples that count, shape (n,)."""
        return (self.t_s >= self.start_s) & (self.t_s <= self.end_s)
