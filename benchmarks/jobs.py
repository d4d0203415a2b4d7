"""One thing that can be run by name, a job of it, and what the job finds."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from benchmarks import DataError
from benchmarks.results import Measurement, Row
from groundtruth import PLANT_MODELS
from needleforce.plots import PageFigure

RECORDING = "recording"
"""The plant of a benchmark on real data."""
Progress = Callable[[float], None]
"""Takes the fraction done, 0 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fact:
    """One number of a figure, the published one beside those of our runs.

    Attributes:
        what: With the unit.
        published: As printed there, or said in the text.
        here: From our runs, by the head of its column.
    """

    what: str
    published: str
    here: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One benchmark on one plant with one seed: a piece of work for a process of its
    own.

    Attributes:
        benchmark: Its name.
        plant: Plant model of a simulation, ``needle`` for one without an arm,
            ``recording`` for real data.
        seed: Of everything drawn; of real data, the number of the recording.
        data: Folder of recordings, for benchmarks that need it.
        drawings: Folder for figures; None for none.
    """

    benchmark: str
    plant: str
    seed: int = 0
    data: Path | None = None
    drawings: Path | None = None

    @property
    def recordings(self) -> Path:
        """The folder of recordings; `DataError` where there is none."""
        if self.data is None:
            raise DataError(f"{self.benchmark} needs recordings: give --data DIR")
        return self.data

    @property
    def where(self) -> str:
        """Plant and seed, or recording, in words."""
        words = {RECORDING: "recording", "needle": "needle without an arm, seed"}
        return f"{words.get(self.plant, f'{self.plant} plant, seed')} {self.seed}"

    def __str__(self) -> str:
        """One line for people."""
        return f"{self.benchmark}, {self.plant}, seed {self.seed}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """A figure of a run, and the words that go with it.

    Attributes:
        figure: Published one to which it is the counterpart, such as ``8``; empty for
            none.
        panel: Letter of the panel; empty for none.
        job: The run.
        shown: Its files, what it shows, what to look at.
        facts: Numbers to stand below.
    """

    figure: str
    panel: str = ""
    job: Job
    shown: PageFigure
    facts: tuple[Fact, ...] = ()


class Findings(NamedTuple):
    """What running a job gives."""

    measurements: list[Measurement]
    drawings: tuple[Drawing, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a job.

    Attributes:
        job: The job.
        rows: Its numbers; none when it failed.
        drawings: The figures it has drawn.
        failure: Why it failed, one line.
    """

    job: Job
    rows: tuple[Row, ...] = ()
    drawings: tuple[Drawing, ...] = ()
    failure: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """One thing that can be run by name.

    Attributes:
        id: Permanent name.
        title: One line for people.
        run: Does a job of it.
        needs: Folders of recordings it reads; none for a simulation.
        is_default: Whether it runs when nothing is named.
        plants: On which plants a simulation runs when none is named.
        possible: On which plants a simulation can run.
        perturbs: Whether its plants are names of perturbations.
    """

    id: str
    title: str
    run: Callable[[Job, Progress], Findings]
    needs: tuple[str, ...] = ()
    seeds: int = (
        1  # how many recordings it has, one a seed; a simulation takes any seed
    )
    is_default: bool = True
    plants: tuple[str, ...] = ("clean",)
    possible: tuple[str, ...] = tuple(PLANT_MODELS)
    perturbs: bool = False

    @property
    def is_recorded(self) -> bool:
        """Whether it reads real data; it has no plant models then."""
        return bool(self.needs)


def progress_part(progress: Progress, start: float, end: float) -> Progress:
    """Progress of a part, 0 to 1, as progress of the whole from start to end."""
    return lambda fraction: progress(start + (end - start) * fraction)
