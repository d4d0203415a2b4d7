"""What every command does with errors, with Ctrl-C, and when nobody reads what it prints."""

import os
import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Sequence

from recordings.errors import FileAccessError

FAILED = 2
"""Exit code after one line that says what is wrong with options or files."""

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells have it."""

READER_GONE = 141
"""Exit code when the reader of standard output has gone, as in `| head`; as shells have it."""


def run_command(
    parser: ArgumentParser,
    argv: Sequence[str] | None,
    work: Callable[[Namespace], int],
    errors: tuple[type[Exception], ...],
) -> int:
    """Run a command from its arguments to its exit code; every foreseen failure is one line.

    Args:
        parser: of its command line; it ends the process itself where that is wrong.
        argv: arguments without the program's name; those of the process when None.
        work: takes what was parsed, returns the exit code when all went well.
        errors: what the work may raise; the message is meant for the user.

    Returns:
        The exit code of the work, or one of those above.
    """
    arguments = parser.parse_args(argv)
    try:
        code = work(arguments)
        if sys.stdout is not None:
            write_out("")
    except BrokenPipeError:
        _close_output()
        return READER_GONE
    except errors as error:
        say(f"error: {error}")
        return FAILED
    except KeyboardInterrupt:
        say("interrupted")
        return INTERRUPTED
    except OSError as error:
        if error.filename is not None:
            raise
        # A failure without a file: another library could not write standard output.
        _close_output()
        say(f"error: cannot write standard output: {error.strerror or error}")
        return FAILED
    return code


def say(text: str) -> None:
    """Write one line to stderr, whatever line ends a message has."""
    if sys.stderr is not None:
        sys.stderr.write(f"{' '.join(text.split())}\n")


def write_out(text: str, *, to_stderr: bool = False) -> None:
    """Write a result to standard output, now.

    Args:
        text: whole lines.
        to_stderr: write to stderr, because a table goes to standard output.

    Raises:
        FileAccessError: it cannot be written.
        BrokenPipeError: the reader has gone.
    """
    stream = sys.stderr if to_stderr else sys.stdout
    if stream is None:
        if to_stderr:
            return
        raise FileAccessError("cannot write standard output: it is closed")
    try:
        stream.write(text)
        stream.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        _close_output()
        reason = error.strerror or error
        raise FileAccessError(f"cannot write standard output: {reason}") from error


def _close_output() -> None:
    """Let what is still buffered go nowhere, or Python would complain at its end."""
    try:
        handle = sys.stdout.fileno()
    except (OSError, ValueError):
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, handle)
    os.close(nowhere)
