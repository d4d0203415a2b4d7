"""One number of the verdict, and the words that say where it comes from."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

Source = Literal["ft", "virtual"]
"""Which force: read by the F/T sensor, or estimated from joint signals."""
Method = Literal["paper", "default", "guess"]
"""Whose method: as published, or ours. What does not depend on it stands under ``default``;
``guess`` is a rule of thumb that an identification worth having must beat."""


class RowKey(NamedTuple):
    """What makes two rows of two runs comparable."""

    scenario: str
    plant: str
    seed: int
    source: str
    method: str
    metric: str

    def __str__(self) -> str:
        """One line for people."""
        return " ".join(map(str, self))


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One measured number.

    Attributes:
        scenario: Name of the benchmark.
        plant: Arm level of a simulation, ``recording`` for real data.
        seed: Seed of a simulation, number of the recording for real data.
        source: See `Source`.
        method: See `Method`.
        metric: A name of `benchmarks.metrics.metric_catalogue`.
        value: The number; nan where it could not be determined.
        unit: Its unit.
    """

    scenario: str
    plant: str
    seed: int
    source: str
    method: str
    metric: str
    value: float
    unit: str

    @property
    def key(self) -> RowKey:
        """All but value and unit."""
        return RowKey(self.scenario, self.plant, self.seed, self.source, self.method, self.metric)
