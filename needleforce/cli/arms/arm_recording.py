"""`needleforce record`: an arm's joint signals into a file."""

from pathlib import Path

from needleforce.cli.arms.arm_connection import (
    NO_TORQUES,
    described_robot,
    open_arm,
    samples_until_stopped,
)
from needleforce.cli.robot import ArmFrames, read_description
from needleforce.cli.shared_options import ArmOptions, RobotOptions
from needleforce.cli.terminal import say
from needleforce.devices import LinkError
from needleforce.devices.datagram_link import DatagramLink
from needleforce.recorder import Recorder
from needleforce.recordings.output import check_writable
from needleforce.recordings.table import TableLabels
from urdf import Robot


def record_signals(
    arm_name: str,
    output: Path,
    options: ArmOptions,
    robot: RobotOptions,
    *,
    overwrites: bool,
) -> int:
    """Write the joint signals of an arm into a file as they come.

    Args:
        arm_name: The arm as the command line names it.
        output: The recording.
        options: For how long the arm is listened to.
        robot: Options that describe the robot.
        overwrites: Whether an older recording is replaced.

    Returns:
        The exit code.
    """
    check_writable(output, overwrites=overwrites)  # before the arm is waited for
    has_torque = True
    with (
        open_arm(arm_name, robot, options.motor_constants) as (arm, model),
        Recorder(
            output,
            model.joint_names,
            _labels_of_arm(arm_name, model, robot),
            overwrites=overwrites,
        ) as recorder,
    ):
        if isinstance(arm, DatagramLink):
            arm.drop_waiting()  # what came while the command got ready
        try:
            for sample in samples_until_stopped(arm, options):
                recorder.put(sample)
                has_torque = sample.tau_Nm is not None
        except LinkError as error:
            if not recorder.rows:
                raise
            raise error.reworded(
                f"{error}; {output} ends with the last sample, at "
                f"{recorder.time_s:.3f} s"
            ) from error
    say(f"{recorder.rows} samples, {recorder.time_s:.3f} s in {output}; {arm.report}")
    if not has_torque:
        say(f"warning: {output} holds no joint torques: {NO_TORQUES}")
    return 0


def _labels_of_arm(arm_name: str, model: Robot, options: RobotOptions) -> TableLabels:
    """Return what lets a bag show the arm."""
    description = read_description(described_robot(arm_name, options))
    return TableLabels(robot_description=description, link_poses=ArmFrames(model))
