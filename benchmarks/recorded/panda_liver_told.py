"""Identification on the force of ``panda-liver``: what the whole chain tells of real tissue."""

from collections.abc import Sequence

import numpy as np

from benchmarks.methods.force_reading import ForceReading
from benchmarks.methods.identified import IDENTIFIERS
from benchmarks.metrics.measurement import Measurement
from benchmarks.recorded.liver import LiverInsertion
from benchmarks.recorded.liver_told import (
    DEPTHS_mm,
    LiverTold,
    friction_values,
    known_of,
    rupture_values,
    tell,
)
from benchmarks.recorded.pullout import in_and_out
from benchmarks.row import Source
from benchmarks.signals.force_truth import ForceTruth

OF_MANY = "_p90_pct"
"""One insertion has no 90th percentile."""


def told_values(
    insertion: LiverInsertion, truth: ForceTruth, readings: Sequence[ForceReading]
) -> list[Measurement]:
    """Friction and ruptures by both methods, from the force itself and from each one's own sensor.

    A real enhanced force has no truth; that of the virtual force is held against that which the
    same method tells from the force itself.

    Args:
        insertion: The whole recording, withdrawal included.
        truth: The force as it acts on the arm, which an F/T sensor would read.
        readings: Of the virtual sensors, one per method.
    """
    felt = truth.t_s >= truth.zeroed_s
    t_s, depth, force = truth.t_s[felt], truth.depth_m[felt], truth.axial_N[felt]
    out = in_and_out(insertion.depth_m).withdrawal
    pullout = [-insertion.force_at_N(out, mm) for mm in DEPTHS_mm]
    known = known_of(pullout, depth, force)
    found: list[Measurement] = []
    by_method = {item.method: item.axial_N[felt] for item in readings}
    for method in IDENTIFIERS:
        ft = tell(t_s, depth, force, method, known)
        virtual = tell(t_s, depth, by_method[method], method, known)
        by_source: dict[Source, LiverTold] = {"ft": ft, "virtual": virtual}
        for source, told in by_source.items():
            values = [*friction_values([told]), *rupture_values([told], len(known.falls))]
            found += [
                Measurement(source, method, name, value)
                for name, value in values
                if not name.endswith(OF_MANY)
            ]
        off = float(np.sqrt(np.mean((virtual.enhanced_N - ft.enhanced_N) ** 2)))
        found.append(Measurement("virtual", method, "enhanced_against_ft_rmse_N", off))
    return found
