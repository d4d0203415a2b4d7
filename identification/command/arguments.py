"""The command line of ``python -m identification``."""

from argparse import ArgumentParser

from identification.default_config import DEFAULT
from identification.paper_config import PAPER, PAPER_KV
from recordings import mapping_arguments
from recordings.command.output_arguments import output_arguments
from recordings.command.source_arguments import source_arguments

METHODS = {"default": DEFAULT, "paper": PAPER, "paper-kv": PAPER_KV}
"""What ``--method`` may be."""

CHANNELS = ("depth", "speed", "force", "force_status", "force_cautions")
"""What is read of a log beside time."""


def build_parser() -> ArgumentParser:
    """Return the parser of the command."""
    parser = ArgumentParser(
        prog="python -m identification",
        description="Ruptures, layers, stiffness and friction from depth, speed and axial force.",
        epilog="Depth grows into the tissue; force is positive when tissue pushes back. Times of "
        "the table are on the log's clock. A ? marks what the data do not identify.",
    )
    source_arguments(parser, "time, depth, force, perhaps speed")
    output_arguments(
        parser,
        table="online estimates",
        picture="picture after the paper's Figure 8",
        page="that picture, the layers, warnings and settings",
    )
    parser.add_argument(
        "--method",
        choices=tuple(METHODS),
        default="default",
        help="ours, or the method as published with the multi-layer or the Kelvin-Voigt model",
    )
    parser.add_argument(
        "--ignore-status",
        action="store_true",
        help="use also rows that `python -m residual` has marked as not tared, settling, doubtful",
    )
    mapping_arguments(parser, CHANNELS)
    return parser
