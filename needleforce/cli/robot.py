"""The robot and its sensor from options and TOML files.

Arm, payload, friction and settings.
"""

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import fields, replace
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import urdf
from foundation.arrays import Array
from needleforce.cli.kept_joints import (
    LogJoints,
    assumed_positions,
    joints_to_keep,
    parse_lock,
)
from needleforce.cli.shared_options import RobotOptions, SensorOptions
from needleforce.cli.terminal import CommandError, say
from needleforce.cli.toml_tables import NOTHING, convert_table
from needleforce.recordings.channels import read_toml
from residual import (
    DEFAULT,
    PUBLISHED,
    FrictionModel,
    JointFriction,
    SensorConfig,
    SigmoidFriction,
)
from urdf import NeedleTool, Payload, Robot, example_robot_path
from urdf.errors import finite_array
from urdf.robot import STANDARD_GRAVITY_M_S2

LWR = "lwr"
"""Name of the arm that is taken without options."""

MOUNT_TILT_DEG = {"wall": 90.0, "ceiling": 180.0}
"""By how much a mounting turns the base about its y axis from upright."""


NEEDLE = "needle"
"""Name of the payload that a known LWR has without options."""


def robot_from_options(
    options: RobotOptions,
    mapping: str | None,
    find_joints: Callable[[], LogJoints] = LogJoints,
) -> Robot:
    """Return the robot that the options describe; what is odd in it is said on stderr.

    Args:
        options: Options of the command.
        mapping: File of the mapping, which may name the payload.
        find_joints: Returns what the log says about its joints; called for
            ``--lock-others``. By default nothing is known.

    Raises:
        CommandError: Options contradict each other, or the robot cannot be loaded.
    """
    payload = payload_from_options(options, mapping)
    _check_robot_options(options)
    gravity_m_s2 = gravity_from_options(options)
    if _is_lwr(options):
        return urdf.load_lwr(payload=payload, gravity_m_s2=gravity_m_s2)  # none is odd
    tool: dict[str, Any] = {
        "tool_frame": options.tool_frame,
        "tool_placement": options.tip_offset,
        "without": options.without,
        "gravity_m_s2": gravity_m_s2,
        "payload": payload,
    }
    if options.urdf is None:
        robot = urdf.load_example(str(options.robot), **tool)
        _say_warnings(robot)
        return robot
    locked_joints = dict(map(parse_lock, options.lock))
    kept_joints = None
    if options.lock_others:
        kept_joints = joints_to_keep(options, locked_joints, find_joints())
    robot = urdf.load_urdf(
        options.urdf,
        locked_joints=locked_joints,
        keep_joints=kept_joints,
        check_inertias=not options.accept_inertia,
        **tool,
    )
    if kept_joints is not None:
        chosen = {*kept_joints, *locked_joints}
        robot = replace(
            robot, warnings=robot.warnings + assumed_positions(options, chosen)
        )
    _say_warnings(robot)
    return robot


def robot_from_text(text: str, source: str, options: RobotOptions) -> Robot:
    """Return the robot of a description that no file has; errors name its source.

    Args:
        text: URDF.
        source: Whence it came, such as ``robot_description``.
        options: Options of the command, without ``--urdf``.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder, source)
        path.write_text(text, encoding="utf-8")
        return robot_from_options(replace(options, urdf=str(path)), None)


def _say_warnings(robot: Robot) -> None:
    """Write what is odd in a robot's description to stderr."""
    for warning in robot.warnings:
        say(f"warning: {warning}")


def _check_robot_options(options: RobotOptions) -> None:
    """Refuse options of the robot that contradict each other."""
    if options.urdf is not None and options.robot is not None:
        raise CommandError("--robot and --urdf name two robots, expected one of them")
    for_urdf = {
        "--lock": options.lock,
        "--lock-others": options.lock_others,
        "--accept-inertia": options.accept_inertia,
    }
    for option, value in for_urdf.items():
        if value and options.urdf is None:
            raise CommandError(
                f"{option} is for a robot of --urdf FILE; known robots have no joints "
                "to lock and all their inertia"
            )
    if _is_lwr(options) and (
        options.tool_frame or options.tip_offset or options.without
    ):
        raise CommandError(
            "--tool-frame, --tip-offset and --without describe a robot of --robot "
            "NAME or --urdf FILE; the LWR 4+ takes a [needle] in --payload FILE"
        )


