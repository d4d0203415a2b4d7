"""The command line of ``python -m groundtruth``."""

from argparse import ArgumentParser, RawDescriptionHelpFormatter

from groundtruth.arm_level import ARM_LEVELS

_DESCRIPTION = (
    "A recording of a simulated insertion, as a robot would have made it: joint positions, "
    "velocities and torques of a KUKA LWR 4+, and the wrench of a force sensor at the needle."
)

_EPILOG = """\
FILE may end in .csv, .csv.gz, .npz, .parquet, .mcap, or in .db3 for a folder with a ROS 2 bag.

examples:
  python -m groundtruth --list
  python -m groundtruth gel-25-constant -o insertion.mcap --truth truth.csv
  python -m residual insertion.mcap -o forces.mcap
  python -m identification forces.mcap

See docs/recordings.md for columns and topics."""


def build_parser() -> ArgumentParser:
    """Return the parser of the command."""
    parser = ArgumentParser(
        prog="python -m groundtruth",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "scenario", metavar="SCENARIO", nargs="?", help="what is simulated; see --list"
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="the recording")
    parser.add_argument(
        "--truth",
        metavar="FILE",
        help="what the robot does not know: true forces, depth, layers, ruptures",
    )
    parser.add_argument(
        "--arm",
        choices=tuple(ARM_LEVELS),
        default="realistic",
        help="how good arm and sensors are (default: realistic)",
    )
    parser.add_argument(
        "--seed", type=int, default=0, metavar="N", help="of everything drawn (default: 0)"
    )
    parser.add_argument("--list", action="store_true", help="print the scenarios and stop")
    return parser
