"""One thing that can be run by name, a job of it, and what the job finds."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from benchmarks import DataError
from benchmarks.rows import Measurement, Row
from groundtruth import PLANT_MODELS
from needleforce.plots import PageFigure

RECORDING = "recording"
"""The plant of a benchmark on real data."""
Progress = Callable[[float], None]
"""Takes the fraction done, 0 to 1."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fact:
    """One number of a figure, the published one beside those of our runs."""

    what: str  # with the unit
    published: str  # as printed there, or said in the text
    here: tuple[tuple[str, str], ...]  # from our runs, by the head of its column


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One benchmark on one plant with one seed: a piece of work for a process of its
    own.
    """

    benchmark: str  # its name
    # plant model of a simulation, ``needle`` for one without an arm, ``recording`` for
    # real data
    plant: str
    seed: int = 0  # of everything drawn; of real data, the number of the recording
    data: Path | None = None  # folder of recordings, for benchmarks that need it
    drawings: Path | None = None  # folder for figures; None for none

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
    """A figure of a run, and the words that go with it."""

    figure: str  # published one to which it is the counterpart, such as ``8``; empty for none
    panel: str = ""  # letter of the panel; empty for none
    job: Job  # the run
    shown: PageFigure  # its files, what it shows, what to look at
    facts: tuple[Fact, ...] = ()  # numbers to stand below


class Findings(NamedTuple):
    """What running a job gives."""

    measurements: list[Measurement]
    drawings: tuple[Drawing, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What became of a job."""

    job: Job  # the job
    rows: tuple[Row, ...] = ()  # its numbers; none when it failed
    drawings: tuple[Drawing, ...] = ()  # the figures it has drawn
    failure: str | None = None  # why it failed, one line


@dataclass(frozen=True, slots=True, kw_only=True)
class Benchmark:
    """One thing that can be run by name."""

    id: str  # permanent name
    title: str  # one line for people
    run: Callable[[Job, Progress], Findings]  # does a job of it
    needs: tuple[str, ...] = ()  # folders of recordings it reads; none for a simulation
    seeds: int = (
        1  # how many recordings it has, one a seed; a simulation takes any seed
    )
    is_default: bool = True  # whether it runs when nothing is named
    plants: tuple[str, ...] = (
        "clean",
    )  # on which plants a simulation runs when none is named
    possible: tuple[str, ...] = tuple(
        PLANT_MODELS
    )  # on which plants a simulation can run
    perturbs: bool = False  # whether its plants are names of perturbations

    @property
    def is_recorded(self) -> bool:
        """Whether it reads real data; it has no plant models then."""
        return bool(self.needs)


def progress_part(progress: Progress, start: float, end: float) -> Progress:
    """Progress of a part, 0 to 1, as progress of the whole from start to end."""
    return lambda fraction: progress(start + (end - start) * fraction)
