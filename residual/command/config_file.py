"""Settings of the sensor from options and the file of ``--config``; options win."""

from argparse import Namespace
from dataclasses import fields
from typing import Any

from recordings.toml_file import read_toml
from residual.command.dataclass_table import build, dataclass_values
from residual.joint_friction import FrictionModel
from residual.sensor_config import DEFAULT, PAPER, SensorConfig

_OPTIONS = {"gain": "gain_per_s", "alignment": "alignment", "mode": "mode"}


def sensor_config(arguments: Namespace, friction: FrictionModel | None) -> SensorConfig:
    """Return the preset with the file's settings, then the options', in place of its own.

    Args:
        arguments: With ``paper``, ``config`` (a path or None), ``gain``, ``alignment``, ``mode``.
        friction: Joint friction, or None.

    Raises:
        CommandError: A setting is not valid.
        recordings.RecordingError: The file cannot be read.
    """
    preset = PAPER if arguments.paper else DEFAULT
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
