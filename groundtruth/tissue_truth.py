"""The true forces of a run, sample by sample, with its true instants and ruptures."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from groundtruth.errors import Array
from groundtruth.layers import Interface
from groundtruth.tissue import Tissue, TissueForce


class ReadOnlyArrays:
    """A frozen dataclass whose arrays are read-only."""

    __slots__ = ()

    def __post_init__(self) -> None:
        for item in fields(cast(Any, self)):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value.setflags(write=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rupture:
    """One boundary that ruptures under the advancing tip.

    The visible drop is the fall of the axial force from the onset to its least value before the
    end: smaller than `drop_N` where the next layer or its friction already pushes, a little larger
    where the needle slows down meanwhile.
    """

    onset_s: float  # the release begins; between samples, by interpolation
    end_s: float  # it ends; the end of the run if the needle stopped within it
    onset_m: float  # depth of the tip at the onset
    layer: int  # the one the tip leaves; 0 for a membrane on the surface
    is_membrane: bool  # a membrane was punctured
    drop_N: float  # force the tip loses: elastic, membrane and cutting force held at the onset
    visible_drop_N: float
    layer_friction_N: float  # of the layer that the tip leaves, at the onset
    friction_N: float  # of the whole shaft when the release has ended


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TissueTruth(ReadOnlyArrays):
    """The ground truth of the tissue at n samples, see `TissueForce`."""

    axial_N: Array  # shape (n,), positive when tissue pushes back, as the next two
    tip_N: Array
    friction_N: Array  # negative in withdrawal
    layer_friction_N: Array  # shape (n, number of layers)
    layer: NDArray[np.int64]  # shape (n,)
    ruptures: tuple[Rupture, ...]  # in the order they happened
    contact_s: float  # the tip first touches the undeformed surface; nan if it never does
    withdrawn_s: float  # it leaves that surface in withdrawal; nan if it does not

    @property
    def rupture_s(self) -> Array:
        """Onset of each rupture, shape (number of ruptures,)."""
        return np.array([rupture.onset_s for rupture in self.ruptures], dtype=np.float64)


def collect_truth(
    law: Tissue, t_s: Array, depth_m: Array, forces: Sequence[TissueForce]
) -> TissueTruth:
    """Return the ground truth of a run: true depths at n times, and the law's n answers."""
    columns = np.array([force[:3] for force in forces], dtype=np.float64)
    per_layer = np.array([force.layer_friction_N for force in forces], dtype=np.float64)
    contact_s = _first_crossing_s(t_s, depth_m, 0.0) if law.layers else np.nan
    deepest = int(np.argmax(depth_m))
    withdrawn_s = _first_crossing_s(t_s[deepest:], -depth_m[deepest:], 0.0)
    return TissueTruth(
        axial_N=columns[:, 0],
        tip_N=columns[:, 1],
        friction_N=columns[:, 2],
        layer_friction_N=per_layer,
        layer=np.array([force.layer for force in forces], dtype=np.int64),
        ruptures=_ruptures(law.interfaces, t_s, depth_m, columns[:, 1], per_layer),
        contact_s=contact_s,
        withdrawn_s=np.nan if np.isnan(contact_s) else withdrawn_s,
    )


def _first_crossing_s(t_s: Array, signal: Array, level: float) -> float:
    """Time at which a signal first reaches a level from below, by linear interpolation; or nan."""
    reached = np.flatnonzero(signal >= level)
    if reached.size == 0:
        return float("nan")
    k = int(reached[0])
    if k == 0 or signal[k - 1] >= level:
        return float(t_s[k])
    fraction = (level - signal[k - 1]) / (signal[k] - signal[k - 1])
    return float(t_s[k - 1] + fraction * (t_s[k] - t_s[k - 1]))


def _ruptures(
    boundaries: Sequence[Interface],
    t_s: Array,
    depth_m: Array,
    tip_N: Array,
    layer_friction_N: Array,
) -> tuple[Rupture, ...]:
    """The ruptures in the order they happen, timed from the depth the needle went through."""
    found: list[Rupture] = []
    friction_N = layer_friction_N.sum(axis=1)
    axial_N = tip_N + friction_N
    for above, boundary in enumerate(boundaries):
        onset_s = _first_crossing_s(t_s, depth_m, boundary.onset_m)
        # A bare surface holds no force and is no rupture.
        if boundary.drop_N == 0.0 or np.isnan(onset_s):
            continue
        end_s = _first_crossing_s(t_s, depth_m, boundary.onset_m + boundary.release_m)
        end_s = float(t_s[-1]) if np.isnan(end_s) else end_s
        before = max(int(np.searchsorted(t_s, onset_s)) - 1, 0)
        after = min(int(np.searchsorted(t_s, end_s)), t_s.size - 1)
        found.append(
            Rupture(
                onset_s=onset_s,
                end_s=end_s,
                onset_m=boundary.onset_m,
                layer=above,
                is_membrane=boundary.membrane is not None,
                drop_N=float(tip_N[before]),
                visible_drop_N=float(axial_N[before] - axial_N[before : after + 1].min()),
                layer_friction_N=float(layer_friction_N[before, above - 1]) if above else 0.0,
                friction_N=float(friction_N[after]),
            )
        )
    return tuple(found)
