"""A command's log: the mapping of its columns, and its rows as they come."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from needleforce import recordings
from needleforce.cli.shared_options import Columns, Output
from needleforce.cli.terminal import INTERRUPTED, CommandError, progress_bar, say
from needleforce.recordings import (
    CHANNELS,
    ColumnMapping,
    FollowOptions,
    LogStream,
    RecordingError,
)
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.errors import readable_path
from needleforce.recordings.follow import STANDARD_STREAM
from needleforce.recordings.log_stream import LogChunk
from needleforce.recordings.mapping import parse_column_spec

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
        return INTERRUPTED if self.is_stopped() and not self._output.follow else 0

    def __iter__(self) -> Iterator[LogChunk]:
        is_table_elsewhere = self._output.output != STANDARD_STREAM and not self.is_live
        with progress_bar(self.name, is_wanted=is_table_elsewhere) as progress:
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
