"""The axial force that the F/T sensor at the needle's base reads."""

import numpy as np

from benchmarks.methods.force_reading import ForceReading
from groundtruth import Run

TARE_s = 3.0
"""The last stroke in free air. Over a whole stroke, from rest to rest, the needle's inertia cancels
from the mean; its weight does not change on a straight line and goes with the offset."""


def ft_force(run: Run) -> ForceReading:
    """Axial force from the F/T reading, zeroed over the last free stroke.

    The standard deviation it states is its noise over that stroke: what a user would write down.
    """
    t_s = run.signals.t_s
    resistance = -run.signals.ft_wrench[:, 2]
    free = resistance[(t_s > run.tare_end_s - TARE_s) & (t_s <= run.tare_end_s)]
    return ForceReading(
        source="ft",
        method="default",
        axial_N=resistance - free.mean(),
        std_N=np.full(len(t_s), free.std()),
    )
