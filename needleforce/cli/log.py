"""A command's log and files: mapping, rows as they come, outputs that harm nothing."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from needleforce.cli.options import Columns, Output, Reading
from needleforce.cli.terminal import (
    INTERRUPTED,
    CommandError,
    StopRequest,
    progress,
    say,
    write_out,
)
from needleforce.plots import (
    Chart,
    Page,
    PageFigure,
    PageTable,
    Section,
    folder_if_filled,
    require_matplotlib,
    save_figure,
    write_page,
)
from needleforce.recordings import (
    CHANNELS,
    ColumnMapping,
    FollowOptions,
    LogStream,
    RecordingError,
    check_writable,
    load_mapping,
    stream_tables,
)
from needleforce.recordings.errors import file_errors, readable_path
from needleforce.recordings.follow import STANDARD_STREAM
from needleforce.recordings.log import LogChunk
from needleforce.recordings.mapping import ChannelRequest, parse_column_spec
from needleforce.recordings.open_recording import is_text
from needleforce.recordings.output import (
    OpenTable,
    check_output_path,
    check_output_paths,
    open_table,
)
from needleforce.recordings.table import Labels

PAGE = "index.html"
"""What stands in the folder of a report, beside charts."""

# The mapping, and the log read with it.


def mapping_from_options(columns: Columns) -> ColumnMapping:
    """Return the mapping that options and mapping file give together; options win."""
    base = load_mapping(columns.mapping) if columns.mapping else ColumnMapping()
    given = {
        name: parse_column_spec(text, channel)
        for name, channel in CHANNELS.items()
        if (text := getattr(columns, name, None)) is not None
    }
    channels = {**base.channels, **given}
    rate_hz = columns.rate
    if rate_hz is not None and "time" not in given:
        channels.pop("time", None)
    if rate_hz is None and "time" not in given:
        rate_hz = base.rate_hz
    return replace(base, channels=channels, rate_hz=rate_hz)


def has_channels(source: str, columns: Columns, channels: Iterable[str]) -> bool:
    """Return whether a recording has columns for all of these channels."""
    if source == STANDARD_STREAM or readable_path(source).is_fifo():
        raise CommandError("a report needs a file, not a pipe; or give --report DIR to force")
    table = next(stream_tables(source, FollowOptions()))
    request = ChannelRequest(mapping=mapping_from_options(columns), required=tuple(channels))
    return request.columns(table) is not None


class LogSession:
    """Iterates over the log that the command line names; reports on stderr what is wrong with it.

    Args:
        source: A recording, or `-`.
        reading: How long more is waited for.
        request: The channels to read.
        stop: Ends the log: the rows read so far are all there are.

    Attributes:
        name: What to call the log.
        is_live: Whether rows come as they are recorded, so that results must not wait for the end.
        warnings: What was found wrong with the log so far.
    """

    def __init__(
        self, source: str, reading: Reading, request: ChannelRequest, stop: StopRequest
    ) -> None:
        idle_s = reading.idle
        if idle_s is not None and not (math.isfinite(idle_s) and idle_s > 0.0):
            raise CommandError(f"--idle {idle_s:g}: expected a number of seconds > 0")
        self._source, self._reading, self._request = source, reading, request
        is_piped = source == STANDARD_STREAM
        self.name = "standard input" if is_piped else Path(source).name
        self.is_live = reading.follow or is_piped or Path(source).is_fifo()
        self.warnings: list[str] = []
        self._stream: LogStream | None = None
        self._stop = stop

    @property
    def start_ns(self) -> int:
        """The instant of t = 0, see `Table`; known when the first rows are."""
        return 0 if self._stream is None else self._stream.start_ns

    @property
    def is_interrupted(self) -> bool:
        """Whether Ctrl-C has ended the log."""
        return self._stop.is_set

    @property
    def exit_code(self) -> int:
        """Exit code of a command that has done its work: Ctrl-C is how following ends."""
        return INTERRUPTED if self._stop.is_set and not self._reading.follow else 0

    def __iter__(self) -> Iterator[LogChunk]:
        """Yield the rows."""
        path, request = Path(self._source), self._request
        is_counted = path.is_file() and is_text(path) and not self._reading.follow
        size = float(path.stat().st_size) if is_counted else None
        with progress(size, self.name) as advance:
            options = FollowOptions(
                follow=self._reading.follow,
                idle_s=self._reading.idle,
                should_stop=self._stop,
                advance=advance,
                warn=self._warn,
            )
            stream = self._stream = LogStream(
                stream_tables(self._source, options, request),
                request.mapping,
                required=request.required,
                optional=request.optional,
            )
            try:
                for chunk in stream:
                    self._warn(*stream.take_warnings())
                    yield chunk
            except RecordingError:
                self._warn(*stream.take_warnings())
                if self._stop.is_set:
                    raise KeyboardInterrupt from None
                raise
            self._warn(*stream.take_warnings())
        if self.exit_code:
            say("interrupted: the results are those of the rows read so far")

    def _warn(self, *warnings: str) -> None:
        self.warnings += warnings
        for warning in warnings:
            say(f"warning: {warning}")


# From a log to the files that options name.


class Result(Protocol):
    """The outcome of a whole log, of bounded size however long the log."""

    def text(self) -> str:
        """Return what is printed in the end."""
        ...

    def figure(self, output: Output) -> Chart:
        """Return the chart that ``--figure``, ``--over``, ``--from`` and ``--to`` ask for."""
        ...

    def page(self, folder: Path, warnings: Sequence[str]) -> Page:
        """Save the charts of a report in a folder and return the page that shows them."""
        ...


def run_log(
    source: str,
    reading: Reading,
    request: ChannelRequest,
    output: Output,
    estimate: Callable[[LogSession], Result],
) -> int:
    """Read a log, write what was asked for and print the outcome.

    Args:
        source: A recording, or `-`.
        reading: How long more is waited for.
        request: The channels to read.
        output: Files to write.
        estimate: Reads the log to its end and writes the table, see `open_output`.

    Returns:
        The exit code.
    """
    check_outputs(source, output)
    with folder_if_filled(output.report) as folder, StopRequest() as stop:
        log = LogSession(source, reading, request, stop)
        result = estimate(log)
        if output.figure is not None:
            save_figure(result.figure(output), output.figure)
        if folder is not None:
            write_page(folder / PAGE, result.page(folder, log.warnings))
    write_out(result.text(), to_stderr=output.output == STANDARD_STREAM)
    return log.exit_code


def result_page(
    title: str,
    lead: str,
    warnings: Sequence[str],
    figures: tuple[PageFigure, ...],
    results: Section,
    settings: PageTable,
) -> Page:
    """Return the page of a report: figures, results and settings."""
    charts = Section(
        heading="Forces",
        anchor="forces",
        notices=tuple(f"Warning: {text}" for text in warnings),
        figures=figures,
    )
    made = Section(heading="Settings", anchor="settings", tables=(settings,))
    return Page(title=title, lead=(lead,), sections=(charts, results, made))


def check_outputs(source: str, output: Output) -> None:
    """Refuse now what would fail, or destroy something, after the work is done."""
    log_window(output, 0.0)
    named = {
        "-o": output.output if output.output != STANDARD_STREAM else None,
        "--figure": output.figure,
        "--report": output.report and output.report / PAGE,
    }
    outputs = {option: Path(path) for option, path in named.items() if path is not None}
    if output.output is not None:
        check_writable(output.output)
    if output.figure is not None:
        require_matplotlib("--figure", output.figure)
        _require_place(output.figure)
    if source != STANDARD_STREAM:
        log = readable_path(source)
        for path in outputs.values():
            check_output_path(path, log)
    check_output_paths(outputs)


def _require_place(path: Path) -> None:
    with file_errors(path, "write"):
        if path.is_dir():
            raise CommandError(f"cannot write {path}: it is a folder")
        if not path.parent.is_dir():
            raise CommandError(f"cannot write {path}: there is no folder {path.parent}")


@contextmanager
def open_output(
    output: Output, log: LogSession, labels: Callable[[], Labels]
) -> Iterator[OpenTable | None]:
    """Open the table that the command line names; yields None if it names none."""
    path = output.output
    if path is None:
        yield None
        return
    is_there = path != STANDARD_STREAM and Path(path).is_file()
    with open_table(path, is_live=log.is_live, labels=labels) as table:
        yield table
    if is_there and log.exit_code:
        say(f"warning: {path} holds these rows only; the table that was there is replaced")


# Times that options say, and the time axis of figures.

_LATE_CLOCK_S = 1e5
"""Seconds since 1970 would leave an axis no digits for what happened."""


def log_time(option: str, text: str, first_s: float) -> float:
    """Return a time [s] that an option says: on the log's clock, or after a + since its start."""
    text = text.strip()
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CommandError(f"{option}: {text!r} is no time; expected seconds, such as 4 or +4")
    return first_s + value if text.startswith("+") else value


