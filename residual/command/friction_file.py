"""What lies between torque measurement and link, from the option ``--friction``."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recordings.toml_file import read_toml
from residual.command.dataclass_table import build, dataclass_values
from residual.command.errors import CommandError
from residual.joint_friction import FrictionModel, JointFriction, SigmoidFriction

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
