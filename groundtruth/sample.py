"""What a tissue law is told at each step."""

import math
from typing import NamedTuple

from groundtruth.errors import TissueError


class NeedleSample(NamedTuple):
    """Where the needle is and how fast it goes.

    Attributes:
        depth_m: Travel of the tip along the insertion axis since first contact; negative above.
        speed_m_s: Its rate, positive inwards.
        dt_s: Time since the previous sample.
    """

    depth_m: float
    speed_m_s: float
    dt_s: float


def checked_sample(depth_m: float, speed_m_s: float, dt_s: float) -> NeedleSample:
    """Make a sample, refusing what a law could only turn into nonsense.

    Raises:
        TissueError: A value is not finite, or the time step is not positive.
    """
    if math.isfinite(depth_m + speed_m_s + dt_s) and dt_s > 0.0:
        return NeedleSample(depth_m, speed_m_s, dt_s)
    raise TissueError(
        f"depth_m={depth_m!r}, speed_m_s={speed_m_s!r}, dt_s={dt_s!r}: "
        "a tissue law needs finite numbers and dt_s above zero; its state is unchanged"
    )
