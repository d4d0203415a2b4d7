"""The robot and its sensor from options and TOML files.

Arm, payload, friction and settings.
"""

from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass, replace
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

import urdf
from foundation.arrays import Array
from needleforce.cli.kept_joints import LogJoints, assumed_positions, joints_to_keep
from needleforce.cli.shared_options import RobotOptions, SensorOptions
from needleforce.cli.terminal import CommandError, warn
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

T = TypeVar("T")

LWR = "lwr"
"""Name of the arm that is taken without options."""

NOTHING = "none"
"""How a file says None, for which TOML has no word."""

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
    _check_robot_options(options)
    payload = payload_from_options(options, mapping)
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
    else:
        locked_joints = dict(map(_parse_lock, options.lock))
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
            assumed = assumed_positions(options, {*kept_joints, *locked_joints})
            robot = replace(robot, warnings=robot.warnings + assumed)
    warn(robot.warnings)
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


def _check_robot_options(options: RobotOptions) -> None:
    """Refuse options of the robot that contradict each other."""
    if options.urdf is not None and options.robot is not None:
        raise CommandError("--robot and --urdf name two robots, expected one of them")
    if options.gravity is not None and options.mount:
        raise CommandError("--gravity and --mount say the same, expected one of them")
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


def _parse_lock(text: str) -> tuple[str, float]:
    """Return name and position [rad, m] of a joint that ``--lock`` holds."""
    name, equals, position = text.partition("=")
    try:
        return name, float(position) if equals else 0.0
    except ValueError as error:
        raise CommandError(
            f"--lock {text}: expected JOINT or JOINT=POSITION"
        ) from error


def gravity_from_options(options: RobotOptions) -> Array:
    """Return gravity in base axes [m/s^2], shape (3,).

    Raises:
        CommandError: It is not as strong as on Earth, or the mounting is not known.
    """
    # Weaker and stronger than anywhere on Earth: a unit vector, or another unit
    max_gravity_m_s2 = 9.9
    min_gravity_m_s2 = 9.7
    if options.gravity is not None:
        size_m_s2 = float(np.linalg.norm(options.gravity))
        if not min_gravity_m_s2 <= size_m_s2 <= max_gravity_m_s2:
            raise CommandError(
                f"--gravity {' '.join(f'{value:g}' for value in options.gravity)}: is "
                f"{size_m_s2:.4g} m/s^2, expected about 9.81, as in 0 0 9.81 for a "
                "robot that hangs from the ceiling"
            )
        return np.array(options.gravity)
    tilts_deg = {"": 0.0, "wall": 90.0, "ceiling": 180.0}
    mount = " ".join(options.mount).replace("=", " ")
    tilt_deg = tilts_deg.get(mount, np.nan)
    if mount.startswith("tilt "):
        try:
            tilt_deg = float(mount.removeprefix("tilt "))
        except ValueError:
            tilt_deg = np.nan
    if not np.isfinite(tilt_deg):
        raise CommandError(
            f"--mount {mount}: expected wall, ceiling or tilt DEG, as in --mount tilt "
            "30, and the log before it"
        )
    down_m_s2 = STANDARD_GRAVITY_M_S2[2]
    tilt_rad = np.deg2rad(tilt_deg)
    # The base is turned about its y axis: R_y(tilt)' g.
    gravity_m_s2 = down_m_s2 * np.array([-np.sin(tilt_rad), 0.0, np.cos(tilt_rad)])
    return np.round(gravity_m_s2, 9) + 0.0  # sin(180 degrees) is 0, and never -0.0


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
        # A path in the mapping counts from its folder.
        folder = Path() if options.payload is not None else Path(mapping or "").parent
        where = str(folder / value)
        value = read_toml(where, "payload file")
    if isinstance(value, dict) and value.keys() == {"needle"}:
        return convert_table(NeedleTool, value["needle"], f"{where}: [needle]")
    point_mass = {"inertia_kg_m2": [[0.0] * 3] * 3}
    table = {**point_mass, **value} if isinstance(value, dict) else value
    return convert_table(Payload, table, where)


