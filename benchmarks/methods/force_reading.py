"""An axial force as a sensor tells it, sample by sample."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.row import Method, Source

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceReading:
    """Axial force of one source and method over a whole run, n samples.

    Attributes:
        source: See `Source`.
        method: See `Method`.
        axial_N: Force, positive when tissue pushes back, shape (n,), read-only.
        std_N: Standard deviation the source states for it, shape (n,), read-only.
    """

    source: Source
    method: Method
    axial_N: Array
    std_N: Array

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        for name in ("axial_N", "std_N"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