def log_window(output: Output, first_s: float) -> tuple[float, float]:
    """Return the first and last time of a figure [s], infinite where options say nothing."""
    start, end = output.start, output.end
    return (
        -math.inf if start is None else log_time("--from", start, first_s),
        math.inf if end is None else log_time("--to", end, first_s),
    )


def in_window(columns: Mapping[str, np.ndarray], output: Output) -> dict[str, np.ndarray]:
    """Return the rows, with their times `t_s`, that a figure is to show."""
    t_s = columns["t_s"]
    low_s, high_s = log_window(output, float(t_s[0]))
    kept = (t_s >= low_s) & (t_s <= high_s)
    if not kept.any():
        raise CommandError(
            f"no row lies between --from {low_s:.9g} s and --to {high_s:.9g} s; the log runs from "
            f"{t_s.min():.9g} to {t_s.max():.9g} s"
        )
    return {name: values[kept] for name, values in columns.items()}


def time_axis(t_s: np.ndarray) -> tuple[float, str]:
    """Return the log time that is zero in a chart [s], and the label of its axis."""
    first_s = float(t_s[0])
    if abs(first_s) > _LATE_CLOCK_S:
        return first_s, "time since the first sample [s]"
    return 0.0, "time of the log [s]"


# Few rows of a table of any length that look the same in a figure.

