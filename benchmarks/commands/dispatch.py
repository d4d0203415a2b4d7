"""``python -m benchmarks``: which command, and what becomes of its errors."""

from argparse import Namespace
from collections.abc import Sequence
from importlib import import_module

from benchmarks.commands.arguments import parser
from benchmarks.errors import BenchmarkError
from needleforce.cli.terminal import run_command
from needleforce.plots import FiguresError

EXTRA_PACKAGES = ("rich", "mujoco", "matplotlib")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code, see ``--help``."""
    arguments = parser().parse_args(argv)
    return run_command(lambda: _execute(arguments), (BenchmarkError, FiguresError))


def _execute(arguments: Namespace) -> int:
    # Lazily: `compare` needs no simulator, and a missing package is said in one line.
    try:
        module = import_module(f"benchmarks.commands.{arguments.command}")
        return module.execute(arguments)
    except ModuleNotFoundError as error:
        if error.name not in EXTRA_PACKAGES:
            raise
        told = f"{error.name} is not installed; pip install -e '.[bench]'"
        raise BenchmarkError(told) from error