def payload_lines(payload: Payload | NeedleTool | None) -> list[str]:
    """Return a payload as lines of a mapping."""
    if payload is None:
        return ['payload = "none"  # or "needle", a file, or a table [payload]']
    title = "[payload]  # in flange axes; inertia about the centre of mass"
    if isinstance(payload, NeedleTool):
        page = "docs/how-to/tool-and-payload.md"
        title = f"[payload.needle]  # force sensor and needle; see {page}"
    return [
        title,
        *(
            f"{item.name} = {np.asarray(getattr(payload, item.name)).tolist()!r}"
            for item in fields(payload)
        ),
    ]


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
    models = {"viscous_coulomb": JointFriction, "sigmoid": SigmoidFriction}
    tables = read_toml(path, "friction file")
    rotor_inertia = tables.pop("rotor_inertia_kg_m2", None)
    if len(tables) > 1 or not tables.keys() <= models.keys():
        raise CommandError(
            f"{path} has {', '.join(tables)}; expected one table of "
            f"{' or '.join(models)}, and rotor_inertia_kg_m2 if it counts"
        )
    friction = None
    for name, table in tables.items():
        friction = convert_table(models[name], table, f"{path}: [{name}]")
        for item in fields(friction):
            values = np.asarray(getattr(friction, item.name))
            if values.ndim:
                where = f"{path}: [{name}]: {item.name}, one number per joint,"
                finite_array(values, (robot.nv,), where)
    if rotor_inertia is not None:
        where = f"{path}: rotor_inertia_kg_m2, one number per joint,"
        robot = robot.with_armature(finite_array(rotor_inertia, (robot.nv,), where))
    return robot, friction


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


def convert_table(kind: type[T], table: Any, where: str, preset: Any = None) -> T:
    """Return a dataclass with the values of a table.

    Args:
        kind: A dataclass of numbers, text, choices, arrays and further dataclasses.
        table: What TOML gives.
        where: File and table, as messages name them.
        preset: Instance with the values that the table does not give.

    Raises:
        CommandError: A key is unknown or missing, or its value does not fit.
    """
    if not isinstance(table, dict):
        raise CommandError(f"{where} is {type(table).__name__}, expected a table")
    declared: Any = kind
    hints = get_type_hints(kind)
    known = {item.name: item for item in fields(declared) if item.init}
    if unknown := sorted(table.keys() - known.keys()):
        raise CommandError(
            f"{where}: unknown key {unknown[0]!r}; known are: {', '.join(known)}"
        )
    given: dict[str, Any] = {}
    for name, value in table.items():
        nested = getattr(preset, name, None)
        if is_dataclass(nested) and isinstance(value, dict):
            given[name] = convert_table(type(nested), value, f"{where}: {name}", nested)
        elif value == NOTHING:
            given[name] = None
        else:
            given[name] = _convert_value(hints[name], value, f"{where}: {name}")
    if preset is not None:
        return replace(preset, **given)
    needed = [name for name, item in known.items() if item.default is MISSING]
    if missing := [name for name in needed if name not in given]:
        raise CommandError(f"{where}: {', '.join(missing)} is missing")
    return kind(**given)


def _convert_value(kind: Any, value: Any, where: str) -> Any:
    """Return a value of TOML as a field of a dataclass takes it."""
    try:
        return msgspec.convert(value, kind, dec_hook=_convert_array)
    except (msgspec.ValidationError, OverflowError) as error:
        text = f"{where}: {error}"
        if get_origin(kind) is Literal:
            text += f", expected {' or '.join(map(repr, get_args(kind)))}"
        raise CommandError(text) from error


def _convert_array(_kind: Any, value: Any) -> Array:
    """Return a list of numbers as an array; used by msgspec."""
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        array = np.array(np.nan)
    if not (array.ndim and np.isfinite(array).all()):
        raise ValueError("Expected a list of finite numbers")
    return array
