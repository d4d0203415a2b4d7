"""Which robot the log was recorded on: its options, and the robot they give."""

from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from needleforce.cli.config_files import CommandError, build, dataclass_values
from recordings import load_mapping
from recordings.toml_file import read_toml
from urdf import NeedleTool, Payload, Robot, UnsupportedJointError, load_lwr, load_urdf

# What hangs on the flange, from the option ``--payload`` or the mapping.


_POINT_MASS = [[0.0] * 3] * 3


def payload_from_arguments(arguments: Namespace, default: str) -> Payload | NeedleTool | None:
    """Return the payload of the option ``--payload``, else of the mapping, else the default.

    Args:
        arguments: With ``payload`` and ``mapping_file``, both None if not given.
        default: As for the option.

    Raises:
        CommandError: The payload is no physical body.
        recordings.RecordingError: A file cannot be read.
    """
    if arguments.payload is not None or arguments.mapping_file is None:
        return payload_from_option(arguments.payload or default)
    value = load_mapping(arguments.mapping_file).payload
    if isinstance(value, dict):
        return _from_table(value, f"{arguments.mapping_file}: [payload]")
    if value is None or isinstance(value, str):
        return payload_from_option(value or default)
    raise CommandError(
        f"{arguments.mapping_file}: payload = {value!r}, expected a table, a file, needle or none"
    )


def payload_lines(payload: Payload | NeedleTool | None) -> list[str]:
    """Return a payload as lines of a mapping.

    Args:
        payload: What hangs on the flange.
    """
    if payload is None:
        return ['payload = "none"  # or "needle", a file, or a table [payload]']
    if isinstance(payload, NeedleTool):
        numbers = {item.name: getattr(payload, item.name) for item in fields(payload)}
        lines = [f"{name} = {number!r}" for name, number in numbers.items()]
        return ["[payload.needle]  # force sensor and needle; see docs/residual.md", *lines]
    return [
        "[payload]  # in flange axes; inertia about the centre of mass",
        f"mass_kg = {payload.mass_kg!r}",
        f"com_m = {payload.com_m.tolist()}",
        f"inertia_kg_m2 = {payload.inertia_kg_m2.tolist()}",
    ]


def payload_from_option(text: str) -> Payload | NeedleTool | None:
    """Return the payload that an option's value stands for.

    A file holds either ``mass_kg``, ``com_m`` and ``inertia_kg_m2`` (about the centre of mass; a
    point mass without it) in flange axes, or a table ``[needle]`` with fields of
    `urdf.NeedleTool`.

    Args:
        text: ``needle``, ``none`` or the path of a TOML file.

    Raises:
        CommandError: It describes no physical body.
        recordings.RecordingError: The file cannot be read.
    """
    if text == "none":
        return None
    if text == "needle":
        return NeedleTool()
    content = read_toml(text, "payload file")
    return _from_table(content, text)


def _from_table(content: Mapping[str, Any], where: str) -> Payload | NeedleTool:
    return _needle(content, where) if "needle" in content else _body(content, where)


def _needle(content: Mapping[str, Any], path: str) -> NeedleTool:
    table = content["needle"]
    if len(content) > 1 or not isinstance(table, dict):
        raise CommandError(f"{path}: give either a table [needle] alone, or mass_kg and com_m")
    where = f"{path}: [needle]"
    return build(NeedleTool, dataclass_values(NeedleTool, table, where), where)


def _body(content: Mapping[str, Any], path: str) -> Payload:
    for name in ("mass_kg", "com_m"):
        if name not in content:
            raise CommandError(
                f"{path}: {name} is missing; a payload has mass_kg, com_m and inertia_kg_m2, or is "
                "a table [needle]"
            )
    values = dataclass_values(Payload, {"inertia_kg_m2": _POINT_MASS, **content}, path)
    return build(Payload, values, path)


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