def gravity_from_options(options: RobotOptions) -> Array:
    """Return gravity in base axes [m/s^2], shape (3,).

    Raises:
        CommandError: It is not as strong as on Earth, or the mounting is not known.
    """
    # Weaker and stronger than anywhere on Earth: a unit vector, or another unit
    max_gravity_m_s2 = 9.9
    min_gravity_m_s2 = 9.7
    # Digits of a gravity from an angle: the sine of 180 degrees is zero
    gravity_digits = 9
    if options.gravity is not None and options.mount:
        raise CommandError("--gravity and --mount say the same, expected one of them")
    if options.gravity is not None:
        size_m_s2 = float(np.linalg.norm(options.gravity))
        if not min_gravity_m_s2 <= size_m_s2 <= max_gravity_m_s2:
            raise CommandError(
                f"--gravity {' '.join(f'{value:g}' for value in options.gravity)}: is "
                f"{size_m_s2:.4g} m/s^2, expected about 9.81, as in 0 0 9.81 for a "
                "robot that hangs from the ceiling"
            )
        return np.array(options.gravity)
    tilt_rad = np.deg2rad(_parse_mount(options.mount))
    down_m_s2 = STANDARD_GRAVITY_M_S2[2]
    # The base is turned about its y axis: R_y(tilt)' g.
    gravity_m_s2 = down_m_s2 * np.array([-np.sin(tilt_rad), 0.0, np.cos(tilt_rad)])
    return np.round(gravity_m_s2, gravity_digits) + 0.0  # never -0.0


def _parse_mount(words: tuple[str, ...]) -> float:
    """Return by how many degrees the base is turned about its y axis from upright."""
    text = " ".join(words)
    if not words:
        return 0.0
    if text in MOUNT_TILT_DEG:
        return MOUNT_TILT_DEG[text]
    kind, _, tilt = text.replace("=", " ").replace(":", " ").partition(" ")
    with suppress(ValueError):
        if kind == "tilt" and np.isfinite(float(tilt)):
            return float(tilt)
    raise CommandError(
        f"--mount {text}: expected wall, ceiling or tilt DEG, as in --mount tilt 30, "
        "and the log before it"
    )


def _is_lwr(options: RobotOptions) -> bool:
    """Return whether the robot is the known LWR 4+."""
    return options.urdf is None and options.robot in (None, LWR)


def urdf_with_shapes(options: RobotOptions) -> Path | None:
    """Return the file whose shapes the scene shows."""
    if options.urdf is not None:
        return Path(options.urdf)
    if options.robot in (None, LWR):
        return Path(str(files("urdf.data") / "lwr4plus.urdf"))
    return Path(example_robot_path(options.robot))


def payload_from_options(
    options: RobotOptions, mapping: str | None
) -> Payload | NeedleTool | None:
    """Return the payload of the option, else of the mapping, else the usual one.

    A table holds either ``mass_kg``, ``com_m`` and ``inertia_kg_m2`` (about the centre
    of mass; a point mass without it) in flange axes, or a table ``[needle]`` with
    fields of `urdf.NeedleTool`.

    Args:
        options: Options of the command.
        mapping: File of the mapping, if any.

    Raises:
        CommandError: The table or file describes no payload.
    """
    value: Any = options.payload
    where = "--payload"
    if value is None and mapping is not None:
        value = read_toml(mapping, "mapping").get("payload")
        where = f"{mapping}: [payload]"
    if value is None:
        value = NEEDLE if _is_lwr(options) else NOTHING
    if value == NOTHING:
        return None
    if value == NEEDLE:
        return NeedleTool()
    if isinstance(value, str):
        where = value
        if options.payload is None:  # a path in the mapping counts from its folder
            where = str(Path(mapping or "").parent / value)
        value = read_toml(where, "payload file")
    if not isinstance(value, dict):
        raise CommandError(
            f"{mapping}: payload is {type(value).__name__}, expected a table, a file, "
            "needle or none",
        )
    return _payload_from_table(value, where)


