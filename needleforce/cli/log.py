"""A command's log and files: mapping, rows as they come, outputs that harm nothing."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from needleforce import plots, recordings
from needleforce.cli import terminal
from needleforce.cli.options import Columns, Output, Over
from needleforce.cli.terminal import CommandError, say
from needleforce.recordings import (
    CHANNELS,
    ColumnMapping,
    FollowOptions,
    LogStream,
    RecordingError,
)
from needleforce.recordings import output as output_files
from needleforce.recordings.errors import readable_path
from needleforce.recordings.follow import STANDARD_STREAM
from needleforce.recordings.log import LogChunk
from needleforce.recordings.mapping import ChannelRequest, parse_column_spec
from needleforce.recordings.output import OpenTable, open_table
from needleforce.recordings.table import Labels

# The mapping, and the log read with it.


def mapping_from_options(columns: Columns) -> ColumnMapping:
    """Return the mapping that options and mapping file give together; options win."""
    base = (
        recordings.load_mapping(columns.mapping) if columns.mapping else ColumnMapping()
    )
    given = {
        name: parse_column_spec(text, channel)
        for name, channel in CHANNELS.items()
        if (text := getattr(columns, name, None)) is not None
    }
    channels = {**base.channels, **given}
    rate_hz = columns.rate
    if "time" not in given:
        if rate_hz is not None:
            channels.pop("time", None)
        else:
            rate_hz = base.rate_hz
    return replace(base, channels=channels, rate_hz=rate_hz)


def has_channels(source: str, columns: Columns, channels: Iterable[str]) -> bool:
    """Return whether a recording has columns for all of these channels."""
    if source == STANDARD_STREAM or readable_path(source).is_fifo():
        raise CommandError(
            "a report needs a file, not a pipe; or give --report DIR to force"
        )
    table = next(recordings.stream_tables(source, FollowOptions()))
    mapping = mapping_from_options(columns)
    asked = tuple(channels)
    try:
        return ChannelRequest(mapping, asked).columns(table) is not None
    except recordings.ColumnError:
        layers = ChannelRequest(mapping, ("depth", "force"))
        if mapping.channels.keys() & {*asked} or layers.columns(table) is None:
            raise
        return False  # `identify` asks for no joints, so it does not matter how many might fit


class LogSession:
    """Iterates over the log of the command line; reports on stderr what is wrong
    with it.
    """

    def __init__(
        self,
        source: str,
        output: Output,
        request: ChannelRequest,
        is_stopped: Callable[[], bool],
    ) -> None:
        if output.idle is not None and not 0.0 < output.idle < math.inf:
            raise CommandError(
                f"--idle {output.idle:g}: expected a number of seconds > 0"
            )
        self._source = source
        self._output = output
        self._request = request
        is_piped = source == STANDARD_STREAM
        self.name = "standard input" if is_piped else Path(source).name
        # Rows come as they are recorded, and results must not wait for the end.
        self.is_live = output.follow or is_piped or Path(source).is_fifo()
        self.is_stopped = is_stopped  # whether Ctrl-C has ended the log
        self.warnings: list[str] = []
        self.start_ns = 0  # see `Table`; known when the first rows are

    @property
    def exit_code(self) -> int:
        """Exit code of a command that has done its work: Ctrl-C is how following
        ends.
        """
        return (
            terminal.INTERRUPTED if self.is_stopped() and not self._output.follow else 0
        )

    def __iter__(self) -> Iterator[LogChunk]:
        is_table_elsewhere = self._output.output != STANDARD_STREAM and not self.is_live
        with terminal.progress_bar(self.name, is_wanted=is_table_elsewhere) as progress:
            request = self._request
            options = FollowOptions(
                follow=self._output.follow,
                idle_s=self._output.idle,
                should_stop=self.is_stopped,
                progress=progress,
                warn=self._warn,
            )
            tables = recordings.stream_tables(self._source, options, request)
            stream = LogStream(tables, request)
            try:
                for chunk in stream:
                    self.start_ns = stream.start_ns
                    self._warn(*stream.take_warnings())
                    yield chunk
            except RecordingError:
                if self.is_stopped():
                    raise KeyboardInterrupt from None
                raise
            finally:
                self._warn(*stream.take_warnings())
        if self.exit_code:
            say("interrupted: the results are those of the rows read so far")

    def _warn(self, *warnings: str) -> None:
        self.warnings += warnings
        for warning in warnings:
            say(f"warning: {warning}")


# From a log to the files that options name.


class Result(Protocol):
    """The outcome of a whole log, whatever was looked for in it."""

    def text(self) -> str:
        """Return the summary that is printed."""
        ...

    def chart(self, over: Over) -> plots.Chart:
        """Return the figure over time or depth."""
        ...

    def sections(self, folder: Path) -> tuple[plots.Section, ...]:
        """Save the charts of a report in a folder and return the sections of its
        page.
        """
        ...


def run_log(
    source: str,
    output: Output,
    request: ChannelRequest,
    estimate: Callable[[LogSession], Result],
) -> int:
    """Read a log, write what was asked for, print the outcome and return the exit code.

    ``estimate`` reads the log to its end and writes the table, see `open_output`.
    """
    check_outputs(source, output)
    with (
        plots.folder_if_filled(output.report) as folder,
        terminal.stop_request() as is_stopped,
    ):
        log = LogSession(source, output, request, is_stopped)
        result = estimate(log)
        if folder is not None:
            first, *others = result.sections(folder)
            notices = (*(f"Warning: {text}" for text in log.warnings), *first.notices)
            sections = (replace(first, notices=notices), *others)
            title = f"{first.heading} from {log.name}"
            plots.write_page(
                folder / plots.PAGE, plots.Page(title=title, sections=sections)
            )
    try:
        if output.figure is not None:
            plots.save_figure(
                _in_window(result.chart(output.over), output), output.figure
            )
    finally:  # a figure that cannot be drawn costs no result
        terminal.write_out(result.text(), to_stderr=output.output == STANDARD_STREAM)
    return log.exit_code


def _window(output: Output) -> tuple[float, float]:
    start = output.start
    end = output.end
    return -math.inf if start is None else start, math.inf if end is None else end


def _in_window(chart: plots.Chart, output: Output) -> plots.Chart:
    """Return what ``--from`` and ``--to`` leave of a chart; refuse to draw nothing."""
    start, end = _window(output)
    low, high = chart.x_limits or (-math.inf, math.inf)
    if (low, high) == (-math.inf, math.inf) or (output.start, output.end) == (
        None,
        None,
    ):
        return chart
    if not max(low, start) < min(high, end):
        raise CommandError(
            f"no figure from {start:g} to {end:g}: its axis, {chart.x_label}, runs from {low:g} "
            f"to {high:g}; give --from and --to within that"
        )
    return chart.within(max(low, start), min(high, end))


_CHARTS = ("forces-over-time", "forces-over-depth", "layers")
_IN_REPORT = (
    plots.PAGE,
    *(f"{name}{end}.svg" for name in _CHARTS for end in ("", "-wide")),
)


def check_outputs(source: str, output: Output) -> None:
    """Refuse now what would fail, or destroy something, after the work is done."""
    start, end = _window(output)
    if not start < end:
        raise CommandError(
            f"--from {start:g} --to {end:g}: expected --from before --to"
        )
    table = None if output.output == STANDARD_STREAM else output.output
    named: dict[str, Any] = {"-o": table, "--figure": output.figure}
    if output.report is not None:
        named |= {f"--report ({name})": output.report / name for name in _IN_REPORT}
    paths = {option: Path(path) for option, path in named.items() if path is not None}
    if output.output is not None:
        recordings.check_writable(output.output)
    if output.figure is not None:
        plots.require_matplotlib("--figure", output.figure)
        output_files.require_place(output.figure)
    # Standard input may be a file, too: `< log.csv`.
    place = Path("/dev/stdin") if source == STANDARD_STREAM else readable_path(source)
    output_files.check_outputs(paths, place)


@contextmanager
def open_output(
    output: Output, log: LogSession, labels: Labels
) -> Iterator[OpenTable | None]:
    """Open the table that the command line names, on the log's clock; None if it
    names none.
    """
    path = output.output
    if path is None:
        yield None
        return
    is_there = path != STANDARD_STREAM and Path(path).is_file()
    with open_table(
        path, is_live=log.is_live, labels=lambda: replace(labels, start_ns=log.start_ns)
    ) as table:
        yield table
    if is_there and log.exit_code:
        say(
            f"warning: {path} holds these rows only; the table that was there is replaced"
        )


# Figures: their axis, and few rows of a log of any length that look the same.

LATE_CLOCK_S = 1e5  # seconds since 1970 would leave an axis no digits for what happened
MOST_ROWS = 20_000  # more rows than these are thinned for a figure


def time_axis(t_s: np.ndarray) -> tuple[float, str]:
    """Return the log time that is zero in a chart [s], and the label of its axis."""
    first_s = float(t_s[0])
    if abs(first_s) > LATE_CLOCK_S:
        return first_s, "time since the first sample [s]"
    return 0.0, "time of the log [s]"


def span(x: np.ndarray) -> tuple[float, float] | None:
    """Return the limits of an axis, None for one of nothing."""
    x = x[np.isfinite(x)]
    return (float(x.min()), float(x.max())) if len(x) else None


_NUMBER = "number of the row"


class RowOverview:
    """Keeps rows for a figure: all of a short log, else those with the extremes of
    each stretch.
    """

    def __init__(self, tracked: Sequence[str], most_rows: int = MOST_ROWS) -> None:
        self._tracked = tuple(tracked)
        self._most_rows = most_rows
        self._parts: list[dict[str, np.ndarray]] = []
        self._seen = self._kept = 0

    def add(self, columns: Mapping[str, np.ndarray]) -> None:
        """Take further rows, columns of shape (n,) or (n, k); the same in every
        call.
        """
        rows = len(next(iter(columns.values())))
        self._parts.append(
            {_NUMBER: np.arange(self._seen, self._seen + rows), **columns}
        )
        self._seen = self._seen + rows
        self._kept = self._kept + rows
        if self._kept > 10 * self._most_rows:
            self._parts = [self.columns()]
            self._kept = len(self._parts[0][_NUMBER])

    def columns(self) -> dict[str, np.ndarray]:
        """Return the rows kept, in order; empty before the first `add`."""
        names = self._parts[0] if self._parts else ()
        whole = {
            name: np.concatenate([part[name] for part in self._parts]) for name in names
        }
        if self._kept <= self._most_rows:
            return whole
        values = np.column_stack([whole[name] for name in self._tracked]).astype(
            np.float64
        )
        # In stretches of equal length of the log: the first row, and every least and
        # largest value.
        stretches = max(self._most_rows // (2 * values.shape[1] + 1), 1)
        numbers = np.arange(stretches) * self._seen // stretches
        edges = np.unique(np.searchsorted(whole[_NUMBER], numbers))
        kept = [edges := edges[edges < self._kept]]
        for first, stretch in zip(edges, np.split(values, edges[1:]), strict=True):
            kept.append(
                first + np.where(np.isnan(stretch), np.inf, stretch).argmin(axis=0)
            )
            kept.append(
                first + np.where(np.isnan(stretch), -np.inf, stretch).argmax(axis=0)
            )
        chosen = np.unique(np.concatenate(kept))
        return {name: column[chosen] for name, column in whole.items()}
