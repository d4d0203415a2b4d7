"""How fast the commands go through a long recording, and whether their memory grows."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.errors import BenchmarkError
from benchmarks.speed.late_rows import LATE_ROWS, LateRows, late_rows
from benchmarks.speed.long_recording import FREE_S, Columns, joint_recording, needle_recording
from benchmarks.speed.watched_process import Watched, watch_process
from recordings import RecordingError
from recordings.open_table import open_table

LEAST_TIMES_REAL = 20.0
"""Times real time, on one core."""

MOST_GROWTH_MB = 20.0
"""From a tenth of the recording to its end; interpreters and allocators breathe."""

LEAST_SECONDS = 2.0 * FREE_S


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamCase:
    """A command on a recording.

    Attributes:
        command: ``residual`` or ``identification``.
        suffix: Of the recording; results are written as CSV.
    """

    command: str
    suffix: str


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamSpeed:
    """What it needed.

    Attributes:
        case: Which command on what.
        seconds: Length of the recording [s].
        rows: Of the recording.
        watched: Time and memory.
        late: What was found at the end: a command that idles is fast.
    """

    case: StreamCase
    seconds: float
    rows: int
    watched: Watched
    late: LateRows

    @property
    def is_busy(self) -> bool:
        """Whether no late row was skipped and ruptures went on; a short recording may have none."""
        is_alive = self.late.ruptures != 0 or self.rows < 2 * LATE_ROWS
        return is_alive and self.late.skipped == 0

    @property
    def times_real(self) -> float:
        """Length of the recording over time on the processor."""
        return self.seconds / self.watched.cpu_s

    @property
    def growth_MB(self) -> float:
        """Memory at the end over that at a tenth of the time [MB]; nan if unknown."""
        return self.watched.memory_at(1.0) - self.watched.memory_at(0.1)

    @property
    def is_met(self) -> bool:
        """Whether both targets are, without idling; unknown memory counts as a miss."""
        is_fast = self.times_real >= LEAST_TIMES_REAL
        return is_fast and self.growth_MB <= MOST_GROWTH_MB and self.is_busy


_RECORDINGS: dict[str, Callable[[float, np.random.Generator], Iterator[Columns]]] = {
    "residual": joint_recording,
    "identification": needle_recording,
}
COMMANDS = tuple(_RECORDINGS)


def measure_stream(
    case: StreamCase, seconds: float, folder: Path | None, tell: Callable[[float], None]
) -> StreamSpeed:
    """Make a recording and send it through the command.

    Args:
        case: Which command on what.
        seconds: Length of the recording [s], at least `LEAST_SECONDS`.
        folder: Where the files lie while it runs; None for the system's place.
        tell: Told the share done so far, roughly.

    Raises:
        BenchmarkError: The files cannot be written, or the command failed.
    """
    rng = np.random.default_rng(0)
    try:
        with TemporaryDirectory(dir=folder) as place:
            log = Path(place) / f"log{case.suffix}"
            rows = 0
            with open_table(log) as table:
                for columns in _RECORDINGS[case.command](seconds, rng):
                    table.append(columns)
                    rows += len(columns["t_s"])
                    tell(0.3 * rows / (seconds * 1000.0))
            options = ["--tare", f"0:{FREE_S:g}"] if case.command == "residual" else []
            out = Path(place) / "out.csv"
            expected_s = seconds / LEAST_TIMES_REAL
            watched = watch_process(
                ["-m", case.command, str(log), *options, "-o", str(out)],
                lambda passed_s: tell(0.3 + 0.7 * min(passed_s / expected_s, 1.0)),
            )
            late = late_rows(out)
    except (OSError, RecordingError) as error:
        raise BenchmarkError(f"no recording to stream: {error}") from error
    return StreamSpeed(case=case, seconds=seconds, rows=rows, watched=watched, late=late)
