"""A command reads its log: mapping, Ctrl-C, warnings and progress bar in one place."""

from argparse import Namespace
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path

from recordings.columns.wanted import Wanted
from recordings.command.mapping_arguments import mapping_from_arguments
from recordings.command.progress import progress
from recordings.command.run_command import INTERRUPTED, say
from recordings.command.stop_request import StopRequest
from recordings.errors import RecordingError
from recordings.log_stream import LogChunk, LogStream
from recordings.open_table import STANDARD_STREAM
from recordings.sources.byte_source import Patience
from recordings.table_stream import is_text, stream_tables


class LogSession:
    """Iterates over the log that the command line names; says on stderr what is wrong with it.

    Ctrl-C ends the log: the rows read so far are all there are. A second one interrupts.

    Args:
        arguments: of a parser with `source_arguments` and `mapping_arguments`.
        required: see `read_log`.
        optional: see `read_log`.
        joints: see `read_log`.

    Raises:
        RecordingError: the mapping is not valid.
    """

    def __init__(
        self,
        arguments: Namespace,
        *,
        required: Iterable[str],
        optional: Iterable[str],
        joints: Iterable[str] = (),
    ) -> None:
        self._source = arguments.log
        self._follow, self._idle_s = arguments.follow, arguments.idle
        self._wanted = Wanted(
            mapping=mapping_from_arguments(arguments),
            required=tuple(required),
            optional=tuple(optional),
            joints=tuple(joints),
        )
        self._stream: LogStream | None = None
        self._warnings: list[str] = []
        self._stop, self._stack = StopRequest(), ExitStack()

    @property
    def name(self) -> str:
        """What to call the log."""
        return "standard input" if self._source == STANDARD_STREAM else Path(self._source).name

    @property
    def is_live(self) -> bool:
        """Whether rows come as they are recorded, so that results must not wait for the end."""
        return self._follow or self._source == STANDARD_STREAM or Path(self._source).is_fifo()

    @property
    def start_ns(self) -> int:
        """The instant of t = 0, see `Table`; known when the first rows are."""
        return 0 if self._stream is None else self._stream.start_ns

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was said about the log so far."""
        return tuple(self._warnings)

    @property
    def is_interrupted(self) -> bool:
        """Whether Ctrl-C has ended the log."""
        return self._stop.is_set

    @property
    def exit_code(self) -> int:
        """Exit code of a command that has done its work: Ctrl-C is how following ends."""
        return INTERRUPTED if self._stop.is_set and not self._follow else 0

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
            RecordingError: see `LogStream`.
            KeyboardInterrupt: Ctrl-C came before there was a log.
        """
        with progress(self._size(), self.name) as advance:
            patience = Patience(
                follow=self._follow,
                idle_s=self._idle_s,
                should_stop=self._stop,
                advance=advance,
                warn=self._tell,
            )
            wanted = self._wanted
            tables = stream_tables(self._source, patience, wanted)
            stream = self._stream = LogStream(
                tables, wanted.mapping, required=wanted.required, optional=wanted.optional
            )
            try:
                for chunk in stream:
                    self._warn(stream)
                    yield chunk
            except RecordingError:
                self._warn(stream)
                if self._stop.is_set:
                    raise KeyboardInterrupt from None
                raise
            self._warn(stream)
        if self.exit_code:
            say("interrupted: the results are those of the rows read so far")

    def _size(self) -> float | None:
        """Bytes in all, if they are known and counted."""
        path = Path(self._source)
        is_counted = path.is_file() and is_text(path) and not self._follow
        return float(path.stat().st_size) if is_counted else None

    def _warn(self, stream: LogStream) -> None:
        for warning in stream.take_warnings():
            self._tell(warning)

    def _tell(self, warning: str) -> None:
        self._warnings.append(warning)
        say(f"warning: {warning}")
