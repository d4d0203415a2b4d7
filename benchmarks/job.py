"""One piece of work for a process of its own, and what comes back."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.drawing import Drawing
from benchmarks.errors import DataError
from benchmarks.row import Row

RECORDING = "recording"
"""The plant of a benchmark on real data."""
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
        drawings: Folder for charts; None for none.
    """

    benchmark: str
    plant: str
    seed: int = 0
    data: Path | None = None
    drawings: Path | None = None

    @property
    def recordings(self) -> Path:
        """The folder of recordings.

        Raises:
            DataError: There is none.
        """
        if self.data is None:
            raise DataError(f"{self.benchmark} needs recordings: give --data DIR")
        return self.data

    def __str__(self) -> str:
        """One line for people."""
        return f"{self.benchmark}, {self.plant}, seed {self.seed}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What a job has found.

    Attributes:
        job: The job.
        rows: Its numbers; none when it failed.
        drawings: The charts it has drawn.
        failure: Why it failed, one line.
    """

    job: Job
    rows: tuple[Row, ...] = field(default=())
    drawings: tuple[Drawing, ...] = ()
    failure: str | None = None


def progress_part(progress: Progress, start: float, end: float) -> Progress:
    """Progress of a part, 0 to 1, as progress of the whole from start to end."""

    def tell(share: float) -> None:
        progress(start + (end - start) * share)

    return tell
