"""Online estimates as columns of a table."""

from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from identification.replay_stream import ReplayedRows

_NUMBERS = (
    "enhanced_force_N",
    "tip_force_N",
    "shaft_friction_N",
    "shaft_friction_std_N",
    "predicted_force_N",
    "stiffness_N_per_m",
    "stiffness_std_N_per_m",
    "friction_Ns_per_m2",
    "friction_std_Ns_per_m2",
    "cumulative_friction_Ns_per_m",
    "cumulative_friction_std_Ns_per_m",
    "in_contact",
    "layer",
    "stiffness_identified",
    "friction_identified",
)
_EVENTS = ("rupture", "compensated")

_read = attrgetter(*_NUMBERS, "status.is_absorbed", *_EVENTS)


def estimate_table(rows: ReplayedRows) -> dict[str, NDArray[np.float64]]:
    """Columns named with their units, one row per row of the recording, of which there is one.

    `absorbed` is 0 for rows that could not be used; `rupture` is the number of the layer left on
    the row of its alarm, `compensated` on the row its friction was identified, else 0. Standard
    deviations that a method does not state are nan.
    """
    *numbers, absorbed, ruptures, compensated = zip(*map(_read, rows.estimates), strict=True)
    table = {"t_s": rows.t_s}
    for name, values in zip(_NUMBERS, numbers, strict=True):
        # None becomes nan.
        table[name] = np.array(values, dtype=np.float64)
    table["absorbed"] = np.array(absorbed, dtype=np.float64)
    for name, events in zip(_EVENTS, (ruptures, compensated), strict=True):
        table[name] = np.array([0.0 if e is None else float(e.layer) for e in events])
    return table
