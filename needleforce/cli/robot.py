"""The robot and its sensor from options and TOML files: arm, payload, friction, settings."""

import re
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from difflib import get_close_matches
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from needleforce.cli.options import RobotOptions, SensorOptions
from needleforce.cli.terminal import CommandError
from recordings import load_mapping
from recordings.toml_file import read_toml
from residual import (
    DEFAULT,
    PUBLISHED,
    FrictionModel,
    JointFriction,
    SensorConfig,
    SigmoidFriction,
)
from urdf import NeedleTool, Payload, Robot, UnsupportedJointError, load_lwr, load_urdf

# A validated dataclass from a table of a TOML file, with errors that name key and value.

T = TypeVar("T")

NOTHING = "none"
"""How a file says None, for which TOML has no word."""
_WORDS = {
    "float": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list of numbers",
    "null": repr(NOTHING),
    "object": "a table",
}


def decoded(kind: type[T], table: Any, where: str, preset: T | None = None) -> T:
    """Return a dataclass with the values of a table.

    Args:
        kind: A dataclass of numbers, text, choices, arrays and further dataclasses.
        table: As TOML gives it.
        where: File and table, for messages.
        preset: Holds what the table leaves out; else the dataclass's own defaults do.

    Raises:
        CommandError: A key is unknown or missing, or a value is of the wrong type or refused by
            the dataclass.
    """
    if not isinstance(table, dict):
        raise CommandError(f"{where} = {table!r}, expected a table")
    items = {item.name: item for item in fields(kind) if item.init}  # type: ignore[arg-type]
    for name in table:
        if name not in items:
            near = get_close_matches(name, items, n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            raise CommandError(
                f"{where}: unknown key {name!r}; {hint}known are: {', '.join(items)}"
            )
    hints = get_type_hints(kind)
    values = {}
    for name, value in table.items():
        inner = getattr(preset, name, None)
        values[name] = _value(value, hints[name], f"{where}: {name}", inner)
    missing = [
        name
        for name, item in items.items()
        if name not in values and item.default is item.default_factory is MISSING
    ]
    if missing and preset is None:
        raise CommandError(f"{where}: {', '.join(missing)} missing")
    try:
        return kind(**values) if preset is None else replace(preset, **values)  # type: ignore[type-var]
    except (ValueError, TypeError) as error:
        raise CommandError(f"{where}: {error}") from error


def _value(value: Any, hint: Any, what: str, preset: Any) -> Any:
    options = get_args(hint) if NoneType in get_args(hint) else (hint,)
    if NoneType in options and value == NOTHING:
        return None
    for option in options:
        if is_dataclass(option):
            return decoded(option, value, what, preset)  # type: ignore[arg-type]
    try:
        return msgspec.convert(value, hint, dec_hook=_array)
    except (msgspec.ValidationError, ValueError, TypeError) as error:
        raise CommandError(f"{what} = {_short(value)}, expected {_expected(error, options)}") from (
            error
        )


def _array(_kind: Any, value: Any) -> np.ndarray:
    if not isinstance(value, list):
        raise TypeError
    array = np.array(value, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError
    return array


def _expected(error: Exception, options: tuple[Any, ...]) -> str:
    """Return what msgspec expected, in plain words."""
    for option in options:
        if get_origin(option) is Literal:
            return " or ".join(map(repr, get_args(option)))
        if get_origin(option) is np.ndarray:
            return "a list of numbers"
        if get_origin(option) is tuple and ... not in get_args(option):
            return f"a list of {len(get_args(option))} numbers"
    named = re.match(r"Expected `([^`]*)`", str(error))
    kinds = named.group(1).split(" | ") if named else []
    return " or ".join(_WORDS.get(kind, kind) for kind in kinds) or f"otherwise: {error}"


def _short(value: Any) -> str:
    try:
        return repr(value)[:60]
    except ValueError:
        return "a number of thousands of digits"


# The arm, and what hangs on its flange.

_POINT_MASS = [[0.0] * 3] * 3


def robot_from_options(options: RobotOptions, mapping: str | None) -> Robot:
    """Return the robot that the options describe.

    Args:
        options: Of the command.
        mapping: The mapping file, which may name the payload.

    Raises:
        CommandError: Options contradict each other, or the payload is not valid.
        RecordingError: The mapping that names the payload cannot be read.
        UrdfError: The URDF, a frame or a joint in it is not valid.
    """
    payload = payload_from_options(options, mapping)
    if options.urdf is None:
        if options.tool_frame is not None or options.lock:
            raise CommandError("--tool-frame and --lock describe a robot of --urdf FILE; give it")
        return load_lwr(payload=payload)
    if options.lwr:
        raise CommandError("--lwr and --urdf name two robots; give one of them")
    locked = dict(map(_locked, options.lock))
    try:
        return load_urdf(
            options.urdf, tool_frame=options.tool_frame, locked_joints=locked, payload=payload
        )
    except UnsupportedJointError as error:
        reason = str(error).replace("lock it with locked_joints", "lock it with --lock")
        raise CommandError(reason) from error


def _locked(text: str) -> tuple[str, float]:
    name, equals, position = text.partition("=")
    try:
        return name, float(position) if equals else 0.0
    except ValueError as error:
        raise CommandError(
            f"--lock {text}: {position!r} is no number; expected JOINT or JOINT=POSITION"
        ) from error


def payload_from_options(options: RobotOptions, mapping: str | None) -> Payload | NeedleTool | None:
    """Return the payload of the option, else of the mapping, else the robot's usual one.

    A table holds either ``mass_kg``, ``com_m`` and ``inertia_kg_m2`` (about the centre of mass; a
    point mass without it) in flange axes, or a table ``[needle]`` with fields of
    `urdf.NeedleTool`.

    Raises:
        CommandError: It describes no physical body.
        RecordingError: A file cannot be read.
    """
    usual = "needle" if options.urdf is None else NOTHING
    value, where = options.payload, "--payload"
    if value is None and mapping is not None:
        value, where = load_mapping(mapping).payload, f"{mapping}: [payload]"
    value = usual if value is None else value
    if value == NOTHING:
        return None
    if value == "needle":
        return NeedleTool()
    if isinstance(value, str):
        value, where = read_toml(value, "payload file"), value
    if not isinstance(value, dict):
        raise CommandError(
            f"{mapping}: payload = {_short(value)}, expected a table, a file, needle or none"
        )
    return _payload(value, where)


def _payload(table: Mapping[str, Any], where: str) -> Payload | NeedleTool:
    if "needle" in table:
        if len(table) > 1 or not isinstance(table["needle"], dict):
            raise CommandError(f"{where}: give either a table [needle] alone, or mass_kg and com_m")
        return decoded(NeedleTool, table["needle"], f"{where}: [needle]")
    for name in ("mass_kg", "com_m"):
        if name not in table:
            raise CommandError(
                f"{where}: {name} is missing; a payload has mass_kg, com_m and inertia_kg_m2, or "
                "is a table [needle]"
            )
    return decoded(Payload, {"inertia_kg_m2": _POINT_MASS, **table}, where)


def payload_lines(payload: Payload | NeedleTool | None) -> list[str]:
    """Return a payload as lines of a mapping."""
    if payload is None:
        return ['payload = "none"  # or "needle", a file, or a table [payload]']
    if isinstance(payload, NeedleTool):
        numbers = {item.name: getattr(payload, item.name) for item in fields(payload)}
        lines = [f"{name} = {number!r}" for name, number in numbers.items()]
        return ["[payload.needle]  # force sensor and needle; see docs/force.md", *lines]
    return [
        "[payload]  # in flange axes; inertia about the centre of mass",
        f"mass_kg = {payload.mass_kg!r}",
        f"com_m = {payload.com_m.tolist()}",
        f"inertia_kg_m2 = {payload.inertia_kg_m2.tolist()}",
    ]


# Friction and rotors between torque measurement and link, and the sensor's settings.

_MODELS = {"viscous_coulomb": JointFriction, "sigmoid": SigmoidFriction}


def with_friction(robot: Robot, path: str | None) -> tuple[Robot, FrictionModel | None]:
    """Read the file of ``--friction``.

    It holds one table, ``[viscous_coulomb]`` with the fields of `residual.JointFriction` or
    ``[sigmoid]`` with those of `residual.SigmoidFriction`, and may hold ``rotor_inertia_kg_m2``.

    Returns:
        The robot with its rotors, and the friction, if any.

    Raises:
        CommandError: Something in it is missing or not valid.
        RecordingError: The file cannot be read.
    """
    if path is None:
        return robot, None
    content = read_toml(path, "friction file")
    rotor = content.pop("rotor_inertia_kg_m2", None)
    if len(content) > 1 or not content.keys() <= _MODELS.keys():
        raise CommandError(
            f"{path} has {', '.join(content)}; expected one table of "
            f"{' or '.join(f'[{name}]' for name in _MODELS)}, and rotor_inertia_kg_m2 if it counts"
        )
    friction = None
    for name, table in content.items():
        where = f"{path}: [{name}]"
        for key, value in table.items() if isinstance(table, dict) else ():
            if isinstance(value, list):
                _per_joint(value, f"{where}: {key}", robot.nv)
        friction = decoded(_MODELS[name], table, where)
    if rotor is not None:
        robot = robot.with_armature(_per_joint(rotor, f"{path}: rotor_inertia_kg_m2", robot.nv))
    return robot, friction


def _per_joint(value: Any, what: str, joints: int) -> np.ndarray:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        array = np.empty(0)
    if array.shape != (joints,):
        raise CommandError(f"{what} = {_short(value)}, expected {joints} numbers, one per joint")
    return array


def sensor_config(options: SensorOptions, friction: FrictionModel | None) -> SensorConfig:
    """Return the preset with the file's settings, then the options', in place of its own.

    Raises:
        CommandError: A setting is not valid.
        RecordingError: The file cannot be read.
    """
    config = PUBLISHED if options.published else DEFAULT
    if options.config is not None:
        table = read_toml(options.config, "config file")
        if "friction" in table:
            raise CommandError(f"{options.config}: give joint friction with --friction FILE")
        config = decoded(SensorConfig, table, options.config, config)
    given = {
        "gain_per_s": options.gain,
        "alignment": options.alignment,
        "mode": options.mode,
    }
    given = {name: value for name, value in given.items() if value is not None}
    config = decoded(SensorConfig, given, "options", config)
    return replace(config, friction=friction)
