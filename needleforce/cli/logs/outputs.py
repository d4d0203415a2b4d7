"""The files that a command writes about a log, without harm to any other file."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

from needleforce import plots, recordings
from needleforce.cli.logs.log_session import LogSession
from needleforce.cli.shared_options import Output, Over
from needleforce.cli.terminal import CommandError, say, stop_request, write_out
from needleforce.recordings import output as output_files
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.errors import readable_path
from needleforce.recordings.follow import STANDARD_STREAM
from needleforce.recordings.output import OpenTable, open_table
from needleforce.recordings.table import TableLabels

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
        stop_request() as is_stopped,
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
        write_out(result.text(), to_stderr=output.output == STANDARD_STREAM)
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
    output: Output, log: LogSession, labels: TableLabels
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
