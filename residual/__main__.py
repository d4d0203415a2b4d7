"""``python -m residual LOG``: forces from a recording of joint signals."""

import sys
from argparse import Namespace
from collections.abc import Sequence

from figures import FiguresError, require_matplotlib
from figures.report_folder import folder_if_filled
from recordings import RecordingError
from recordings.command.log_session import LogSession
from recordings.command.mapping_arguments import mapping_from_arguments
from recordings.command.output_arguments import check_outputs
from recordings.command.run_command import run_command, write_out
from recordings.command.suggest_mapping import suggest_mapping
from recordings.open_table import STANDARD_STREAM
from residual.command.arguments import build_parser
from residual.command.config_file import sensor_config
from residual.command.force_picture import save_picture
from residual.command.force_report import write_report
from residual.command.friction_file import Drive, load_drive
from residual.command.joint_signals import torque_channel
from residual.command.payload_file import payload_from_arguments, payload_lines
from residual.command.robot_options import robot_from_arguments
from residual.command.run_log import run_log
from residual.command.summary import format_rows, summary_rows
from residual.command.tare_window import TareOption
from residual.command.taring import TareRequest
from residual.errors import ResidualError
from urdf import Robot, UrdfError

ERRORS = (ResidualError, RecordingError, UrdfError, FiguresError)
"""What is told in one line."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code, see `run_command`."""
    return run_command(build_parser(), argv, _run, ERRORS)


def _run(arguments: Namespace) -> int:
    robot = robot_from_arguments(arguments)
    if arguments.print_config:
        return _print_config(arguments, robot)
    check_outputs(arguments)
    if arguments.png is not None:
        require_matplotlib("--png")
    drive = load_drive(arguments.friction, robot.nv) if arguments.friction else Drive()
    if drive.rotor_inertia_kg_m2 is not None:
        robot = robot.with_armature(drive.rotor_inertia_kg_m2)
    config = sensor_config(arguments, drive.friction)
    torque = torque_channel(is_external=arguments.external_torque)
    channels = {"required": ("q", torque), "optional": ("dq",)}
    log = LogSession(arguments, **channels, joints=robot.joint_names)
    with folder_if_filled(arguments.report), log:
        result = run_log(arguments, log, robot, config, _tare_request(arguments))
        if arguments.png is not None:
            save_picture(arguments.png, result)
        if arguments.report is not None:
            write_report(arguments.report, result, log.warnings)
    is_table_out = arguments.output == STANDARD_STREAM
    write_out(format_rows(summary_rows(result)), to_stderr=is_table_out)
    return log.exit_code


def _print_config(arguments: Namespace, robot: Robot) -> int:
    channels = ("q", "dq", torque_channel(is_external=arguments.external_torque))
    default = "needle" if arguments.urdf is None else "none"
    payload = payload_lines(payload_from_arguments(arguments, default))
    known = mapping_from_arguments(arguments)
    write_out(
        suggest_mapping(
            arguments.log, channels, mapping=known, joints=robot.joint_names, payload=payload
        )
    )
    return 0


def _tare_request(arguments: Namespace) -> TareRequest:
    if arguments.no_tare:
        return TareRequest(where=None)
    if arguments.tare is None:
        return TareRequest(force=arguments.force_tare)
    return TareRequest(where=TareOption(arguments.tare), force=arguments.force_tare)


if __name__ == "__main__":
    sys.exit(main())