def _payload_from_table(table: Mapping[str, Any], where: str) -> Payload | NeedleTool:
    """Return the payload that a table describes."""
    if "needle" in table:
        if len(table) > 1 or not isinstance(table["needle"], dict):
            raise CommandError(
                f"{where}: expected a table [needle] alone, or mass_kg and com_m",
            )
        return convert_table(NeedleTool, table["needle"], f"{where}: [needle]")
    for name in ("mass_kg", "com_m"):
        if name not in table:
            raise CommandError(
                f"{where}: {name} is missing; a payload has mass_kg, com_m and "
                "inertia_kg_m2, or is a table [needle]",
            )
    point_mass = {"inertia_kg_m2": [[0.0] * 3] * 3}
    return convert_table(Payload, {**point_mass, **table}, where)


def payload_lines(payload: Payload | NeedleTool | None) -> list[str]:
    """Return a payload as lines of a mapping."""
    if payload is None:
        return ['payload = "none"  # or "needle", a file, or a table [payload]']
    title = "[payload]  # in flange axes; inertia about the centre of mass"
    if isinstance(payload, NeedleTool):
        page = "docs/how-to/tool-and-payload.md"
        title = f"[payload.needle]  # force sensor and needle; see {page}"
    lines = [title]
    for item in fields(payload):
        value = np.asarray(getattr(payload, item.name))
        lines.append(f"{item.name} = {value.tolist()!r}")
    return lines


_FRICTION_MODELS = {"viscous_coulomb": JointFriction, "sigmoid": SigmoidFriction}
"""Friction models, by the name of their table."""

_ROTOR_INERTIA = "rotor_inertia_kg_m2"


def with_friction(robot: Robot, path: str | None) -> tuple[Robot, FrictionModel | None]:
    """Return the robot with rotors and friction of the file of ``--friction``.

    It holds one table, ``[viscous_coulomb]`` with the fields of
    `residual.JointFriction` or ``[sigmoid]`` with those of `residual.SigmoidFriction`,
    and may hold ``rotor_inertia_kg_m2``.

    Args:
        robot: The robot without them.
        path: The file, if any.

    Raises:
        CommandError: The file has other tables, or a key that is unknown.
    """
    if path is None:
        return robot, None
    tables = read_toml(path, "friction file")
    rotor_inertia = tables.pop(_ROTOR_INERTIA, None)
    if len(tables) > 1 or not tables.keys() <= _FRICTION_MODELS.keys():
        known = " or ".join(f"[{name}]" for name in _FRICTION_MODELS)
        raise CommandError(
            f"{path} has {', '.join(tables)}; expected one table of {known}, and "
            f"{_ROTOR_INERTIA} if it counts",
        )
    friction = None
    for name, table in tables.items():
        friction = _friction_from_table(name, table, f"{path}: [{name}]", robot.nv)
    if rotor_inertia is not None:
        where = f"{path}: {_ROTOR_INERTIA}, one number per joint,"
        inertia_kg_m2 = finite_array(rotor_inertia, (robot.nv,), where)
        robot = robot.with_armature(inertia_kg_m2)
    return robot, friction


def _friction_from_table(
    name: str, table: Any, where: str, joints: int
) -> FrictionModel:
    """Return the friction of a table; lists in it must have one number per joint."""
    if isinstance(table, dict):
        for key, value in table.items():
            if isinstance(value, list):
                label = f"{where}: {key}, one number per joint,"
                finite_array(value, (joints,), label)
    return convert_table(_FRICTION_MODELS[name], table, where)


def sensor_config(
    options: SensorOptions, friction: FrictionModel | None
) -> SensorConfig:
    """Return the preset with the file's settings, then the options', in their place.

    Args:
        options: Options of the command.
        friction: Friction of the joints; None for that of the preset.

    Raises:
        CommandError: The file of ``--config`` has friction, or an unknown key.
    """
    config = PUBLISHED if options.published else DEFAULT
    if options.config is not None:
        table = read_toml(options.config, "config file")
        if "friction" in table:
            raise CommandError(
                f"{options.config}: unknown key 'friction'; joint friction stands in "
                "the file of --friction",
            )
        config = convert_table(SensorConfig, table, options.config, config)
    settings = {
        "gain_per_s": options.gain,
        "friction": friction,
        "alignment": options.alignment,
        "mode": options.mode,
        "insertion_axis": options.insertion_axis,
        "torque_is_gravity_compensated": options.gravity_compensated or None,
    }
    chosen = {name: value for name, value in settings.items() if value is not None}
    return replace(config, **chosen)
