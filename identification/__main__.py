"""``python -m identification LOG``: layers, ruptures and friction from a recording."""

import sys
from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from pathlib import Path

from identification.default_config import DEFAULT
from identification.errors import IdentificationError
from identification.estimate_table import estimate_table
from identification.figure import check_figure, save_figure
from identification.layer_table import layer_table
from identification.paper_config import PAPER, PAPER_KV
from identification.replay import Replay, replay
from recordings import (
    Log,
    RecordingError,
    check_writable,
    mapping_arguments,
    mapping_from_arguments,
    read_log,
    write_table,
)

_METHODS = {"default": DEFAULT, "paper": PAPER, "paper-kv": PAPER_KV}


def build_parser() -> ArgumentParser:
    """Return the parser of the command."""
    parser = ArgumentParser(
        prog="python -m identification",
        description="Ruptures, layers, stiffness and friction from depth, speed and axial force.",
        epilog="Depth grows into the tissue; force is positive when tissue pushes back. Times of "
        "the table are on the log's clock. A ? marks what the data do not identify.",
    )
    parser.add_argument("log", metavar="LOG", help="CSV or npz: time, depth, force, perhaps speed")
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="table of online estimates: .csv, .csv.gz or .npz"
    )
    parser.add_argument("--png", metavar="FILE", help="picture after the paper's Figure 8")
    parser.add_argument(
        "--method",
        choices=tuple(_METHODS),
        default="default",
        help="ours, or the method as published with the multi-layer or the Kelvin-Voigt model",
    )
    mapping_arguments(parser, ["depth", "speed", "force"])
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command.

    Args:
        argv: Arguments without the program's name; those of the process when None.

    Returns:
        0, or 2 after one line on stderr that says what is wrong with options or files.
    """
    arguments = build_parser().parse_args(argv)
    try:
        _run(arguments)
    except (IdentificationError, RecordingError) as error:
        _say(f"error: {error}")
        return 2
    return 0


def _run(arguments: Namespace) -> None:
    if arguments.output is not None:
        check_writable(arguments.output)
    if arguments.png is not None:
        check_figure(arguments.png)
    log = read_log(
        arguments.log,
        mapping_from_arguments(arguments),
        required=("depth", "force"),
        optional=("speed",),
    )
    result = _replay(log, arguments.method)
    for warning in (*log.warnings, *result.hints):
        _say(f"warning: {warning}")
    if arguments.output is not None:
        write_table(arguments.output, estimate_table(result))
    if arguments.png is not None:
        title = f"{Path(arguments.log).name}, method {arguments.method}"
        save_figure(arguments.png, result, log["force_N"], title)
    sys.stdout.write(layer_table(result))


def _replay(log: Log, method: str) -> Replay:
    return replay(
        log.t_s,
        log["depth_m"],
        log["force_N"],
        log.channels.get("speed_m_s"),
        _METHODS[method],
    )


def _say(text: str) -> None:
    """Write one line to stderr, whatever line ends a message has."""
    sys.stderr.write(f"{' '.join(text.split())}\n")


if __name__ == "__main__":
    sys.exit(main())
