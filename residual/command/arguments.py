"""The command line of ``python -m residual``."""

from argparse import ArgumentParser, RawDescriptionHelpFormatter

from recordings import mapping_arguments
from recordings.command.output_arguments import output_arguments
from recordings.command.source_arguments import source_arguments
from residual.command.robot_options import robot_arguments
from residual.command.taring import AUTOMATIC_S

_DESCRIPTION = "Force on a needle from a robot's recorded joint signals, with standard deviations."

_EPILOG = f"""\
The sensor reads well once it was tared on motion without contact. Without --tare and --no-tare,
the first {AUTOMATIC_S:g} s of the log after the filters have settled are taken for such
motion. If contact is seen there, or in the window of --tare, the command stops and says so. The
summary says what was tared on.

examples:
  python -m residual insertion.csv --tare 0:4 -o forces.csv --png forces.png
  python -m residual log.npz --urdf arm.urdf --tool-frame tool0 --payload needle.toml -o forces.csv

See docs/residual.md for the TOML files and the columns, docs/recordings.md for logs."""


def build_parser() -> ArgumentParser:
    """Return the parser of the command."""
    parser = ArgumentParser(
        prog="python -m residual",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=RawDescriptionHelpFormatter,
    )
    source_arguments(parser, "time, q, tau and perhaps dq")
    output_arguments(
        parser,
        table="forces",
        picture="picture of forces over time",
        page="charts, summary, warnings and settings",
    )
    robot_arguments(parser)
    _sensor_arguments(parser)
    _tare_arguments(parser)
    mapping_arguments(parser, ["q", "dq", "tau", "tau_ext"])
    return parser


def _sensor_arguments(parser: ArgumentParser) -> None:
    group = parser.add_argument_group("sensor")
    group.add_argument("--gain", type=float, metavar="K", help="observer gain K in 1/s (lag 1/K)")
    group.add_argument(
        "--alignment",
        choices=("hold", "trapezoid"),
        help="whether torques are commands held until the next sample, or samples of a sensor",
    )
    group.add_argument(
        "--mode",
        choices=("axial", "point", "full"),
        help="contact: a force along the needle, any force at the tip, or force and torque",
    )
    group.add_argument("--paper", action="store_true", help="the method as published")
    group.add_argument("--config", metavar="FILE", help="TOML file of further settings")
    group.add_argument(
        "--friction", metavar="FILE", help="TOML file of joint friction and rotor inertia"
    )
    group.add_argument(
        "--external-torque",
        action="store_true",
        help="read the external torque that the robot estimates itself (tau_ext) instead of tau",
    )


def _tare_arguments(parser: ArgumentParser) -> None:
    group = parser.add_argument_group("tare")
    which = group.add_mutually_exclusive_group()
    which.add_argument(
        "--tare",
        metavar="START:END",
        help="free motion, in seconds of the log's clock, or with a + from its first stamp (+0:+4)",
    )
    which.add_argument("--no-tare", action="store_true", help="leave the offset in the forces")
    group.add_argument("--force-tare", action="store_true", help="tare even where contact is seen")
