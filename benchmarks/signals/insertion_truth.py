"""What was true of one insertion: what its identification is judged against."""

from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from groundtruth import NeedleRun, Run, Rupture, Truth

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InsertionTruth:
    """Truth at the n samples of a run through L layers.

    Attributes:
        t_s: True instants, shape (n,).
        depth_m: Travel of the tip since first contact, shape (n,).
        speed_m_s: Its rate, shape (n,).
        axial_N: Axial force, shape (n,), positive when tissue pushes back.
        tip_N: Its part at the tip, shape (n,).
        layer_friction_N: Friction of each layer on the shaft, shape (n, L).
        layer: Where the tip is: 0 above, i in layer i, L + 1 beyond, shape (n,).
        ruptures: In the order they happened.
        tare_end_s: Nothing has been touched before.
        contact_s: First contact.
        insertion_end_s: The needle is at its deepest.
        boundaries_m: Where each layer ends in undeformed tissue; none where that is not told.
    """

    t_s: Array
    depth_m: Array
    speed_m_s: Array
    axial_N: Array
    tip_N: Array
    layer_friction_N: Array
    layer: NDArray[np.int64]
    ruptures: tuple[Rupture, ...]
    tare_end_s: float
    contact_s: float
    insertion_end_s: float
    boundaries_m: tuple[float, ...] = ()

    @property
    def enhanced_N(self) -> Array:
        """Axial force without the friction of the layers already left, shape (n,)."""
        number = np.arange(1, self.layer_friction_N.shape[1] + 1)
        is_left = number[None, :] < self.layer[:, None]
        return self.axial_N - np.sum(self.layer_friction_N * is_left, axis=1)

    @property
    def is_insertion(self) -> NDArray[np.bool_]:
        """Samples from first contact to the deepest point, shape (n,)."""
        return (self.t_s >= self.contact_s) & (self.t_s <= self.insertion_end_s)


def truth_of_run(run: Run) -> InsertionTruth:
    """The truth of an insertion by the simulated arm."""
    return _truth(run, run.truth, run.contact_s)


def truth_of_needle(run: NeedleRun) -> InsertionTruth:
    """The truth of an insertion by a needle without an arm."""
    return _truth(run, run, run.truth.contact_s)


def _truth(run: Run | NeedleRun, motion: Truth | NeedleRun, contact_s: float) -> InsertionTruth:
    true = run.truth
    return InsertionTruth(
        t_s=motion.t_s,
        depth_m=motion.depth_m,
        speed_m_s=motion.speed_m_s,
        axial_N=true.axial_N,
        tip_N=true.tip_N,
        layer_friction_N=true.layer_friction_N,
        layer=true.layer,
        ruptures=true.ruptures,
        tare_end_s=run.tare_end_s,
        contact_s=contact_s,
        insertion_end_s=run.scenario.motion.insertion_end_s,
        boundaries_m=tuple(accumulate(layer.thickness_m for layer in run.scenario.layers)),
    )
