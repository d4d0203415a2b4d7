"""One piece of work for a process of its own, and what comes back."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.row import Row

Progress = Callable[[float], None]
"""Takes the share done, 0 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One benchmark on one plant with one seed.

    Attributes:
        benchmark: Its name.
        plant: Arm level of a simulation, ``needle`` for one without an arm, ``recording`` for real
            data.
        seed: Of everything drawn; of real data, the number of the recording.
        data: Folder of recordings, for benchmarks that need it.
        pictures: Folder for pictures; None for none.
    """

    benchmark: str
    plant: str
    seed: int = 0
    data: Path | None = None
    pictures: Path | None = None

    def __str__(self) -> str:
        """One line for people."""
        return f"{self.benchmark}, {self.plant}, seed {self.seed}"

    def picture(self, kind: str = "") -> Path | None:
        """Where this job's picture of a kind goes, nothing where none is wanted."""
        if self.pictures is None:
            return None
        ending = f"-{kind}" if kind else ""
        return self.pictures / f"{self.benchmark}-{self.plant}-{self.seed}{ending}.png"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a job has found.

    Attributes:
        job: The job.
        rows: Its numbers; none when it failed.
        pictures: The pictures it has drawn.
        failure: Why it failed, one line.
    """

    job: Job
    rows: tuple[Row, ...] = field(default=())
    pictures: tuple[Path, ...] = ()
    failure: str | None = None
