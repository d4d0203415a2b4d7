"""One sample of an insertion."""

from typing import NamedTuple


class Sample(NamedTuple):
    """Checked scalars handed to the step functions.

    Attributes:
        time_s: Time since the identifier was reset, the sum of all intervals.
        dt_s: Interval since the previous sample, positive.
        depth_m: Tip travel along the insertion axis, jumps removed.
        speed_m_s: Rate of depth.
        force_N: Axial force, positive when tissue pushes back.
    """

    time_s: float
    dt_s: float
    depth_m: float
    speed_m_s: float
    force_N: float
