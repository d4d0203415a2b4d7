"""A real Franka Panda in free motion, and its identified model.

Gaz, Cognetti, Oliva, Robuffo Giordano, De Luca, "Dynamic identification of the Franka Emika Panda
robot with retrieval of feasible parameters using penalty-based optimization", RA-L 2019.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.errors import DataError
from benchmarks.recorded.array_files import read_arrays, read_table
from benchmarks.signals.joint_signals import JointSignals
from residual import SigmoidFriction
from urdf import Robot, SerialJoint, build_serial_robot

FOLDER = "panda_gaz2019"
FLANGE_m = 0.107
"""From frame 7 to the flange, along z; from Franka's documentation, the recording has no tool."""
EFFORT_LIMIT_Nm = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
"""From Franka's documentation; the tare takes the range of the torque sensors from it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Panda:
    """The recording with its model.

    Attributes:
        robot: The arm, tool frame at the flange.
        friction: Friction left between torque sensor and link.
        signals: 21 s of free motion.
    """

    robot: Robot
    friction: SigmoidFriction
    signals: JointSignals


def read_panda(data: Path) -> Panda:
    """Read recording and model from the folder of recordings.

    Raises:
        DataError: A file is missing or lacks something.
    """
    folder = data / FOLDER
    names = ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
    t_s, q, dq, tau = read_arrays(folder / "free_motion.npz", names)
    table = read_table(folder / "model.json")
    try:
        robot, friction = _robot(table), _friction(table["friction"])
    except KeyError as error:
        raise DataError(f"{folder / 'model.json'} lacks {error}") from error
    signals = JointSignals(t_s=t_s, q_rad=q, dq_rad_s=dq, tau_Nm=tau)
    return Panda(robot=robot, friction=friction, signals=signals)


def _robot(table: dict[str, Any]) -> Robot:
    joints = []
    for k, (alpha, a, d) in enumerate(
        zip(table["alpha_rad"], table["a_m"], table["d_m"], strict=True)
    ):
        about_x = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, 0.0]))
        placement = about_x * pin.SE3(np.eye(3), np.array([0.0, 0.0, d]))
        xx, xy, xz, yy, yz, zz = table["inertia_kg_m2"][k]
        about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        link = pin.Inertia(table["mass_kg"][k], np.array(table["com_m"][k]), about_com)
        joints.append(
            SerialJoint(
                name=f"joint_{k + 1}",
                placement=placement,
                axis=np.array([0.0, 0.0, 1.0]),
                inertia=link.toDynamicParameters(),
            )
        )
    flange = pin.SE3(np.eye(3), np.array([0.0, 0.0, FLANGE_m]))
    # Identified parameters predict torque; not every link is a possible body.
    robot = build_serial_robot(joints, name="panda", tool_placement=flange, check_inertias=False)
    limited = pin.Model(robot.bare_model)
    limited.upperEffortLimit = np.array(EFFORT_LIMIT_Nm)
    return replace(robot, bare_model=limited)


def _friction(table: dict[str, Any]) -> SigmoidFriction:
    return SigmoidFriction(
        amplitude_Nm=np.array(table["A_Nm"]),
        slope_s_rad=np.array(table["alpha_s_rad"]),
        shift_rad_s=np.array(table["s_rad_s"]),
    )
