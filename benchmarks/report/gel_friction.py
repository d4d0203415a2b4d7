"""Cumulative friction of the single gels, gathered from the rows of a run."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from benchmarks.drawing import Drawing
from benchmarks.row import Row
from benchmarks.verdict.scenario_groups import GELS

PLANTS = ("realistic", "hard", "textbook", "needle")
"""The first of these on which gels were run is shown."""
SPEEDS = ("constant", "sinusoidal")
PERCENTS = (25, 50, 70)
METRIC = "cumulative_friction_{kind}_Ns_per_m"


@dataclass(frozen=True, slots=True, kw_only=True)
class GelFriction:
    """What the rows of one plant say of the gels.

    Attributes:
        plant: Which.
        rows: Of that plant and these gels.
        tuned: By the published method as its authors ran it, by scenario, seed 0.
    """

    plant: str
    rows: tuple[Row, ...]
    tuned: Mapping[str, float]

    def values(
        self, percent: int, speed: str, kind: str, source: str = "ft", method: str = "default"
    ) -> Sequence[float]:
        """Friction of a gel at a speed in Ns/m, one per seed.

        Args:
            percent: Of isinglass.
            speed: One of `SPEEDS`.
            kind: ``true``, ``offline``, ``online``, or ``tuned``: see `tuned`.
            source: Of the force.
            method: Of the identification.
        """
        if kind == "tuned":
            told = self.tuned.get(f"gel-{percent}-{speed}")
            return [] if told is None else [told]
        wanted = (f"gel-{percent}-{speed}", source, method, METRIC.format(kind=kind))
        return [
            row.value
            for row in self.rows
            if (row.scenario, row.source, row.method, row.metric) == wanted
        ]

    def middle(
        self, percent: int, speed: str, kind: str, source: str = "ft", method: str = "default"
    ) -> float:
        """Median over the seeds of what `values` gives; nan where there is none."""
        found = self.values(percent, speed, kind, source, method)
        return statistics.median(found) if found else float("nan")

    @property
    def scenarios(self) -> set[str]:
        """Gels there are rows for."""
        return {row.scenario for row in self.rows}


def gel_friction(rows: Iterable[Row], drawings: Iterable[Drawing]) -> GelFriction | None:
    """The gels of the best plant they were run on; None without any."""
    found = [row for row in rows if row.scenario in GELS and row.metric.startswith("cumulative_")]
    for plant in PLANTS:
        mine = tuple(row for row in found if row.plant == plant)
        if mine:
            tuned = {
                item.scenario: item.tuned_friction_Ns_per_m
                for item in drawings
                if item.plant == plant and not math.isnan(item.tuned_friction_Ns_per_m)
            }
            return GelFriction(plant=plant, rows=mine, tuned=tuned)
    return None
