"""A command's log: the mapping of its columns, and its rows as they come."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from needleforce import recordings
from needleforce.cli.shared_options import Columns, Output
from needleforce.cli.terminal import INTERRUPTED, CommandError, progress_bar, say
from needleforce.recordings import ColumnMapping
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.errors import readable_path
from needleforce.recordings.log import LogRows, log_of_table
from needleforce.recordings.mapping import parse_column_spec
from needleforce.recordings.table import STANDARD_STREAM


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
    table = recordings.columns_of(source, mapping)
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
        output: Which files are written.
        request: Which channels are read.
        is_stopped: Whether Ctrl-C has ended the work.

    Attributes:
        name: Name of the log in messages.
        is_stopped: Whether Ctrl-C has ended the work.
        warnings: What was wrong with the log so far.
        log: The log.
    """

    def __init__(
        self,
        source: str,
        output: Output,
        request: ChannelRequest,
        is_stopped: Callable[[], bool],
    ) -> None:
        is_piped = source == STANDARD_STREAM
        self.name = "standard input" if is_piped else Path(source).name
        self.is_stopped = is_stopped
        self.warnings: list[str] = []
        self._shows_progress = output.output != STANDARD_STREAM
        self.log = log_of_table(recordings.read_table(source, request), request)
        self.warn(*self.log.warnings)

    @property
    def exit_code(self) -> int:
        """Exit code of a command that has done its work."""
        return INTERRUPTED if self.is_stopped() else 0

    def __iter__(self) -> Iterator[LogRows]:
        with progress_bar(self.name, is_wanted=self._shows_progress) as progress:
            done = 0
            for rows in self.log.parts():
                yield rows
                done += len(rows.t_s)
                progress(done / len(self.log))
                if self.is_stopped():
                    say("interrupted: the results are those of the rows read so far")
                    return

    def warn(self, *warnings: str) -> None:
        """Report what is wrong with the log, and keep it for a page."""
        self.warnings += warnings
        for warning in warnings:
            say(f"warning: {warning}")
