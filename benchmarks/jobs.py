"""One job of a benchmark, and the numbers that it measures."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple, SupportsFloat

NEEDLE = "needle"
"""The plant of a simulation without an arm."""

Source = Literal["ft", "virtual"]
"""Which force: read by the F/T sensor, or estimated from joint signals. Studies without
a force name here what was measured, such as a scan or an estimator."""
Method = Literal[
    "published-one-setting",
    "published-as-authors-ran",
    "published-best-gain",
    "published",
    "rule-of-thumb",
    "ours",
]
"""Whose method. What does not depend on it stands under ``ours``.

``published-one-setting`` is the method of Ferro et al. with one setting and the
measured speed, as ours; ``published-as-authors-ran`` has commanded speed and σ₁ chosen
for each recording; ``published-best-gain`` is that with the gain of the observer that
suits the recording best, where theirs is 5/s. ``published`` is a published method of
control. ``rule-of-thumb`` is what an identification worth having must beat."""


class Figure(NamedTuple):
    """One measured number of a job.

    Attributes:
        metric: A name of `judged.toml`.
        value: The number; nan where it could not be determined.
        source: See `Source`.
        method: See `Method`.
    """

    metric: str
    value: SupportsFloat
    source: str = "virtual"
    method: Method = "ours"


def make_figures(
    values: Mapping[str, SupportsFloat],
    source: str = "virtual",
    method: Method = "ours",
) -> list[Figure]:
    """Return numbers by name as those of one source and method."""
    return [Figure(name, value, source, method) for name, value in values.items()]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One case of a benchmark, on one plant with one seed.

    It is a piece of work for a process of its own.

    Attributes:
        benchmark: Its name.
        case: Which of the benchmark's cases; empty where it has only one.
        plant: Plant model of a simulation, ``needle`` for one without an arm,
            ``recording`` for real data, ``no-arm`` where none plays a part.
        seed: Of everything drawn; of real data, the number of the recording.
        data: Folder of recordings, for benchmarks that need it.
        report: Folder for the figures of the paper; None for none.
        is_ours_only: Whether the published methods are left out of an insertion.
    """

    benchmark: str
    plant: str
    case: str = ""
    seed: int = 0
    data: Path | None = None
    report: Path | None = None
    is_ours_only: bool = False

    @property
    def scenario(self) -> str:
        """Benchmark and case, as its rows name them."""
        case = self.case.replace(", ", "-").replace(" ", "-")
        return f"{self.benchmark}/{case}" if case else self.benchmark

    @property
    def recordings(self) -> Path:
        """The folder of recordings, for benchmarks that need it."""
        assert self.data is not None, "without recordings there are no such jobs"
        return self.data

    def __str__(self) -> str:
        """One line for people."""
        return f"{self.scenario}, {self.plant}, seed {self.seed}"
