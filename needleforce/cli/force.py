"""``python -m residual LOG``: forces from a recording of joint signals."""

import sys
from argparse import ArgumentParser, Namespace, RawDescriptionHelpFormatter
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from needleforce.cli.config_files import (
    CommandError,
    build,
    dataclass_values,
)
from needleforce.cli.force_replay import (
    AUTOMATIC_S,
    ForceResult,
    ForceRows,
    ForceStatistics,
    Replay,
    TareOption,
    TareRequest,
    joint_signals,
    torque_channel,
)
from needleforce.cli.force_report import (
    force_labels,
    force_table,
    format_rows,
    save_picture,
    summary_rows,
    write_report,
)
from needleforce.cli.robot_options import (
    payload_from_arguments,
    payload_lines,
    robot_arguments,
    robot_from_arguments,
)
from needleforce.plots import FiguresError, folder_if_filled, require_matplotlib
from recordings import RecordingError, mapping_arguments
from recordings.command.log_session import LogSession
from recordings.command.mapping_arguments import mapping_from_arguments
from recordings.command.output_arguments import check_outputs, open_output, output_arguments
from recordings.command.row_overview import RowOverview
from recordings.command.run_command import run_command, write_out
from recordings.command.source_arguments import source_arguments
from recordings.command.suggest_mapping import suggest_mapping
from recordings.open_table import STANDARD_STREAM
from recordings.tables.labels import Labels
from recordings.toml_file import read_toml
from residual.config import DEFAULT, PUBLISHED, SensorConfig
from residual.errors import ResidualError
from residual.estimate import Status
from residual.joint_friction import FrictionModel, JointFriction, SigmoidFriction
from urdf import Robot, UrdfError

# The command line of ``python -m residual``.


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


# From a log to its result: rows in, forces out, as they come.


_SETTLING = "settling"


def run_log(
    arguments: Namespace,
    log: LogSession,
    robot: Robot,
    config: SensorConfig,
    request: TareRequest,
) -> ForceResult:
    """Run the sensor over a log and write its forces.

    Args:
        arguments: Of the command: where the table goes, which torque is read.
        log: The log, entered.
        robot: The arm with its payload.
        config: Settings of the sensor.
        request: Where to tare.

    Raises:
        CommandError: The log does not fit the robot, or the tare is refused.
        recordings.RecordingError: The log cannot be read, or the table not written.
    """
    replay, forces = Replay(robot, config, request), ForceStatistics()
    overview = RowOverview(_tracked(config))
    has_velocity = False

    def labels() -> Labels:
        return force_labels(log, robot, config)

    with open_output(arguments, is_live=log.is_live, labels=labels) as table:
        for chunk in log:
            signals = joint_signals(chunk, robot, is_external=arguments.external_torque)
            has_velocity = signals.dq_rad_s is not None
            rows = replay.run(signals)
            forces.add(rows)
            overview.add(rows.columns() | {_SETTLING: rows.has_status(Status.INITIALIZING)})
            if table is not None:
                table.append(force_table(rows, config))
        replay.finish(is_whole=not log.is_interrupted)
    return ForceResult(
        log=log.name,
        robot=robot,
        config=config,
        is_external=arguments.external_torque,
        has_velocity=has_velocity,
        replay=replay,
        statistics=forces,
        overview=ForceRows.of_columns(overview.columns()),
    )


def _tracked(config: SensorConfig) -> list[str]:
    """Return the columns of which a picture must not lose the extremes."""
    tracked = ["axial_N", "axial_std_N", "status", "after_gap", _SETTLING]
    if config.mode != "axial":
        tracked += ["force_N", "std"]
    if config.mode == "full":
        tracked.append("torque_Nm")
    return tracked


# What a user of the command got wrong, in one line.


# A validated dataclass from a table of a TOML file, with errors that name key and value.


# Settings of the sensor from options and the file of ``--config``; options win.


_OPTIONS = {"gain": "gain_per_s", "alignment": "alignment", "mode": "mode"}


def sensor_config(arguments: Namespace, friction: FrictionModel | None) -> SensorConfig:
    """Return the preset with the file's settings, then the options', in place of its own.

    Args:
        arguments: With ``published``, ``config`` (a path or None), ``gain``, ``alignment``,
            ``mode``.
        friction: Joint friction, or None.

    Raises:
        CommandError: A setting is not valid.
        recordings.RecordingError: The file cannot be read.
    """
    preset = PUBLISHED if arguments.paper else DEFAULT
    values: dict[str, Any] = {item.name: getattr(preset, item.name) for item in fields(preset)}
    where = "options"
    if arguments.config is not None:
        where = arguments.config
        table = read_toml(where, "config file")
        values |= dataclass_values(SensorConfig, table, where, leave_out=("friction",))
    given = {name: getattr(arguments, option) for option, name in _OPTIONS.items()}
    given = {name: value for name, value in given.items() if value is not None}
    values |= dataclass_values(SensorConfig, given, "options")
    return build(SensorConfig, values | {"friction": friction}, where)


# What lies between torque measurement and link, from the option ``--friction``.


_MODELS = {"viscous_coulomb": JointFriction, "sigmoid": SigmoidFriction}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drive:
    """Friction and rotor inertia of the joints; the LWR, measuring behind the gear, has none.

    Attributes:
        friction: Joint friction, or None.
        rotor_inertia_kg_m2: As seen at the joints, shape (n,), or None.
    """

    friction: FrictionModel | None = None
    rotor_inertia_kg_m2: NDArray[np.float64] | None = None


def load_drive(path: str, joints: int) -> Drive:
    """Read a friction file.

    It holds one table, ``[viscous_coulomb]`` with the fields of `residual.JointFriction` or
    ``[sigmoid]`` with those of `residual.SigmoidFriction`, and may hold ``rotor_inertia_kg_m2``.

    Args:
        path: A TOML file.
        joints: How many numbers every list must have.

    Raises:
        CommandError: Something in it is missing or not valid.
        recordings.RecordingError: The file cannot be read.
    """
    content = read_toml(path, "friction file")
    rotor = content.pop("rotor_inertia_kg_m2", None)
    unknown = [name for name in content if name not in _MODELS]
    if unknown or len(content) > 1:
        raise CommandError(
            f"{path} has {', '.join(content)}; expected one table of "
            f"{' or '.join(f'[{name}]' for name in _MODELS)}, and rotor_inertia_kg_m2 if it counts"
        )
    friction = None
    for name, table in content.items():
        friction = _friction(name, table, f"{path}: [{name}]", joints)
    if rotor is not None:
        rotor = _per_joint(rotor, f"{path}: rotor_inertia_kg_m2", joints)
    return Drive(friction=friction, rotor_inertia_kg_m2=rotor)


def _friction(name: str, table: Any, where: str, joints: int) -> FrictionModel:
    if not isinstance(table, dict):
        raise CommandError(f"{where} must be a table")
    kind = _MODELS[name]
    values = dataclass_values(kind, table, where)
    for key, value in values.items():
        if isinstance(value, np.ndarray):
            _per_joint(value.tolist(), f"{where}: {key}", joints)
    return build(kind, values, where)


def _per_joint(value: Any, what: str, joints: int) -> NDArray[np.float64]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != (joints,):
        raise CommandError(f"{what} = {value!r}, expected {joints} numbers, one per joint")
    return array


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
        require_matplotlib("--png", arguments.png)
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
