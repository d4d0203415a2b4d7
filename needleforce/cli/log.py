"""A command's log and files: mapping, rows as they come, outputs that harm nothing."""

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from needleforce.cli.options import Columns, Output, Reading, Window
from needleforce.cli.terminal import INTERRUPTED, CommandError, StopRequest, progress, say
from recordings import CHANNELS, ColumnMapping, RecordingError, Table, check_writable, load_mapping
from recordings.apart import require_apart as check_output_paths
from recordings.apart import require_apart_from_log as check_output_path
from recordings.bag_storage.files import is_bag
from recordings.bags.plan import survey_table
from recordings.bags.survey import BagSurvey, survey_bag
from recordings.columns.spec import parse_column_spec
from recordings.columns.wanted import Wanted as ChannelRequest
from recordings.command.suggest_mapping import _channel as channel_text
from recordings.command.suggest_mapping import _detected, _told
from recordings.log_stream import LogChunk, LogStream
from recordings.open_table import STANDARD_STREAM, OpenTable, open_table
from recordings.sources.byte_source import Patience as FollowOptions
from recordings.table_stream import is_text, stream_tables
from recordings.tables.labels import Labels

# The mapping, and the log read with it.


def mapping_from_options(columns: Columns) -> ColumnMapping:
    """Return the mapping that options and mapping file give together; options win.

    Raises:
        RecordingError: The mapping file cannot be read, or an option is not valid.
    """
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


