"""``python -m residual LOG``: forces from a recording of joint signals."""

import sys
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from recordings import RecordingError, check_writable, mapping_from_arguments, write_table
from residual.command.arguments import build_parser
from residual.command.config_file import sensor_config
from residual.command.force_picture import check_picture, save_picture
from residual.command.force_table import force_table
from residual.command.friction_file import Drive, load_drive
from residual.command.joint_signals import JointSignals, read_joint_signals
from residual.command.progress import progress
from residual.command.replay import Replay, replay
from residual.command.robot_options import robot_from_arguments
from residual.command.summary import format_rows, sensor_line, summary_rows
from residual.command.tare_window import parse_tare_window
from residual.command.taring import TareRequest
from residual.command.tip_travel import tip_travel_m
from residual.errors import ResidualError
from residual.sensor_config import SensorConfig
from urdf import Robot, UrdfError


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
    except (ResidualError, RecordingError, UrdfError) as error:
        _say(f"error: {error}")
        return 2
    return 0


def _run(arguments: Namespace) -> None:
    _check_outputs(arguments)
    robot = robot_from_arguments(arguments)
    drive = load_drive(arguments.friction, robot.nv) if arguments.friction else Drive()
    if drive.rotor_inertia_kg_m2 is not None:
        robot = robot.with_armature(drive.rotor_inertia_kg_m2)
    config = sensor_config(arguments, drive.friction)
    signals = read_joint_signals(
        arguments.log,
        mapping_from_arguments(arguments),
        robot,
        is_external=arguments.external_torque,
    )
    for warning in signals.warnings:
        _say(f"warning: {warning}")
    request = _tare_request(arguments, signals)
    with progress(len(signals), Path(arguments.log).name) as advance:
        result = replay(robot, config, signals, request, advance)
    _write(arguments, robot, config, signals, result)
    sys.stdout.write(format_rows(summary_rows(robot, config, signals, result)))


def _check_outputs(arguments: Namespace) -> None:
    """Refuse now what would fail after the work is done."""
    if arguments.output is not None:
        check_writable(arguments.output)
    if arguments.png is not None:
        check_picture(arguments.png)


def _tare_request(arguments: Namespace, signals: JointSignals) -> TareRequest:
    if arguments.no_tare:
        return TareRequest(window=None)
    if arguments.tare is None:
        return TareRequest(force=arguments.force_tare)
    first_s, last_s = float(signals.t_s[0]), float(signals.t_s.max())
    window = parse_tare_window(arguments.tare, first_s, last_s)
    return TareRequest(window=window, force=arguments.force_tare)


def _write(
    arguments: Namespace, robot: Robot, config: SensorConfig, signals: JointSignals, result: Replay
) -> None:
    if arguments.output is not None:
        travel_m = tip_travel_m(robot, config, signals.q_rad)
        write_table(arguments.output, force_table(result, config, travel_m))
    if arguments.png is not None:
        title = f"{Path(arguments.log).name}: {sensor_line(robot, config, signals)}"
        save_picture(arguments.png, result, config, title)


def _say(text: str) -> None:
    """Write one line to stderr, whatever line ends a message has."""
    sys.stderr.write(f"{' '.join(text.split())}\n")


if __name__ == "__main__":
    sys.exit(main())
