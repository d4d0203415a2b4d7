"""The joint signals of a log, checked against the robot."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from recordings.log_stream import LogChunk
from residual.command.errors import CommandError
from urdf import Robot


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointSignals:
    """Consecutive rows of what a robot has recorded; bad rows are kept, the sensor skips them.

    Attributes:
        t_s: Time stamps on the log's clock [s], shape (n,).
        dt_s: Time since the latest row that advanced [s], shape (n,), see
            `recordings.clock.row_clock`.
        q_rad: Joint positions [rad], shape (n, joints).
        dq_rad_s: Joint velocities [rad/s], shape (n, joints), or None.
        torque_Nm: Joint torques [Nm], shape (n, joints).
        is_external: Whether they are the robot's own estimate of the external torque rather than
            the measured torque.
    """

    t_s: NDArray[np.float64]
    dt_s: NDArray[np.float64]
    q_rad: NDArray[np.float64]
    dq_rad_s: NDArray[np.float64] | None
    torque_Nm: NDArray[np.float64]
    is_external: bool = False

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.t_s)


def torque_channel(*, is_external: bool) -> str:
    """Return the channel of a log that holds the torque."""
    return "tau_ext" if is_external else "tau"


def joint_signals(chunk: LogChunk, robot: Robot, *, is_external: bool) -> JointSignals:
    """Return the joint signals of some rows of a log.

    Args:
        chunk: The rows, with the channels `q`, `torque_channel` and perhaps `dq`.
        robot: The robot it was recorded on.
        is_external: Take the robot's own estimate of external torque, not measured torque.

    Raises:
        CommandError: The log has not one column per joint of the robot.
    """
    channels = chunk.channels
    # A log holds the same number of joints in every channel, so that one stands for all.
    columns = channels["q_rad"].shape[1]
    if columns != robot.nv:
        raise CommandError(
            f"the log has {columns} columns per joint signal, the robot has {robot.nv} joints: "
            f"{', '.join(robot.joint_names)}. Choose columns with --q, --tau and so on, or lock "
            "joints with --lock"
        )
    return JointSignals(
        t_s=chunk.t_s,
        dt_s=chunk.dt_s,
        q_rad=channels["q_rad"],
        dq_rad_s=channels.get("dq_rad_s"),
        torque_Nm=channels[f"{torque_channel(is_external=is_external)}_Nm"],
        is_external=is_external,
    )
