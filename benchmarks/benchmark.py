"""One thing that can be run by name."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from benchmarks.errors import DataError
from benchmarks.metric_catalogue import Measurement
from benchmarks.rows import Row

# A chart of a run, drawn, and the words that go with it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Fact:
    """One number of a figure, the paper's beside those of our runs.

    Attributes:
        what: With the unit.
        paper: As printed in the paper, or said in its text.
        here: From our runs, by the head of its column.
    """

    what: str
    paper: str
    here: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """A chart of a run, drawn.

    Attributes:
        figure: Of the paper to which it is the counterpart, such as ``8``; empty for none.
        panel: Letter of the panel; empty for none.
        scenario: What was simulated.
        plant: On which arm.
        seed: Of everything drawn.
        path: The file.
        wide: The same for a wide screen, where it stands alone.
        alt: What it shows, for those who cannot see it.
        caption: What to look at.
        facts: Numbers to stand below.
        tuned_friction_Ns_per_m: Cumulative friction in the end, by the published method as its
            authors ran it; nan where the drawing shows something else.
    """

    figure: str
    panel: str = ""
    scenario: str
    plant: str
    seed: int
    path: Path
    alt: str
    caption: str
    facts: tuple[Fact, ...] = ()
    tuned_friction_Ns_per_m: float = math.nan
    wide: Path | None = None

    @property
    def provenance(self) -> str:
        """Where it comes from, in words."""
        if self.plant == "needle":
            return f"`{self.scenario}`, needle without an arm, seed {self.seed}"
        if self.plant == "recording":
            return f"`{self.scenario}`, recording {self.seed}"
        return f"`{self.scenario}`, {self.plant} plant, seed {self.seed}"


# One piece of work for a process of its own, and what comes back.


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
    plants: tuple[str, ...] = ("clean",)
    needs_arm: bool = True

    @property
    def is_recorded(self) -> bool:
        """Whether it reads real data; it has no arm levels then."""
        return bool(self.needs)
