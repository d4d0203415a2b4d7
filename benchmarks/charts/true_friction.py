"""True friction coefficients of a run, where truth has such a thing."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.signals.insertion_truth import InsertionTruth

Array = NDArray[np.float64]


def true_friction(truth: InsertionTruth) -> dict[str, tuple[Array, Array]]:
    """Steps over time, by the name of the estimate they belong to.

    True friction is no coefficient (it also depends on speed in other ways): these are its values
    at each rupture, friction over speed, and that over the way since the rupture before. There is
    no one true stiffness, and none is given.
    """
    times: list[float] = []
    local: list[float] = []
    total: list[float] = []
    start_s, start_m, sum_before = truth.contact_s, 0.0, 0.0
    for rupture in truth.ruptures:
        speed = float(np.interp(rupture.onset_s, truth.t_s, truth.speed_m_s))
        product = rupture.layer_friction_N / speed
        thickness = rupture.onset_m - start_m
        times += [start_s, rupture.onset_s, rupture.onset_s]
        local += [product / thickness, product / thickness, np.nan]
        total += [sum_before, sum_before, np.nan]
        start_s, start_m, sum_before = rupture.onset_s, rupture.onset_m, sum_before + product
    times += [start_s, float(truth.insertion_end_s)]
    return {
        "friction_Ns_per_m2": (np.array(times[:-2]), np.array(local)),
        "cumulative_friction_Ns_per_m": (
            np.array(times),
            np.array([*total, sum_before, sum_before]),
        ),
    }
