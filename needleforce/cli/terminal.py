"""What every command does with errors, Ctrl-C and SIGTERM, and with what it prints."""

import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from types import FrameType
from typing import TYPE_CHECKING, Any

from foundation.errors import NeedleforceError
from foundation.extras import extra_of, install_command

if TYPE_CHECKING:
    import pandas as pd

FAILED = 2
"""Exit code after one line that says what is wrong with options or files."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

READER_GONE = 141
"""Exit code when the reader of standard output has gone, as in ``| head``."""

TERMINATED = 143
"""Exit code after SIGTERM."""

Progress = Callable[[float], None]
"""Takes the fraction of a piece of work that is done."""


OTHER_ROBOT = (
    "Name another robot with --robot or --urdf FILE, where --lock-others locks "
    "every joint that the log does not have and --lock JOINT a single one; or "
    "name the columns with --q"
)
CHOOSE_TARE = (
    "Choose where the needle is free with --tare START:END, in seconds such as "
    "0:4 or +0:+4 from the log's first stamp; --no-tare goes without"
)
CHECK_ARM = "Check that the arm runs, and that it sends to this machine and port"
OTHER_PLACE = "Make room on the disk, or give another place"


class CommandError(NeedleforceError, ValueError):
    """An option, a file named by one, or a log that does not fit the robot."""

    usual_advice = "--help says what each option means"


def run_command(work: Callable[[], int]) -> int:
    """Run a command; every foreseen failure is one line on stderr and an exit code.

    Args:
        work: The command; returns its exit code.

    Returns:
        The exit code.

    Raises:
        SystemExit: SIGTERM came, which by default would leave unfinished files behind.
    """

    def terminate(_number: int, _frame: FrameType | None) -> None:
        say("terminated")
        raise SystemExit(TERMINATED)

    try:
        with handled(terminate, signal.SIGTERM):
            code = work()
            write_out("")
        return code
    except BrokenPipeError:
        return READER_GONE
    except KeyboardInterrupt:
        say("interrupted")
        return INTERRUPTED
    except Exception as error:
        say(f"error: {describe_error(_foreseen(error))}")
        return FAILED
    finally:
        _close_output_if_it_fails()


def _foreseen(error: Exception) -> NeedleforceError:
    """Return a foreseen failure; raise what was not foreseen."""
    if isinstance(error, NeedleforceError):
        return error
    if isinstance(error, ModuleNotFoundError) and (extra := extra_of(error.name)):
        return _not_installed("this", str(error.name), extra)
    if type(error).__module__.partition(".")[0] == "cyclopts":
        return CommandError(str(error), "--help lists what a command takes")
    if not isinstance(error, OSError) or error.filename is not None:
        raise error
    # A failure without a file is one of standard output; others say which file.
    reason = f"cannot write standard output: {error.strerror or error}"
    return CommandError(reason, OTHER_PLACE)


def _close_output_if_it_fails() -> None:
    """Let what is still buffered go nowhere where it cannot be written.

    Python would try again at its end, and complain.
    """
    try:
        write_out("")
    except OSError:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())


def describe_error(error: NeedleforceError) -> str:
    """Return an error in one line: what came and was expected, what to do."""
    text = str(error).rstrip()
    end = "" if text.endswith((".", "?", "!")) else "."
    return f"{text}{end} {error.advice}".strip().removesuffix(".")


def _not_installed(command: str, module: str, extra: str) -> CommandError:
    """Return the error of a command that needs a module of an extra."""
    return CommandError(
        f"{command} needs {module}, which is not installed",
        f"Install it: {install_command(extra)}",
    )


def require_modules(command: str, modules: Iterable[str]) -> None:
    """Find out before the work what is missing for it.

    Args:
        command: What needs the modules.
        modules: Modules of extras.

    Raises:
        CommandError: One of them is not installed.
    """
    for module in modules:
        if find_spec(module) is None:
            raise _not_installed(command, module, str(extra_of(module)))


@contextmanager
def handled(
    handler: Callable[[int, FrameType | None], None], *numbers: int
) -> Iterator[None]:
    """Let a handler have signals while the block runs.

    Only a process's first thread may.

    Args:
        handler: What takes number and frame of a signal.
        numbers: The signals.
    """
    replaced = {number: signal.signal(number, handler) for number in numbers}
    try:
        yield
    finally:
        for number, earlier_handler in replaced.items():
            signal.signal(number, earlier_handler)


@contextmanager
def stop_request(
    *others: int, then: Callable[[], None] = lambda: None
) -> Iterator[Callable[[], bool]]:
    """Yield whether Ctrl-C or another of these signals came.

    The second signal interrupts at once.

    Args:
        others: Signals beside Ctrl-C.
        then: Called when the first signal comes.
    """
    is_asked = False

    def note_request(_number: int, _frame: FrameType | None) -> None:
        nonlocal is_asked
        if is_asked:
            raise KeyboardInterrupt
        is_asked = True
        then()

    with handled(note_request, signal.SIGINT, *others):
        yield lambda: is_asked


@contextmanager
def progress_bar(label: str) -> Iterator[Progress]:
    """Show on stderr, if that is a terminal, how far work has come.

    Yields what takes the fraction that is done.

    Args:
        label: What is done.
    """
    if sys.stderr is None or not sys.stderr.isatty():
        yield lambda _: None
        return
    from rich.console import Console
    from rich.progress import Progress

    # What is said meanwhile stands above the bar; the bar leaves no trace.
    with Progress(
        console=Console(stderr=True), transient=True, redirect_stdout=False
    ) as bar:
        task = bar.add_task(label, total=None)
        yield lambda fraction: bar.update(task, total=1.0, completed=fraction)


def aligned(rows: Iterable[tuple[str, str]]) -> str:
    """Return a line for each label and its text, the texts below each other."""
    lines = list(rows)
    width = max((len(label) for label, _ in lines), default=0)
    return "".join(f"{label:<{width}}  {text}\n" for label, text in lines)


def json_text(content: Any) -> str:
    """Return content as JSON, indented; an array becomes a list."""
    import msgspec

    encoded = msgspec.json.encode(content, enc_hook=lambda array: array.tolist())
    return msgspec.json.format(encoded).decode() + "\n"


def table_text(rows: "pd.DataFrame", justify: Callable[..., str] = str.rjust) -> str:
    """Return a table of texts as lines, its columns two spaces apart."""
    lines = [tuple(rows.columns), *rows.itertuples(index=False)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    cells = [map(justify, line, widths) for line in lines]
    return "".join("  ".join(line).rstrip() + "\n" for line in cells)


def say(text: str) -> None:
    """Write a message to stderr as one line, whatever line ends it has."""
    if sys.stderr is not None:
        sys.stderr.write(f"{' '.join(text.split())}\n")


def warn(warnings: Iterable[str]) -> None:
    """Write warnings to stderr, a line each."""
    for warning in warnings:
        say(f"warning: {warning}")


def write_out(text: str, *, to_stderr: bool = False) -> None:
    """Write whole lines now.

    What the terminal's encoding lacks is written as an escape.

    Args:
        text: The lines.
        to_stderr: Whether a table goes to standard output.
    """
    stream = sys.stderr if to_stderr else sys.stdout
    if stream is not None:  # as print does where a stream is closed
        encoding = stream.encoding or "utf-8"
        stream.write(text.encode(encoding, "backslashreplace").decode(encoding))
        stream.flush()


def limit_library_threads() -> None:
    """Let linear algebra compute in one thread, unless the user has said otherwise.

    Threads that wait for each other on busy cores take seconds for what one does in
    milliseconds, and the arm is not answered meanwhile. Call it before numpy is loaded.
    """
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
