"""The robot and its sensor from options and TOML files: arm, payload, friction, settings."""

import re
from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from difflib import get_close_matches
from typing import Any, TypeVar, get_args, get_type_hints

import msgspec
import numpy as np
from msgspec import UNSET

from needleforce.cli.options import RobotOptions, SensorOptions
from needleforce.cli.terminal import CommandError
from needleforce.recordings import load_mapping
from needleforce.recordings.mapping import read_toml
from residual import (
    DEFAULT,
    PUBLISHED,
    FrictionModel,
    JointFriction,
    SensorConfig,
    SigmoidFriction,
)
from urdf import (
    NeedleTool,
    Payload,
    Robot,
    UnsupportedJointError,
    load_example,
    load_lwr,
    load_urdf,
)

# A validated dataclass from a table of a TOML file, with errors that name key and value.

T = TypeVar("T")

NOTHING = "none"
"""How a file says None, for which TOML has no word."""
_WORDS = {
    "float": "a number",
    "int": "a number",
    "str": "text",
    "bool": "true or false",
    "array": "a list",
    "numbers": "a list of numbers",
    "null": repr(NOTHING),
    "object": "a table",
}


def decoded(kind: type[T], table: Any, where: str, preset: Mapping[str, Any] | None = None) -> T:
    """Return a dataclass with the values of a table.

    Args:
        kind: A dataclass of numbers, text, choices, arrays and further dataclasses.
        table: As TOML gives it.
        where: File and table, for messages.
        preset: Fields in place of the dataclass's own defaults, which the table overrides.
    """
    if not isinstance(table, dict):
        raise CommandError(f"{where} = {_short(table)}, expected a table")
    _require_known(kind, table, where)
    values = {name: None if value == NOTHING else value for name, value in table.items()}
    for name, value in (preset or {}).items():
        inner = values.setdefault(name, value)
        if is_dataclass(value) and isinstance(inner, dict):
            values[name] = {item.name: getattr(value, item.name) for item in fields(value)} | inner
    try:
        found = msgspec.convert(values, _struct(kind), dec_hook=_array)
    except (msgspec.ValidationError, OverflowError) as error:
        raise CommandError(f"{where}: {_explained(str(error), kind, table)}") from error
    given = {name: getattr(found, name) for name in found.__struct_fields__}
    try:
        return kind(**{name: value for name, value in given.items() if value is not UNSET})
    except (ValueError, TypeError) as error:
        raise CommandError(f"{where}: {error}") from error


def _struct(kind: type) -> type[msgspec.Struct]:
    """Return the fields with their types; msgspec would fill fields that are no arguments, too."""
    hints = get_type_hints(kind)
    items = [
        (item.name, hints[item.name])
        if item.default is item.default_factory is MISSING
        else (item.name, hints[item.name], UNSET)
        for item in fields(kind)
        if item.init
    ]
    return msgspec.defstruct(kind.__name__, items, kw_only=True)


def _require_known(kind: type, table: Mapping[str, Any], where: str) -> None:
    hints = get_type_hints(kind)
    known = [item.name for item in fields(kind) if item.init]
    for name, value in table.items():
        if name not in known:
            near = get_close_matches(name, known, n=1)
            hint = f"did you mean {near[0]}? " if near else ""
            listed = ", ".join(known)
            raise CommandError(f"{where}: unknown key {name!r}; {hint}known are: {listed}")
        if is_dataclass(hints[name]) and isinstance(value, dict):
            _require_known(hints[name], value, f"{where}: {name}")


def _array(_kind: Any, value: Any) -> np.ndarray:
    try:
        array = np.array(value, dtype=np.float64)
    except (ValueError, TypeError, OverflowError):
        array = np.array(np.nan)
    if not (array.ndim and np.isfinite(array).all()):
        raise ValueError("Expected `numbers`")
    return array


def _explained(message: str, kind: type, table: Mapping[str, Any]) -> str:
    """Return a message of msgspec in plain words, with the value that came."""
    what, at, path = message.partition(" - at `$.")
    if not at:
        return what.replace("Object missing required field", "missing:").replace("`", "")
    key = path.rstrip("`")
    name, *inner = re.split(r"[.\[]", key)
    value = table.get(name)
    if inner and isinstance(value, dict):
        value = value.get(inner[0])
    choices = get_args(get_type_hints(kind).get(name))
    if what.startswith("Invalid enum value"):
        expected = " or ".join(map(repr, choices))
    elif found := re.match(r"Expected `([^`]*)`( of length \d+)?", what):
        kinds = [_WORDS.get(word, word) for word in found.group(1).split(" | ")]
        expected = " or ".join(dict.fromkeys(kinds)) + (found.group(2) or "")
    else:
        return f"{key} = {_short(value)}: {what}"
    return f"{key} = {_short(value)}, expected {expected}"


def _short(value: Any) -> str:
    try:
        return repr(value)[:60]
    except ValueError:
        return "a number of thousands of digits"


# The arm, and what hangs on its flange.

LWR = "lwr"
_POINT_MASS = [[0.0] * 3] * 3


def robot_from_options(options: RobotOptions, mapping: str | None) -> Robot:
    """Return the robot that the options describe.

    Args:
        options: Of the command.
        mapping: The mapping file, which may name the payload.
    """
    payload = payload_from_options(options, mapping)
    if options.urdf is not None and options.robot is not None:
        raise CommandError("--robot and --urdf name two robots; give one of them")
    if options.lock and options.urdf is None:
        raise CommandError("--lock describes a robot of --urdf FILE; give it")
    placed = {
        "tool_frame": options.tool_frame,
        "tool_placement": options.tip_offset,
        "without": options.without,
        "payload": payload,
    }
    if options.urdf is None and options.robot not in (None, LWR):
        return load_example(options.robot, **placed)
    if options.urdf is None:
        if options.tool_frame or options.tip_offset or options.without:
            raise CommandError(
                "--tool-frame, --tip-offset and --without describe a robot of --robot NAME or "
                "--urdf FILE; the LWR 4+ takes a [needle] in --payload FILE"
            )
        return load_lwr(payload=payload)
    try:
        return load_urdf(options.urdf, locked_joints=dict(map(_locked, options.lock)), **placed)
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
    """
    is_lwr = options.urdf is None and options.robot in (None, LWR)
    value, where = options.payload, "--payload"
    if value is None and mapping is not None:
        value, where = load_mapping(mapping).payload, f"{mapping}: [payload]"
    if value is None:
        value = "needle" if is_lwr else NOTHING
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
    """Return the preset with the file's settings, then the options', in place of its own."""
    preset = PUBLISHED if options.published else DEFAULT
    values = {item.name: getattr(preset, item.name) for item in fields(preset)}
    if options.config is not None:
        table = read_toml(options.config, "config file")
        if "friction" in table:
            raise CommandError(f"{options.config}: give joint friction with --friction FILE")
        config = decoded(SensorConfig, table, options.config, values)
        values = {item.name: getattr(config, item.name) for item in fields(config)}
    given = {
        "gain_per_s": options.gain,
        "alignment": options.alignment,
        "mode": options.mode,
        "insertion_axis": options.insertion_axis,
        "torque_is_gravity_compensated": options.gravity_compensated or None,
    }
    given = {name: value for name, value in given.items() if value is not None}
    return replace(decoded(SensorConfig, given, "options", values), friction=friction)
