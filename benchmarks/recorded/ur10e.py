"""A real UR10e: motor currents without and with a known payload, and its identified model.

Mamedov, Mikhel, "Practical aspects of model-based collision detection", Front. Robot. AI 7:571574,
2020.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.errors import DataError
from benchmarks.recorded.array_files import read_arrays, read_table
from benchmarks.signals.joint_signals import JointSignals
from residual import JointFriction
from urdf import Robot, SerialJoint, build_serial_robot

FOLDER = "ur10e_mamedov2020"
JOINTS = 6
PINOCCHIO_ORDER = (9, 6, 7, 8, 0, 1, 3, 2, 4, 5)
"""Of the table's ten inertial parameters."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ur10e:
    """The recordings with their model.

    Attributes:
        robot: The arm with its rotors, tool frame at the end link.
        friction: Friction of its joints: torque comes from currents, so all of it is in there.
        unloaded: Signals without payload; torque is torque constant times current.
        loaded: Signals of the same motion with the payload.
    """

    robot: Robot
    friction: JointFriction
    unloaded: JointSignals
    loaded: JointSignals


def read_ur10e(data: Path) -> Ur10e:
    """Read recordings and model from the folder of recordings.

    Raises:
        DataError: A file is missing or lacks something.
    """
    folder = data / FOLDER
    table = read_table(folder / "model.json")
    try:
        constant = np.array(table["torque_constant_Nm_per_A"])
        viscous, coulomb, offset = np.array(table["friction"]["rows"]).T
        robot = _robot(table)
    except KeyError as error:
        raise DataError(f"{folder / 'model.json'} lacks {error}") from error
    return Ur10e(
        robot=robot,
        friction=JointFriction(viscous_Nms=viscous, coulomb_Nm=coulomb, offset_Nm=offset),
        unloaded=_signals(folder / "unloaded.npz", constant),
        loaded=_signals(folder / "payload_2805g.npz", constant),
    )


def _signals(path: Path, torque_constant: np.ndarray) -> JointSignals:
    names = ("t_s", "q_rad", "dq_rad_s", "current_A")
    t_s, q, dq, current = read_arrays(path, names)
    return JointSignals(t_s=t_s, q_rad=q, dq_rad_s=dq, tau_Nm=current * torque_constant)


def _robot(table: dict[str, Any]) -> Robot:
    joints = [
        SerialJoint(
            name=row["name"],
            placement=_placement(row),
            axis=np.array(row["axis"]),
            inertia=np.array(inertia)[list(PINOCCHIO_ORDER)],
        )
        for row, inertia in zip(
            table["joints"][:JOINTS], table["inertial_parameters"]["rows"], strict=True
        )
    ]
    # Identified parameters predict torque; not every link is a possible body.
    return build_serial_robot(
        joints,
        name="ur10e",
        tool_placement=_placement(table["joints"][JOINTS]),
        rotor_inertia_kg_m2=table["rotor_inertia_kg_m2"],
        check_inertias=False,
    )


def _placement(row: dict[str, Any]) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*row["rpy_rad"]), np.array(row["xyz_m"]))
