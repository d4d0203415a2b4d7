"""True ruptures of a run, dated from the depth the needle went through."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundtruth.crossing import first_crossing_s
from groundtruth.interface import Interface

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rupture:
    """One boundary giving way under the advancing tip.

    Attributes:
        onset_s: The release begins; between samples, by interpolation.
        end_s: It ends; the end of the run if the needle stopped within it.
        onset_m: Depth of the tip at the onset.
        layer: The layer the tip leaves; 0 for a membrane on the surface.
        is_membrane: A membrane was punctured.
        drop_N: Force the tip loses: elastic, membrane and cutting force held at the onset.
        visible_drop_N: Fall of the axial force from the onset to its least value before the end;
            smaller than `drop_N` where the next layer or its friction already pushes, a little
            larger where the needle slows down meanwhile.
        layer_friction_N: Friction of the layer left, at the onset.
        friction_N: Friction of the whole shaft when the release has ended.
    """

    onset_s: float
    end_s: float
    onset_m: float
    layer: int
    is_membrane: bool
    drop_N: float
    visible_drop_N: float
    layer_friction_N: float
    friction_N: float


def find_ruptures(
    boundaries: Sequence[Interface],
    t_s: Array,
    depth_m: Array,
    tip_N: Array,
    layer_friction_N: Array,
) -> tuple[Rupture, ...]:
    """List the ruptures of a run in the order they happen.

    A bare surface holds no force and is no rupture.

    Args:
        boundaries: `law.interfaces` of the law that was run.
        t_s: Sample times, shape (n,).
        depth_m: True depth of the tip, shape (n,).
        tip_N: True tip force, shape (n,).
        layer_friction_N: True friction per layer, shape (n, number of layers).
    """
    found: list[Rupture] = []
    friction_N = layer_friction_N.sum(axis=1)
    axial_N = tip_N + friction_N
    for left, boundary in enumerate(boundaries):
        onset_s = first_crossing_s(t_s, depth_m, boundary.onset_m)
        if boundary.drop_N == 0.0 or np.isnan(onset_s):
            continue
        end_s = first_crossing_s(t_s, depth_m, boundary.onset_m + boundary.release_m)
        end_s = float(t_s[-1]) if np.isnan(end_s) else end_s
        before = max(int(np.searchsorted(t_s, onset_s)) - 1, 0)
        after = min(int(np.searchsorted(t_s, end_s)), t_s.size - 1)
        found.append(
            Rupture(
                onset_s=onset_s,
                end_s=end_s,
                onset_m=boundary.onset_m,
                layer=left,
                is_membrane=boundary.membrane is not None,
                drop_N=float(tip_N[before]),
                visible_drop_N=float(axial_N[before] - axial_N[before : after + 1].min()),
                layer_friction_N=float(layer_friction_N[before, left - 1]) if left else 0.0,
                friction_N=float(friction_N[after]),
            )
        )
    return tuple(found)
