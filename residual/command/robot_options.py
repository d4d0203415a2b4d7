"""Which robot the log was recorded on: its options, and the robot they give."""

from argparse import ArgumentParser, Namespace

from residual.command.errors import CommandError
from residual.command.payload_file import payload_from_arguments
from urdf import Robot, UnsupportedJointError, load_lwr, load_urdf


def robot_arguments(parser: ArgumentParser) -> None:
    """Add the options that describe the robot."""
    group = parser.add_argument_group("robot")
    which = group.add_mutually_exclusive_group()
    which.add_argument("--lwr", action="store_true", help="KUKA LWR 4+ (default)")
    which.add_argument("--urdf", metavar="FILE", help="any other robot")
    group.add_argument(
        "--tool-frame",
        metavar="NAME",
        help="with --urdf: link that carries the payload and whose z axis is the insertion "
        "direction (default: the last link, if there is one only)",
    )
    group.add_argument(
        "--lock",
        metavar="JOINT[=POSITION]",
        nargs="+",
        action="extend",
        default=[],
        help="with --urdf: joints that are not in the log, such as a gripper's, held at a "
        "position in rad or m (default: 0)",
    )
    group.add_argument(
        "--payload",
        metavar="FILE|needle|none",
        help="what hangs on the flange: a TOML file; the paper's 304 g force sensor and needle "
        "(default of the LWR); or nothing (default with --urdf); else what the mapping says",
    )


def robot_from_arguments(arguments: Namespace) -> Robot:
    """Return the robot that the options describe.

    Args:
        arguments: What a parser with `robot_arguments` returned.

    Raises:
        CommandError: Options contradict each other, or the payload is not valid.
        recordings.RecordingError: The mapping that names the payload cannot be read.
        urdf.UrdfError: The URDF, a frame or a joint in it is not valid.
    """
    if arguments.urdf is None:
        if arguments.tool_frame is not None or arguments.lock:
            raise CommandError("--tool-frame and --lock describe a robot of --urdf FILE; give it")
        return load_lwr(payload=payload_from_arguments(arguments, "needle"))
    payload = payload_from_arguments(arguments, "none")
    locked = dict(_locked(text) for text in arguments.lock)
    try:
        return load_urdf(
            arguments.urdf, tool_frame=arguments.tool_frame, locked_joints=locked, payload=payload
        )
    except UnsupportedJointError as error:
        reason = str(error).replace("lock it with locked_joints", "lock it with --lock")
        raise UnsupportedJointError(reason) from error


def _locked(text: str) -> tuple[str, float]:
    name, equals, position = text.partition("=")
    try:
        return name, float(position) if equals else 0.0
    except ValueError as error:
        raise CommandError(
            f"--lock {text}: {position!r} is no number; expected JOINT or JOINT=POSITION"
        ) from error
