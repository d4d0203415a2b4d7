"""One thing that can be run by name, a job of it, and what becomes of the job."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks import DataError
from benchmarks.results import Figure, Row
from groundtruth import PLANT_MODELS
from needleforce.plots import PageFigure

RECORDING = "recording"
"""The plant of a benchmark on real data."""
NO_PLANT = "no-arm"
"""The plant of a benchmark in which no arm plays a part."""
NEEDLE = "needle"
"""The plant of a simulation without an arm."""
Progress = Callable[[float], None]
"""Takes the fraction done, 0 to 1."""


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
        drawings: Folder for figures; None for none.
    """

    benchmark: str
    plant: str
    case: str = ""
    seed: int = 0
    data: Path | None = None
    drawings: Path | None = None

    @property
    def scenario(self) -> str:
        """Benchmark and case, as its rows name them."""
        case = self.case.replace(", ", "-").replace(" ", "-")
        return f"{self.benchmark}/{case}" if case else self.benchmark

    @property
    def recordings(self) -> Path:
        """The folder of recordings; `DataError` where there is none."""
        if self.data is None:
            raise DataError(f"{self.benchmark} needs recordings")
        return self.data

    @property
    def where(self) -> str:
        """Plant and seed, or recording, in words."""
        words = {RECORDING: "recording", NEEDLE: "needle without an arm, seed"}
        return f"{words.get(self.plant, f'{self.plant} plant, seed')} {self.seed}"

    def __str__(self) -> str:
        """One line for people."""
        return f"{self.scenario}, {self.plant}, seed {self.seed}"


Fact = dict[str, str]
"""One number below a figure, by the head of its column: without a head what it is, then
the published one and those of our runs."""


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
        run: Does a job of it: yields its numbers and, where the job wants them, what
            it has drawn.
        find_cases: Returns the names of its cases, each a job of its own; it may import
            what only they need.
        needs: Folders of recordings it reads; none for a simulation.
        uses_data: Whether it measures more where there is a folder of recordings.
        is_on_arm: Whether its recordings act on a simulated arm, one of its plants.
        recordings: How many recordings it has, one a seed; a simulation takes any
            seed.
        first_seed: The first seed where none is named.
        group: Name under which its kind runs; empty for those that ``all`` names.
        is_default: Whether it runs when nothing is named.
        plants: On which plants a simulation runs when none is named.
        possible: On which plants a simulation can run.
    """

    id: str
    title: str
    run: Callable[[Job, Progress], Iterable[Figure | Drawing]]
    find_cases: Callable[[], Sequence[str]] = lambda: ("",)
    needs: Sequence[str] = ()
    uses_data: bool = False
    is_on_arm: bool = False
    recordings: int = 1
    first_seed: int = 0
    group: str = ""
    is_default: bool = True
    plants: Sequence[str] = ("clean",)
    possible: Sequence[str] = tuple(PLANT_MODELS)

    @property
    def is_recorded(self) -> bool:
        """Whether it reads real data; it has plant models only where `is_on_arm`."""
        return bool(self.needs)

    @property
    def has_plants(self) -> bool:
        """Whether an arm, or the needle without one, plays a part."""
        is_simulated = self.is_on_arm or not self.is_recorded
        return is_simulated and tuple(self.possible) != (NO_PLANT,)


def progress_part(progress: Progress, start: float, end: float) -> Progress:
    """Return progress of a part, 0 to 1, as progress from start to end."""
    return lambda fraction: progress(start + (end - start) * fraction)
