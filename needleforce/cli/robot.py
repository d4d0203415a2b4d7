"""The robot and its sensor from options and TOML files: arm, payload, friction,
settings.
"""

from collections.abc import Mapping
from dataclasses import fields, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

import urdf
from foundation.advice import Advice, Message
from needleforce.cli.shared_options import RobotOptions, SensorOptions
from needleforce.cli.terminal import CommandError
from needleforce.cli.toml_tables import NOTHING, decoded
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
from urdf import NeedleTool, Payload, Robot, example_robot_path
from urdf.advice import RobotAdvice
from urdf.errors import finite_array

# The arm, and what hangs on its flange.

LWR = "lwr"

_ADVICES: dict[Advice, str] = {
    RobotAdvice.LOCK_JOINT: "lock it with --lock",
    RobotAdvice.LOAD_FILE: "--urdf FILE loads any other",
}
"""Options for what messages about a robot advise."""


def robot_from_options(options: RobotOptions, mapping: str | None) -> Robot:
    """Return the robot that the options describe; a mapping file may name the
    payload.
    """
    payload = payload_from_options(options, mapping)
    if options.urdf is not None and options.robot is not None:
        raise CommandError("--robot and --urdf name two robots; give one of them")
    if options.lock and options.urdf is None:
        raise CommandError(
            "--lock holds joints of a robot of --urdf FILE; known robots have none"
        )
    placed = {"tool_frame": options.tool_frame, "tool_placement": options.tip_offset}
    placed |= {"without": options.without, "payload": payload}
    if options.urdf is None and options.robot in (None, LWR):
        if options.tool_frame or options.tip_offset or options.without:
            raise CommandError(
                "--tool-frame, --tip-offset and --without describe a robot of --robot NAME or "
                "--urdf FILE; the LWR 4+ takes a [needle] in --payload FILE"
            )
        return urdf.load_lwr(payload=payload)
    locked = dict(map(_locked, options.lock))
    try:
        if options.urdf is None:
            return urdf.load_example(str(options.robot), **placed)
        return urdf.load_urdf(options.urdf, locked_joints=locked, **placed)
    except (urdf.UnsupportedJointError, urdf.UnknownNameError) as error:
        raise CommandError(Message.of(error).in_words(_ADVICES)) from error


def _locked(text: str) -> tuple[str, float]:
    name, equals, position = text.partition("=")
    try:
        return name, float(position) if equals else 0.0
    except ValueError as error:
        what = f"{position!r} is no number; expected JOINT or JOINT=POSITION"
        raise CommandError(f"--lock {text}: {what}") from error


def payload_from_options(
    options: RobotOptions, mapping: str | None
) -> Payload | NeedleTool | None:
    """Return the payload of the option, else of the mapping, else the robot's usual
    one.

    A table holds either ``mass_kg``, ``com_m`` and ``inertia_kg_m2`` (about the centre
    of mass; a point mass without it) in flange axes, or a table ``[needle]`` with
    fields of `urdf.NeedleTool`.
    """
    value = options.payload
    where = "--payload"
    if value is None and mapping is not None:
        value = load_mapping(mapping).payload
        where = f"{mapping}: [payload]"
    if value is None:
        value = (
            "needle"
            if options.urdf is None and options.robot in (None, LWR)
            else NOTHING
        )
    if value == NOTHING:
        return None
    if value == "needle":
        return NeedleTool()
    if isinstance(value, str):
        where = (
            value
            if options.payload is not None
            else str(Path(mapping or "").parent / value)
        )
        value = read_toml(where, "payload file")
    if not isinstance(value, dict):
        what = f"payload is {type(value).__name__}, expected a table, a file, needle or none"
        raise CommandError(f"{mapping}: {what}")
    return _payload(value, where)


def _payload(table: Mapping[str, Any], where: str) -> Payload | NeedleTool:
    if "needle" in table:
        if len(table) > 1 or not isinstance(table["needle"], dict):
            raise CommandError(
                f"{where}: give either a table [needle] alone, or mass_kg and com_m"
            )
        return decoded(NeedleTool, table["needle"], f"{where}: [needle]")
    for name in ("mass_kg", "com_m"):
        if name not in table:
            raise CommandError(
                f"{where}: {name} is missing; a payload has mass_kg, com_m and inertia_kg_m2, or "
                "is a table [needle]"
            )
    return decoded(Payload, {"inertia_kg_m2": [[0.0] * 3] * 3, **table}, where)


def payload_lines(payload: Payload | NeedleTool | None) -> list[str]:
    """Return a payload as lines of a mapping."""
    if payload is None:
        return ['payload = "none"  # or "needle", a file, or a table [payload]']
    title = "[payload]  # in flange axes; inertia about the centre of mass"
    if isinstance(payload, NeedleTool):
        title = "[payload.needle]  # force sensor and needle; see docs/force.md"
    values = {
        item.name: np.asarray(getattr(payload, item.name)) for item in fields(payload)
    }
    return [title, *(f"{name} = {value.tolist()!r}" for name, value in values.items())]


# Friction and rotors between torque measurement and link, and the sensor's settings.

_MODELS = {"viscous_coulomb": JointFriction, "sigmoid": SigmoidFriction}


def with_friction(robot: Robot, path: str | None) -> tuple[Robot, FrictionModel | None]:
    """Return the robot with the rotors, and the friction if any, of the file of
    ``--friction``.

    It holds one table, ``[viscous_coulomb]`` with the fields of
    `residual.JointFriction` or ``[sigmoid]`` with those of `residual.SigmoidFriction`,
    and may hold ``rotor_inertia_kg_m2``.
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
                finite_array(
                    value, (robot.nv,), f"{where}: {key}, one number per joint,"
                )
        friction = decoded(_MODELS[name], table, where)
    if rotor is not None:
        name = f"{path}: rotor_inertia_kg_m2, one number per joint,"
        robot = robot.with_armature(finite_array(rotor, (robot.nv,), name))
    return robot, friction


def sensor_config(
    options: SensorOptions, friction: FrictionModel | None
) -> SensorConfig:
    """Return the preset with the file's settings, then the options', in place of its
    own.
    """
    config = PUBLISHED if options.published else DEFAULT
    if options.config is not None:
        table = read_toml(options.config, "config file")
        if "friction" in table:
            raise CommandError(
                f"{options.config}: give joint friction with --friction FILE"
            )
        config = decoded(SensorConfig, table, options.config, config)
    given = {"gain_per_s": options.gain, "friction": friction}
    given |= {
        name: getattr(options, name) for name in ("alignment", "mode", "insertion_axis")
    }
    given["torque_is_gravity_compensated"] = options.gravity_compensated or None
    return replace(
        config, **{name: value for name, value in given.items() if value is not None}
    )


def urdf_with_shapes(options: RobotOptions) -> Path | None:
    """The file whose shapes are shown."""
    if options.urdf is not None:
        return Path(options.urdf)
    if options.robot in (None, "lwr"):
        return Path(str(files("urdf.data") / "lwr4plus.urdf"))
    return Path(example_robot_path(options.robot))
