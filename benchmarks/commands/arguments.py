"""The command line."""

import argparse
import os
from pathlib import Path

DATA_VARIABLE = "NEEDLEFORCE_DATA"
FAILURE = 1
"""Exit code of a command that has done its work, and found what the epilog below names."""


def parser() -> argparse.ArgumentParser:
    """The parser of ``python -m benchmarks``."""
    top = argparse.ArgumentParser(
        prog="python -m benchmarks",
        description="Estimators against truth: simulated insertions and real recordings.",
        epilog="Exit codes: 0 all well, 1 a target missed (--strict), a regression or a benchmark "
        "that failed, 2 wrong usage or unreadable files.",
    )
    commands = top.add_subparsers(dest="command", required=True, metavar="COMMAND")
    commands.add_parser("list", help="what can be run")
    _add_run(commands.add_parser("run", help="run benchmarks and print the verdict"))
    compare = commands.add_parser("compare", help="find what has become worse between two runs")
    compare.add_argument("old", type=Path, metavar="OLD", help="results of the earlier run")
    compare.add_argument("new", type=Path, metavar="NEW", help="results of the later run")
    what = "time the estimators beside their bare dynamics"
    _add_speed(commands.add_parser("speed", help=what, epilog="Takes about 75 s."))
    what = "break the signals of a running insertion"
    _add_faults(commands.add_parser("faults", help=what, epilog="Takes about 45 s."))
    commands.add_parser("bound", help="what the noise of a force allows any estimator to know")
    _add_stream(commands.add_parser("stream", help="send a long recording through the commands"))
    return top


def _add_speed(speed: argparse.ArgumentParser) -> None:
    speed.add_argument("--strict", action="store_true", help="exit with 1 if a target is missed")
    speed.add_argument(
        "--soak",
        type=_positive,
        nargs="?",
        const=1_000_000,
        metavar="N",
        help="instead, N ticks of the chain (default 1000000, about four minutes): growth of "
        "memory, cost at the end",
    )


def _add_faults(faults: argparse.ArgumentParser) -> None:
    faults.add_argument(
        "--without-velocity",
        action="store_true",
        dest="blind",
        help="the arm sends no velocities, they are estimated",
    )
    faults.add_argument("--markdown", action="store_true", help="print the table of docs/loop.md")
    faults.add_argument(
        "--strict",
        action="store_true",
        help="exit with 1 if a fault is not recovered from, or a number is not finite",
    )


def _add_stream(stream: argparse.ArgumentParser) -> None:
    stream.add_argument(
        "--seconds",
        type=_positive,
        default=60,
        metavar="S",
        help="length of the recording (default 60; 3600 needs 3 GB on the disk and ten minutes)",
    )
    stream.add_argument(
        "--format",
        action="append",
        choices=(".csv", ".csv.gz", ".npz", ".parquet", ".mcap"),
        help="of the recording; may be given more than once (default .csv)",
    )
    stream.add_argument("--folder", type=Path, metavar="DIR", help="where the files lie meanwhile")
    stream.add_argument("--strict", action="store_true", help="exit with 1 if a target is missed")


def _add_run(run: argparse.ArgumentParser) -> None:
    run.add_argument(
        "ids", nargs="*", metavar="ID", help="of the list, tissue, or all; default: a quick set"
    )
    run.add_argument(
        "--plant",
        action="append",
        type=_names,
        metavar="LEVEL[,LEVEL]",
        help="ideal, clean, fri, degraded, or needle (no arm); may be given more than once "
        "(default: clean; for drawn scenarios needle)",
    )
    run.add_argument(
        "--seeds", type=_positive, default=1, metavar="N", help="run seeds 0 to N-1 (default 1)"
    )
    run.add_argument(
        "--data",
        type=Path,
        metavar="DIR",
        default=_data_folder(),
        help=f"folder of real recordings (default: the environment's {DATA_VARIABLE})",
    )
    run.add_argument("--json", type=Path, metavar="FILE", help="write the numbers there")
    run.add_argument(
        "--report",
        type=Path,
        metavar="DIR",
        help="write a page there: the paper's figures from these runs, and all tables; with no ID "
        "named, runs all that the figures need",
    )
    run.add_argument(
        "--jobs",
        type=_positive,
        metavar="N",
        default=_processors(),
        help="processes at a time (default: one per processor)",
    )
    run.add_argument("--strict", action="store_true", help="exit with 1 if a target is missed")


def _names(text: str) -> list[str]:
    names = [name.strip() for name in text.split(",") if name.strip()]
    if not names:
        raise argparse.ArgumentTypeError("expected at least one name")
    return names


def _positive(text: str) -> int:
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 up")
    return number


def _data_folder() -> Path | None:
    named = os.environ.get(DATA_VARIABLE)
    return Path(named) if named else None


def _processors() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