MOST_ROWS = 20_000
_NUMBER = "number of the row"


class RowOverview:
    """Keeps, of every stretch of rows, those in which a value is least or largest.

    Short tables are kept whole. When there are too many rows, stretches become twice as long, so
    that memory stays bounded and no spike or rupture is lost.

    Args:
        tracked: The columns whose extremes count.
        most_rows: More are never kept, but for those of one `add`.
    """

    def __init__(self, tracked: Sequence[str], most_rows: int = MOST_ROWS) -> None:
        self._tracked, self._most_rows = tuple(tracked), most_rows
        self._stretch = 1
        self._parts: list[dict[str, np.ndarray]] = []
        self._kept = self._seen = 0

    def add(self, columns: Mapping[str, np.ndarray]) -> None:
        """Take further rows.

        Args:
            columns: Name to values, shape (n,) or (n, k); the same in every call, the tracked
                among them.
        """
        rows = len(next(iter(columns.values())))
        numbers = np.arange(self._seen, self._seen + rows)
        self._seen += rows
        self._append({_NUMBER: numbers, **columns})
        while self._kept > self._most_rows:
            self._stretch *= 2
            whole = self._joined()
            self._parts, self._kept = [], 0
            self._append(whole)

    def columns(self) -> dict[str, np.ndarray]:
        """Return the rows kept, in order; empty before the first `add`."""
        columns = self._joined()
        columns.pop(_NUMBER, None)
        return columns

    def _append(self, columns: dict[str, np.ndarray]) -> None:
        if self._stretch > 1:
            kept = self._extremes(columns)
            columns = {name: values[kept] for name, values in columns.items()}
        self._parts.append({name: np.array(values) for name, values in columns.items()})
        self._kept += len(columns[_NUMBER])

    def _joined(self) -> dict[str, np.ndarray]:
        names = self._parts[0] if self._parts else ()
        return {name: np.concatenate([part[name] for part in self._parts]) for name in names}

    def _extremes(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the indices of the rows to keep, ascending."""
        stretch = columns[_NUMBER] // self._stretch
        starts = np.flatnonzero(np.diff(stretch, prepend=-1))
        of_row = np.cumsum(np.diff(stretch, prepend=-1) != 0) - 1
        kept = [starts]
        tracked = [np.atleast_2d(columns[name].T) for name in self._tracked]
        for values in np.concatenate(tracked, dtype=np.float64):
            for sign in (1.0, -1.0):
                signed = np.where(np.isnan(values), np.inf, sign * values)
                least = np.minimum.reduceat(signed, starts)
                hits = np.flatnonzero(signed == least[of_row])
                kept.append(hits[np.unique(of_row[hits], return_index=True)[1]])
        return np.unique(np.concatenate(kept))
