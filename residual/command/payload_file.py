"""What hangs on the flange, from the option ``--payload``."""

from collections.abc import Mapping
from typing import Any

from residual.command.dataclass_table import build, dataclass_values
from residual.command.errors import CommandError
from residual.command.toml_file import read_toml
from urdf import NeedleTool, Payload

_POINT_MASS = [[0.0] * 3] * 3


def payload_from_option(text: str) -> Payload | NeedleTool | None:
    """Return the payload that an option's value stands for.

    A file holds either ``mass_kg``, ``com_m`` and ``inertia_kg_m2`` (about the centre of mass; a
    point mass without it) in flange axes, or a table ``[needle]`` with fields of
    `urdf.NeedleTool`.

    Args:
        text: ``needle``, ``none`` or the path of a TOML file.

    Raises:
        CommandError: The file cannot be read, or describes no physical body.
    """
    if text == "none":
        return None
    if text == "needle":
        return NeedleTool()
    content = read_toml(text, "payload")
    return _needle(content, text) if "needle" in content else _body(content, text)


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
