"""Online estimates as columns of a table."""

import numpy as np
from numpy.typing import NDArray

from identification.replay import Replay

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
)
_FLAGS = ("in_contact", "layer", "stiffness_identified", "friction_identified")


def estimate_table(result: Replay) -> dict[str, NDArray[np.float64]]:
    """Columns named with their units, one row per row of the recording.

    `absorbed` is 0 for rows that could not be used; `rupture` is the number of the layer left on
    the row of its alarm, `compensated` on the row its friction was identified, else 0. Standard
    deviations that a method does not state are nan.
    """
    rows = result.estimates
    table = {"t_s": np.array(result.t_s)}
    for name in _NUMBERS:
        values = [getattr(row, name) for row in rows]
        table[name] = np.array([np.nan if v is None else v for v in values])
    for name in _FLAGS:
        table[name] = np.array([float(getattr(row, name)) for row in rows])
    table["absorbed"] = np.array([float(row.status.is_absorbed) for row in rows])
    table["rupture"] = np.array([float(row.rupture.layer if row.rupture else 0) for row in rows])
    table["compensated"] = np.array(
        [float(row.compensated.layer if row.compensated else 0) for row in rows]
    )
    return table
