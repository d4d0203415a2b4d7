"""The true forces of a run, sample by sample, with its true instants."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundtruth.crossing import first_crossing_s
from groundtruth.rupture import Rupture, find_ruptures
from groundtruth.tissue_force import TissueForce, TissueLaw

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TissueTruth:
    """What only the simulation knows; all arrays are read-only, n samples.

    Attributes:
        axial_N: Tip force and friction, shape (n,), positive when tissue pushes back.
        tip_N: Tip force, shape (n,).
        friction_N: Shaft friction, shape (n,); negative on the way out.
        layer_friction_N: Share of each layer, shape (n, number of layers).
        layer: See `TissueForce`, shape (n,).
        ruptures: In the order they happened.
        contact_s: The tip first touches the undeformed surface; nan if it never does.
        withdrawn_s: It last leaves that surface on its way out; nan if it does not.
    """

    axial_N: Array
    tip_N: Array
    friction_N: Array
    layer_friction_N: Array
    layer: NDArray[np.int64]
    ruptures: tuple[Rupture, ...]
    contact_s: float
    withdrawn_s: float

    @property
    def rupture_s(self) -> Array:
        """Onset of each rupture, shape (number of ruptures,)."""
        return np.array([rupture.onset_s for rupture in self.ruptures], dtype=np.float64)


def collect_truth(
    law: TissueLaw, t_s: Array, depth_m: Array, forces: Sequence[TissueForce]
) -> TissueTruth:
    """Turn the forces of a run into its truth.

    Args:
        law: The law that was run.
        t_s: Sample times, shape (n,).
        depth_m: True depth at those times, shape (n,).
        forces: The law's answers at those times, n of them.
    """
    columns = np.array([force[:3] for force in forces], dtype=np.float64)
    per_layer = np.array([force.layer_friction_N for force in forces], dtype=np.float64)
    layer = np.array([force.layer for force in forces], dtype=np.int64)
    for array in (columns, per_layer, layer):
        array.setflags(write=False)
    contact_s = first_crossing_s(t_s, depth_m, 0.0)
    deepest_s = float(t_s[int(np.argmax(depth_m))])
    withdrawn_s = first_crossing_s(t_s, -depth_m, 0.0, after_s=deepest_s)
    return TissueTruth(
        axial_N=columns[:, 0],
        tip_N=columns[:, 1],
        friction_N=columns[:, 2],
        layer_friction_N=per_layer,
        layer=layer,
        ruptures=find_ruptures(law.interfaces, t_s, depth_m, columns[:, 1], per_layer),
        contact_s=contact_s,
        withdrawn_s=float("nan") if np.isnan(contact_s) else withdrawn_s,
    )
