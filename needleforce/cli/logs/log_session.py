"""A command's log: the mapping of its columns, and its rows as they come."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from needleforce import recordings
from needleforce.cli.shared_options import Columns, Output
from needleforce.cli.terminal import INTERRUPTED, CommandError, progress_bar, say
from needleforce.recordings import (
    ColumnMapping,
    FollowOptions,
    LogStream,
    RecordingError,
)
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channel_units import ChannelUnit
from needleforce.recordings.errors import readable_path
from needleforce.recordings.follow import STANDARD_STREAM
from needleforce.recordings.log_stream import LogChunk
from needleforce.recordings.mapping import parse_column_spec
from needleforce.recordings.stamp_order import SORTED_WITHIN_S
from needleforce.recordings.table import ToolMass


def mapping_from_options(columns: Columns) -> ColumnMapping:
    """Return the mapping that options and mapping file give together; options win."""
    knowledge = recordings.load_layouts(*columns.layout)
    base = ColumnMapping(knowledge=knowledge)
    if columns.mapping:
        base = recordings.load_mapping(columns.mapping, knowledge)
    from_options = {
        name: parse_column_spec(text, channel)
        for name, channel in knowledge.channels.items()
        if (text := getattr(columns, name, None)) is not None
    }
    channels = {**base.channels, **from_options}
    rate_hz = columns.rate
    if "time" not in from_options:
        if rate_hz is not None:
            channels.pop("time", None)
        else:
            rate_hz = base.rate_hz
    sort_within_s = columns.sort_within
    if sort_within_s is None:
        sort_within_s = base.sort_within_s
    joints = getattr(columns, "joints", None) or base.joints
    return replace(
        base,
        joints=joints,
        channels=channels,
        rate_hz=rate_hz,
        sort_within_s=sort_within_s,
    )


def has_channels(source: str, columns: Columns, channels: Iterable[str]) -> bool:
    """Return whether a recording has columns for all of these channels.

    Args:
        source: The recording as the command line names it.
        columns: Which columns are which channels.
        channels: Names of channels.

    Raises:
        CommandError: The recording is a pipe, which can be read only once.
        ColumnError: It has columns for neither these channels nor depth and force.
    """
    if source == STANDARD_STREAM or readable_path(source).is_fifo():
        raise CommandError(
            "a report needs a file, not a pipe: write what comes into a file first"
        )
    mapping = mapping_from_options(columns)
    tables = recordings.stream_tables(
        source, FollowOptions(), knowledge=mapping.knowledge
    )
    table = next(tables)
    required = tuple(channels)
    try:
        return ChannelRequest(mapping, required).columns(table) is not None
    except recordings.ColumnError:
        layers = ChannelRequest(mapping, ("depth", "force"))
        if mapping.channels.keys() & {*required} or layers.columns(table) is None:
            raise
        # `identify` asks for no joints, so it does not matter how many might fit.
        return False


class LogSession:
    """The log of the command line; iterating yields its rows.

    What is wrong with the log is reported on stderr.

    Args:
        source: The log as the command line names it.
        output: How long it is read.
        request: Which channels are read.
        is_stopped: Whether Ctrl-C has ended the log.

    Attributes:
        name: Name of the log in messages.
        is_live: Rows come as they are recorded, and results must not wait for the end.
        is_stopped: Whether Ctrl-C has ended the log.
        warnings: What was wrong with the log so far.
        start_ns: Start of the log's clock, see `Table`; known with the first rows.
        tool_mass: What the log says hangs on the flange; likewise.
        bad_stamp_count: Rows that were left out so far for a bad time stamp.
        units: In which unit each channel is read; known with the first rows.

    Raises:
        CommandError: The time of ``--idle`` is not positive.
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
        is_piped = source == STANDARD_STREAM
        self.name = "standard input" if is_piped else Path(source).name
        self.is_live = output.follow or is_piped or Path(source).is_fifo()
        self.is_stopped = is_stopped
        self.warnings: list[str] = []
        self.start_ns = 0
        self.tool_mass: ToolMass | None = None
        self.bad_stamp_count = 0
        self.units: tuple[ChannelUnit, ...] = ()
        self._source = source
        self._output = output
        self._request = request

    @property
    def exit_code(self) -> int:
        """Exit code of a command that has done its work.

        Ctrl-C is how following ends; else it is an interruption.
        """
        was_interrupted = self.is_stopped() and not self._output.follow
        return INTERRUPTED if was_interrupted else 0

    def __iter__(self) -> Iterator[LogChunk]:
        is_table_elsewhere = self._output.output != STANDARD_STREAM and not self.is_live
        with progress_bar(self.name, is_wanted=is_table_elsewhere) as progress:
            options = FollowOptions(
                follow=self._output.follow,
                idle_s=self._output.idle,
                should_stop=self.is_stopped,
                progress=progress,
                warn=self.warn,
            )
            tables = recordings.stream_tables(self._source, options, self._request)
            # Rows that come live are used at once.
            sorted_within_s = 0.0 if self.is_live else SORTED_WITHIN_S
            yield from self._chunks(LogStream(tables, self._request, sorted_within_s))
        if self.exit_code:
            say("interrupted: the results are those of the rows read so far")

    def _chunks(self, stream: LogStream) -> Iterator[LogChunk]:
        """Yield the rows of a stream, and report its warnings."""
        try:
            for chunk in stream:
                self.start_ns = stream.start_ns
                self.tool_mass = stream.tool_mass
                self.units = stream.units
                self.warn(*stream.take_warnings())
                yield chunk
        except RecordingError:
            if self.is_stopped():
                raise KeyboardInterrupt from None
            raise
        finally:
            self.bad_stamp_count = stream.bad_stamp_count
            self.warn(*stream.take_warnings())

    def warn(self, *warnings: str) -> None:
        """Report what is wrong with the log, and keep it for a page."""
        self.warnings += warnings
        for warning in warnings:
            say(f"warning: {warning}")
