"""The log on the command line, the same for every command."""

from argparse import ArgumentParser, ArgumentTypeError
from math import isfinite


def source_arguments(parser: ArgumentParser, channels: str) -> None:
    """Add the log and how to wait for more of it.

    Args:
        parser: the command's parser.
        channels: what the log must hold, in words.
    """
    parser.add_argument(
        "log",
        metavar="LOG",
        help=f"recording with {channels}: CSV, npz, ... (docs/recordings.md), or - for "
        "standard input",
    )
    parser.add_argument(
        "--follow",
        action="store_true",
        help="go on reading as the file (CSV, MCAP) grows, until Ctrl-C or --idle",
    )
    parser.add_argument(
        "--idle",
        metavar="SECONDS",
        type=_seconds,
        help="stop when nothing new came for so long, with --follow or a pipe",
    )


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not (isfinite(value) and value > 0.0):
        raise ArgumentTypeError(f"{text!r} is not a number of seconds > 0")
    return value
