"""The joint signals of a log, checked against the robot."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from recordings import ColumnMapping, Log, read_log
from residual.command.errors import CommandError
from urdf import Robot


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointSignals:
    """What a robot has recorded; bad rows are kept, the sensor skips them.

    Attributes:
        t_s: Time stamps on the log's clock [s], shape (n,).
        q_rad: Joint positions [rad], shape (n, joints).
        dq_rad_s: Joint velocities [rad/s], shape (n, joints), or None.
        torque_Nm: Joint torques [Nm], shape (n, joints).
        is_external: Whether they are the robot's own estimate of the external torque rather than
            the measured torque.
        warnings: What is wrong with the recording.
    """

    t_s: NDArray[np.float64]
    q_rad: NDArray[np.float64]
    dq_rad_s: NDArray[np.float64] | None
    torque_Nm: NDArray[np.float64]
    is_external: bool = False
    warnings: tuple[str, ...] = ()

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.t_s)


def read_joint_signals(
    path: str | Path, mapping: ColumnMapping, robot: Robot, *, is_external: bool
) -> JointSignals:
    """Read the joint signals of a log.

    Args:
        path: See `recordings.read_log`.
        mapping: Which columns are which channels.
        robot: The robot it was recorded on.
        is_external: Read the robot's own estimate of external torque instead of measured torque.

    Raises:
        recordings.RecordingError: The log cannot be read.
        CommandError: It has not one column per joint of the robot.
    """
    torque = "tau_ext" if is_external else "tau"
    log = read_log(path, mapping, required=("q", torque), optional=("dq",))
    _check_joints(log, robot)
    return JointSignals(
        t_s=log.t_s,
        q_rad=log["q_rad"],
        dq_rad_s=log.channels.get("dq_rad_s"),
        torque_Nm=log[f"{torque}_Nm"],
        is_external=is_external,
        warnings=log.warnings,
    )


def _check_joints(log: Log, robot: Robot) -> None:
    # A log holds the same number of joints in every channel, so that one stands for all.
    columns = log["q_rad"].shape[1]
    if columns != robot.nv:
        raise CommandError(
            f"the log has {columns} columns per joint signal, the robot has {robot.nv} joints: "
            f"{', '.join(robot.joint_names)}. Choose columns with --q, --tau and so on, or lock "
            "joints with --lock"
        )
