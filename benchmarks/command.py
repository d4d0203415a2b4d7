"""``python -m benchmarks``: which command, and what becomes of its errors."""

from collections.abc import Sequence
from importlib import import_module

from benchmarks.arguments import parser
from benchmarks.errors import BenchmarkError
from figures import FiguresError
from recordings.command_line import run_command

EXTRA_PACKAGES = ("rich", "mujoco", "matplotlib")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: The command line after the program's name; default: that of this process.

    Returns:
        The exit code, see ``--help``.
    """
    chosen = parser().parse_args(arguments)

    def work() -> int:
        # Lazily: `compare` needs no simulator, and a missing package is said in one line.
        try:
            module = import_module(f"benchmarks.{chosen.command}_command")
            return module.execute(chosen)
        except ModuleNotFoundError as error:
            if error.name not in EXTRA_PACKAGES:
                raise
            told = f"{error.name} is not installed; pip install -e '.[bench]'"
            raise BenchmarkError(told) from error

    return run_command(work, (BenchmarkError, FiguresError))
