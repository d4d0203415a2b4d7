"""``python -m benchmarks``: which command, and what becomes of its errors."""

import sys
from collections.abc import Sequence
from importlib import import_module

from benchmarks.arguments import parser
from benchmarks.errors import BenchmarkError
from figures import FiguresError

USAGE = 2
INTERRUPTED = 130
EXTRA_PACKAGES = ("rich", "mujoco", "matplotlib")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The command line after the program's name; default: that of this process.

    Returns:
        The exit code, see ``--help``.
    """
    chosen = parser().parse_args(arguments)
    try:
        # Lazily: `compare` needs no simulator, and a missing package is said in one line.
        module = import_module(f"benchmarks.{chosen.command}_command")
        return module.execute(chosen)
    except (BenchmarkError, FiguresError) as error:
        return _complain(str(error))
    except ModuleNotFoundError as error:
        if error.name not in EXTRA_PACKAGES:
            raise
        return _complain(f"{error.name} is not installed; pip install -e '.[bench]'")
    except KeyboardInterrupt:
        _complain("interrupted")
        return INTERRUPTED


def _complain(message: str) -> int:
    sys.stderr.write(f"benchmarks: {message}\n")
    return USAGE
