"""One thing that can be run by name."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from benchmarks.drawing import Drawing
from benchmarks.job import Job, Progress
from benchmarks.metrics.measurement import Measurement


class Findings(NamedTuple):
    """What running a job gives."""

    measurements: list[Measurement]
    drawings: tuple[Drawing, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """One thing that can be run by name.

    Attributes:
        id: Permanent name.
        title: One line for people.
        run: Does a job of it.
        needs: Folders of recordings it reads; none for a simulation.
        seeds: How many different seeds it has; None for any number.
        is_default: Whether it runs when nothing is named.
        plants: On which plants a simulation runs when none is named.
        needs_arm: Whether a simulation without an arm has nothing to show.
    """

    id: str
    title: str
    run: Callable[[Job, Progress], Findings]
    needs: tuple[str, ...] = ()
    seeds: int | None = None
    is_default: bool = True
    plants: tuple[str, ...] = ("realistic",)
    needs_arm: bool = True

    @property
    def is_recorded(self) -> bool:
        """Whether it reads real data; it has no arm levels then."""
        return bool(self.needs)
