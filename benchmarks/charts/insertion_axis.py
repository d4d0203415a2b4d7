"""The clock of the charts: seconds since the needle set out, as in the paper."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.identified import Identified
from benchmarks.signals.insertion_truth import InsertionTruth
from figures import Instants, Shading, palette

Array = NDArray[np.float64]

MARGIN_s = 1.0
"""Shown before contact and after the deepest point."""
_SEEN_BESIDE_A_LINE_PT = 3.0
"""A layer gives way within 0.1 s of a minute; lines that mark its detection lie on top."""


class InsertionAxis(NamedTuple):
    """Turns times of a run into places on the x axis.

    Attributes:
        truth: Of the run. The insertion begins where the tare stroke ends.
    """

    truth: InsertionTruth

    def place(self, t_s: Array) -> Array:
        """Seconds since the insertion began."""
        return t_s - self.truth.tare_end_s

    def at(self, t_s: float) -> float:
        """The same for one time."""
        return t_s - self.truth.tare_end_s

    @property
    def limits(self) -> tuple[float, float]:
        """From just before contact to just after the deepest point."""
        truth = self.truth
        return self.at(truth.contact_s - MARGIN_s), self.at(truth.insertion_end_s + MARGIN_s)

    def true_ruptures(self) -> Shading:
        """When layers really gave way: from the onset to the end of the release."""
        spans = tuple((self.at(item.onset_s), self.at(item.end_s)) for item in self.truth.ruptures)
        return Shading(
            label="a layer gives way (truth)",
            color=palette.TRUE_RUPTURE,
            spans=spans,
            least_pt=_SEEN_BESIDE_A_LINE_PT,
        )

    def events(self, item: Identified, who: str = "") -> list[Instants]:
        """Alarms and compensations of a method.

        Args:
            item: What the method made of the run.
            who: Added to the words of the legend.
        """
        times = self.truth.t_s[item.start :]
        compensated = tuple(
            self.at(float(times[k]))
            for k, estimate in enumerate(item.result.estimates)
            if estimate.compensated is not None
        )
        alarms = tuple(self.at(alarm.alarm_s) for alarm in item.alarms)
        return [
            Instants(label=f"rupture detected{who}", style=palette.RUPTURE, places=alarms),
            Instants(
                label=f"friction compensated{who}", style=palette.COMPENSATION, places=compensated
            ),
        ]
