"""What an identifier gets: depth and speed from kinematics, force from a sensor."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.row import Source

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NeedleSignal:
    """n samples of one run.

    Attributes:
        source: Where the force comes from.
        t_s: Time stamps, shape (n,).
        depth_m: Travel along the needle's axis, shape (n,); where its zero lies is not known.
        speed_m_s: Its rate, shape (n,).
        force_N: Axial force, zeroed in free air, shape (n,).
    """

    source: Source
    t_s: Array
    depth_m: Array
    speed_m_s: Array
    force_N: Array