class LogSession:
    """Iterates over the log that the command line names; reports on stderr what is wrong with it.

    Ctrl-C ends the log: the rows read so far are all there are. A second one interrupts.

    Args:
        source: A recording, or `-`.
        reading: How long more is waited for.
        request: The channels to read.

    Raises:
        CommandError: A time to wait that is none.
    """

    def __init__(self, source: str, reading: Reading, request: ChannelRequest) -> None:
        idle_s = reading.idle
        if idle_s is not None and not (math.isfinite(idle_s) and idle_s > 0.0):
            raise CommandError(f"--idle {idle_s:g}: expected a number of seconds > 0")
        self._source, self._reading, self._request = source, reading, request
        self._stream: LogStream | None = None
        self._warnings: list[str] = []
        self._stop, self._stack = StopRequest(), ExitStack()

    @property
    def name(self) -> str:
        """What to call the log; bytes of its name that are no text are written as escapes."""
        if self._source == STANDARD_STREAM:
            return "standard input"
        return Path(self._source).name.encode(errors="backslashreplace").decode()

    @property
    def is_live(self) -> bool:
        """Whether rows come as they are recorded, so that results must not wait for the end."""
        is_piped = self._source == STANDARD_STREAM or Path(self._source).is_fifo()
        return self._reading.follow or is_piped

    @property
    def start_ns(self) -> int:
        """The instant of t = 0, see `Table`; known when the first rows are."""
        return 0 if self._stream is None else self._stream.start_ns

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was found wrong with the log so far."""
        return tuple(self._warnings)

    @property
    def is_interrupted(self) -> bool:
        """Whether Ctrl-C has ended the log."""
        return self._stop.is_set

    @property
    def exit_code(self) -> int:
        """Exit code of a command that has done its work: Ctrl-C is how following ends."""
        return INTERRUPTED if self._stop.is_set and not self._reading.follow else 0

    def __enter__(self) -> "LogSession":
        """Listen to Ctrl-C."""
        self._stack.enter_context(self._stop)
        return self

    def __exit__(self, *_: object) -> None:
        """Leave Ctrl-C as it was."""
        self._stack.close()

    def __iter__(self) -> Iterator[LogChunk]:
        """Yield the rows.

        Raises:
            RecordingError: See `LogStream`.
            KeyboardInterrupt: Ctrl-C came before there was a log.
        """
        with progress(self._size(), self.name) as advance:
            options = FollowOptions(
                follow=self._reading.follow,
                idle_s=self._reading.idle,
                should_stop=self._stop,
                advance=advance,
                warn=self._warn,
            )
            request = self._request
            tables = stream_tables(self._source, options, request)
            stream = self._stream = LogStream(
                tables, request.mapping, required=request.required, optional=request.optional
            )
            try:
                for chunk in stream:
                    self._pass_warnings(stream)
                    yield chunk
            except RecordingError:
                self._pass_warnings(stream)
                if self._stop.is_set:
                    raise KeyboardInterrupt from None
                raise
            self._pass_warnings(stream)
        if self.exit_code:
            say("interrupted: the results are those of the rows read so far")

    def _size(self) -> float | None:
        """Bytes in all, if they are known and counted."""
        path = Path(self._source)
        is_counted = path.is_file() and is_text(path) and not self._reading.follow
        return float(path.stat().st_size) if is_counted else None

    def _pass_warnings(self, stream: LogStream) -> None:
        for warning in stream.take_warnings():
            self._warn(warning)

    def _warn(self, warning: str) -> None:
        self._warnings.append(warning)
        say(f"warning: {warning}")


# What a command writes.

PAGE = "index.html"
"""What stands in the folder of a report, beside charts."""
_FIGURES = (".png", ".svg", ".pdf")


def check_outputs(source: str, output: Output) -> None:
    """Refuse now what would fail, or destroy something, after the work is done.

    Raises:
        CommandError: The name of a figure does not end as a figure's.
        FileAccessError: A suffix is not known, a folder is not there, or an output would replace
            the log or another output.
    """
    for option, text in (("--from", output.start), ("--to", output.end)):
        if text is not None:
            log_time(option, text, 0.0)
    outputs: dict[str, Path] = {}
    if output.output is not None:
        check_writable(output.output)
        if output.output != STANDARD_STREAM:
            outputs["-o"] = Path(output.output)
    if output.figure is not None:
        outputs["--figure"] = _checked_figure(output.figure)
    if output.report is not None:
        outputs["--report"] = output.report / PAGE
    if source != STANDARD_STREAM:
        for path in outputs.values():
            check_output_path(path, Path(source))
    check_output_paths(outputs)


def _checked_figure(path: Path) -> Path:
    reason = ""
    if not path.parent.is_dir():
        reason = f"there is no folder {path.parent}"
    elif path.is_dir():
        reason = "it is a folder"
    elif path.exists() and not path.is_file():
        reason = "it is no file"
    elif path.suffix.lower() not in _FIGURES:
        reason = f"the name of a figure must end in {', '.join(_FIGURES)}"
    if reason:
        raise CommandError(f"cannot write {path}: {reason}")
    return path


@contextmanager
def open_output(
    output: Output, log: LogSession, labels: Callable[[], Labels]
) -> Iterator[OpenTable | None]:
    """Open the table that the command line names; yields None if it names none."""
    path = output.output
    if path is None:
        yield None
        return
    is_there = path != STANDARD_STREAM and Path(path).exists()
    with open_table(path, is_live=log.is_live, labels=labels) as table:
        yield table
    if is_there and log.exit_code:
        say(f"warning: {path} holds these rows only; the table that was there is replaced")


def log_time(option: str, text: str, first_s: float) -> float:
    """Return a time that an option says: seconds of the log's clock, after a + since its start.

    Raises:
        CommandError: It is no time.
    """
    text = text.strip()
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CommandError(f"{option}: {text!r} is no time; expected seconds, such as 4 or +4")
    return first_s + value if text.startswith("+") else value


def in_window(columns: Mapping[str, np.ndarray], window: Window) -> dict[str, np.ndarray]:
    """Return the rows that a figure is to show.

    Args:
        columns: With `t_s`, ascending where the clock was not set.
        window: From the options.

    Raises:
        CommandError: No row lies in it.
    """
    t_s = columns["t_s"]
    first_s, low_s, high_s = float(t_s[0]), -math.inf, math.inf
    if window.start is not None:
        low_s = log_time("--from", window.start, first_s)
    if window.end is not None:
        high_s = log_time("--to", window.end, first_s)
    kept = (t_s >= low_s) & (t_s <= high_s)
    if not kept.any():
        raise CommandError(
            f"no row lies between --from {low_s:g} s and --to {high_s:g} s; the log runs from "
            f"{t_s.min():.9g} to {t_s.max():.9g} s"
        )
    return {name: values[kept] for name, values in columns.items()}


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


# A mapping for a given recording, as text to be edited: `--print-config`.


def suggest_mapping(
    source: str,
    channels: Iterable[str],
    *,
    known: ColumnMapping,
    joints: Sequence[str] = (),
    payload: Sequence[str] = (),
) -> str:
    """Return a mapping of a recording as TOML, with what else there is as comments.

    Args:
        source: A recording, or `-`.
        channels: The channels that are looked for, apart from time.
        known: What the user has said already; only the rest is looked for.
        joints: The robot's joints in its order.
        payload: Lines that say what hangs on the robot.

    Raises:
        RecordingError: The recording cannot be read, or lacks a column that the mapping names.
    """
    wanted = list(channels)
    lines = [comment_line(f"Mapping of {Path(source).name}; edit it, then: --mapping FILE"), ""]
    if source != STANDARD_STREAM and is_bag(Path(source)):
        survey = survey_bag(Path(source))
        table = survey_table(survey)
        lines += [*_topic_lines(survey), *_reference_lines(survey, table, wanted, joints)]
    else:
        table = next(stream_tables(source, FollowOptions()))
        wanted = ["time", *wanted] if known.rate_hz is None else wanted
        lines += [] if known.rate_hz is None else [f"rate_hz = {known.rate_hz}", ""]
    lines += [*payload, ""] if payload else []
    return "\n".join([*lines, *mapping_text(table, wanted, known)])


def _topic_lines(survey: BagSurvey) -> list[str]:
    lines = ["# Topics:"]
    for name, found in survey.topics.items():
        what = found.fault or ("source stamps" if found.has_stamp else "stamps of the recorder")
        what = what if found.columns or found.fault else "no numbers"
        count = f"{found.count} messages, {found.rate_hz:.4g} Hz"
        lines.append(comment_line(f"  {name}: {found.topic.kind}, {count}, {what}"))
    return [*lines, *map(comment_line, survey.warnings), ""]


def _reference_lines(
    survey: BagSurvey, table: Table, channels: Iterable[str], joints: Sequence[str]
) -> list[str]:
    """Say whose messages are the rows, and the order of joints."""
    columns = {c.name for name in channels for c in _detected(table, CHANNELS[name])[0]}
    topics = [n for n, found in survey.topics.items() if found.columns.keys() & columns]
    lines = []
    if topics:
        reference = max(topics, key=lambda name: survey.topics[name].count)
        lines = [
            "# Rows are the messages of this topic; others are interpolated to its time stamps.",
            f"clock = {json.dumps(reference)}",
        ]
    here = list(dict.fromkeys(j for n in topics for j in survey.topics[n].joints))
    if here:
        order = joints if joints and set(joints) <= set(here) else here
        lines.append("# Joints in the order of the robot; they are found by these names.")
        if list(order) != list(joints) and joints:
            lines.append(comment_line(f"The robot calls them: {', '.join(joints)}"))
        lines.append(f"joints = {json.dumps(list(order))}")
    return [*lines, ""] if lines else []


def has_channels(source: str, columns: Columns, channels: Iterable[str]) -> bool:
    """Return whether a recording has columns for all of these channels.

    Raises:
        CommandError: The source is a pipe, of which nothing can be read twice.
        RecordingError: The recording cannot be read.
    """
    if source == STANDARD_STREAM or Path(source).is_fifo():
        raise CommandError("a report needs a file, not a pipe; or give --report DIR to force")
    known = mapping_from_options(columns)
    if is_bag(Path(source)):
        table = survey_table(survey_bag(Path(source)))
    else:
        table = next(stream_tables(source, FollowOptions()))
    return all(name in known.channels or _detected(table, CHANNELS[name])[0] for name in channels)


def mapping_text(table: Table, channels: Iterable[str], known: ColumnMapping) -> list[str]:
    lines: list[str] = []
    used: set[str] = set()
    for name in channels:
        lines += [*channel_text(table, CHANNELS[name], known.channels.get(name), used), ""]
    if left := [name for name in table.columns if name not in used]:
        lines += ["# Columns that are not used:"]
        lines += [*(comment_line(f"  {_told(table, name)}") for name in left), ""]
    return lines


def comment_line(text: str) -> str:
    """Return a comment for TOML; names in it come from files and must not end its line."""
    return "# " + "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
