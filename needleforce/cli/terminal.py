"""What every command does with errors, Ctrl-C and SIGTERM, and with what it prints."""

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

FAILED = 2
"""Exit code after one line that says what is wrong with options or files."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

READER_GONE = 141
"""Exit code when the reader of standard output has gone, as in `| head`; as shells have it."""

TERMINATED = 143
"""Exit code after SIGTERM, as shells have it."""


class CommandError(ValueError):
    """An option, a file named by one, or a log that does not fit the robot."""


_ERRORS = {
    "needleforce.plots": "FiguresError",
    "needleforce.recordings": "RecordingError",
    "urdf": "UrdfError",
    "residual": "ResidualError",
    "identification": "IdentificationError",
    "groundtruth": "GroundTruthError",
}
"""Package to the base of what it raises for wrong input."""


class _Terminated(BaseException):
    """SIGTERM, which by default would leave unfinished files behind."""


def run_command(work: Callable[[], int], errors: tuple[type[Exception], ...] = ()) -> int:
    """Run a command to its exit code; every foreseen failure is one line on stderr.

    Args:
        work: Returns the exit code when all went well.
        errors: What it may raise beside the errors of our packages.

    Returns:
        The exit code of the work, or one of those above.
    """
    try:
        with _terminable():
            code = work()
            if sys.stdout is not None:
                write_out("")
    except BrokenPipeError:
        _close_output()
        return READER_GONE
    except KeyboardInterrupt:
        say("interrupted")
        return INTERRUPTED
    except _Terminated:
        say("terminated")
        return TERMINATED
    except Exception as error:
        if isinstance(error, (CommandError, *errors, *_known_errors())):
            say(f"error: {error}")
            return FAILED
        if not isinstance(error, OSError) or error.filename is not None:
            raise
        # A failure without a file: another library could not write standard output.
        _close_output()
        say(f"error: cannot write standard output: {error.strerror or error}")
        return FAILED
    return code


def _known_errors() -> tuple[type[Exception], ...]:
    # A package that was not imported has raised nothing; importing it takes a second.
    return tuple(
        getattr(sys.modules[package], name)
        for package, name in _ERRORS.items()
        if package in sys.modules
    )


@contextmanager
def _terminable() -> Iterator[None]:
    """Let SIGTERM unwind the work, so that files are whole or removed."""

    def end(_number: int, _frame: FrameType | None) -> None:
        raise _Terminated

    is_ours = (
        threading.current_thread() is threading.main_thread()
        and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL
    )
    if is_ours:
        signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        if is_ours:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)


class StopRequest:
    """While it is entered, the first Ctrl-C is remembered; the second interrupts."""

    def __init__(self) -> None:
        self.is_set = False

    def __call__(self) -> bool:
        """Return whether Ctrl-C was pressed."""
        return self.is_set

    def __enter__(self) -> "StopRequest":
        """Listen. Only a process's first thread hears Ctrl-C."""
        self._listens = threading.current_thread() is threading.main_thread()
        if self._listens:
            self._before = signal.signal(signal.SIGINT, self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        """Leave Ctrl-C as it was."""
        if self._listens:
            signal.signal(signal.SIGINT, self._before)

    def _hear(self, _number: int, _frame: FrameType | None) -> None:
        if self.is_set:
            raise KeyboardInterrupt
        self.is_set = True


def say(text: str) -> None:
    """Write one line to stderr, whatever line ends a message has."""
    if sys.stderr is not None:
        sys.stderr.write(f"{' '.join(text.split())}\n")


def write_out(text: str, *, to_stderr: bool = False) -> None:
    """Write a result to standard output, now.

    Args:
        text: Whole lines; what the terminal's encoding lacks is written as an escape.
        to_stderr: Write to stderr, because a table goes to standard output.
    """
    stream = sys.stderr if to_stderr else sys.stdout
    if stream is None:
        if to_stderr:
            return
        raise CommandError("cannot write standard output: it is closed")
    encoding = stream.encoding or "utf-8"
    try:
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        _close_output()
        reason = error.strerror or error
        raise CommandError(f"cannot write standard output: {reason}") from error


def _close_output() -> None:
    """Let what is still buffered go nowhere, or Python would complain at its end."""
    try:
        handle = sys.stdout.fileno()
    except (OSError, ValueError):
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, handle)
    os.close(nowhere)


@contextmanager
def progress(total: float | None, label: str) -> Iterator[Callable[[float], None]]:
    """Show a progress bar on stderr while the block runs, if stderr is a terminal.

    Args:
        total: Of whatever is counted; None if it is not known.
        label: What is being done.

    Yields:
        A function that takes how much more is done.
    """
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda more: None
        return
    from rich.console import Console
    from rich.progress import Progress, TimeElapsedColumn

    columns = (*Progress.get_default_columns(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(label, total=total)
        yield lambda more: bar.advance(task, more)
