"""Files that a command writes about a log, without harm to any other file."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from needleforce import plots, recordings
from needleforce.cli.logs.log_session import LogSession
from needleforce.cli.shared_options import Output, Over
from needleforce.cli.terminal import (
    CommandError,
    aligned,
    say,
    stop_request,
    write_out,
)
from needleforce.recordings import output as output_files
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.errors import readable_path
from needleforce.recordings.output import OpenTable, open_table
from needleforce.recordings.table import STANDARD_STREAM, TableLabels

NOTE = "Research only: not a medical device."


class Answer(NamedTuple):
    """How the page of a report begins.

    Attributes:
        sentences: What was found.
        warnings: What makes it doubtful.
        tables: What was found, in numbers.
    """

    sentences: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    tables: tuple[plots.PageTable, ...] = ()


class LogPage(Protocol):
    """What is shown of the result of a whole log."""

    def text(self) -> str:
        """Return the summary that is printed."""
        ...

    def chart(self, over: Over) -> plots.Chart:
        """Return the figure over time or depth."""
        ...

    @property
    def title(self) -> str:
        """What the page of a report shows."""
        ...

    def answer(self) -> Answer:
        """Return what was found: how the page of a report begins."""
        ...

    def sections(self, folder: Path) -> tuple[plots.Section, ...]:
        """Save the charts of a report in a folder; return the sections of its page."""
        ...

    def settings(self) -> tuple[plots.Section, ...]:
        """Return the settings used: how the page of a report ends."""
        ...


def run_log(
    source: str,
    output: Output,
    request: ChannelRequest,
    estimate: Callable[[LogSession], LogPage],
) -> int:
    """Read a log, write what was asked for, and print the result.

    Args:
        source: The log as the command line names it.
        output: How long it is read, and which files are written.
        request: Which channels are read.
        estimate: Reads the log to its end and writes the table, see `open_output`.

    Returns:
        The exit code.
    """
    check_outputs(source, output)
    # Half a log is no report: Ctrl-C leaves the page that was there.
    stopping = stop_request() if output.report is None else nullcontext(lambda: False)
    with plots.whole_folder(output.report) as folder, stopping as is_stopped:
        log = LogSession(source, output, request, is_stopped)
        page = estimate(log)
        if folder is not None:
            _write_report(page, log, folder)
    try:
        if output.figure is not None:
            chart = _cut_to_window(page.chart(output.over), output)
            plots.save_figure(chart, output.figure)
    finally:  # a figure that cannot be drawn costs no result
        text = page.text() + _channel_lines(log)
        if output.report is not None:
            text += f"\npage: {output.report / plots.PAGE}\n"
        write_out(text, to_stderr=output.output == STANDARD_STREAM)
    return log.exit_code


def _write_report(page: LogPage, log: LogSession, folder: Path) -> None:
    """Write the page of a log: what was found and what is doubtful, settings last."""
    answer = page.answer()
    warnings = (*log.warnings, *answer.warnings)
    document = plots.Page(
        title=f"{page.title} from {log.name}",
        lead=(*answer.sentences, NOTE),
        notices=tuple(f"Warning: {text}" for text in warnings),
        tables=answer.tables,
        sections=(*page.sections(folder), _channel_section(log), *page.settings()),
    )
    plots.write_page(folder / plots.PAGE, document)


def _channel_lines(log: LogSession) -> str:
    """Return the unit in which each channel was read as lines below a result."""
    lines = [(unit.channel, str(unit)) for unit in log.log.units]
    return f"\n{aligned([('channel', 'read as'), *lines])}" if lines else ""


def _channel_section(log: LogSession) -> plots.Section:
    """Return the unit in which each channel was read as a section of a page."""
    table = plots.PageTable(
        caption="In which unit each channel was read, and whence that is known",
        head=("channel", "columns"),
        rows=tuple((unit.channel, str(unit)) for unit in log.log.units),
    )
    return plots.Section(heading="Channels", anchor="channels", tables=(table,))


def refuse_report(source: str, output: Output) -> None:
    """Name the command that writes pages where another one is asked for a page.

    Raises:
        CommandError: A folder for a page is named.
    """
    if output.report is not None:
        file = "FILE" if source == STANDARD_STREAM else source
        raise CommandError(
            f"--report {output.report}: pages are written by `needleforce report "
            f"{file} {output.report}`, with the same options but -o and --figure"
        )


def _window_of(output: Output) -> tuple[float, float]:
    """Return what ``--from`` and ``--to`` say of the x axis, infinite if nothing."""
    start = -math.inf if output.start is None else output.start
    end = math.inf if output.end is None else output.end
    return start, end


def _cut_to_window(chart: plots.Chart, output: Output) -> plots.Chart:
    """Return what ``--from`` and ``--to`` leave of a chart; refuse to draw nothing."""
    first, last = _window_of(output)
    low, high = chart.x_limits or (-math.inf, math.inf)
    is_unlimited = math.isinf(low) and math.isinf(high)
    if is_unlimited or (output.start is None and output.end is None):
        return chart
    start = max(low, first)
    end = min(high, last)
    if not start < end:
        raise CommandError(
            f"no figure from {first:g} to {last:g}: its axis, "
            f"{chart.x_label}, runs from {low:g} to {high:g}; expected --from and --to "
            "within that"
        )
    return chart.within(start, end)


def check_outputs(source: str, output: Output) -> None:
    """Refuse now what would fail, or destroy something, after the work is done.

    Raises:
        CommandError: The window of the figure is empty.
        RecordingError: A file cannot be written, or is the log itself.
    """
    start, end = _window_of(output)
    if not start < end:
        raise CommandError(
            f"--from {start:g} --to {end:g}: expected --from before --to"
        )
    table = None if output.output == STANDARD_STREAM else output.output
    named: dict[str, Any] = {"-o": table, "--figure": output.figure}
    if output.report is not None:
        named[f"DIR ({plots.PAGE})"] = output.report / plots.PAGE
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
    """Open the table that the command line names; None if it names none.

    Args:
        output: Which files are written.
        log: The log, whose clock the table has.
        labels: What goes with the columns.
    """
    path = output.output
    if path is None:
        yield None
        return
    replaces_table = path != STANDARD_STREAM and Path(path).is_file()
    labels = replace(labels, start_ns=log.log.start_ns)
    with open_table(path, labels=lambda: labels) as table:
        yield table
    if replaces_table and log.exit_code:
        say(
            f"warning: {path} holds these rows only; the table that was there is "
            "replaced"
        )
