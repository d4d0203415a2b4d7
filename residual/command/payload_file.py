"""What hangs on the flange, from the option ``--payload`` or the mapping."""

from argparse import Namespace
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from recordings import load_mapping
from recordings.toml_file import read_toml
from residual.command.dataclass_table import build, dataclass_values
from residual.command.errors import CommandError
from urdf import NeedleTool, Payload

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
