"""`needleforce record`: an arm's joint signals into a file."""

from pathlib import Path

from needleforce.cli.arms.arm_connection import (
    NO_TORQUES,
    open_arm,
    require_samples,
    samples_until_stopped,
)
from needleforce.cli.arms.recorder import Recorder
from needleforce.cli.shared_options import ArmOptions, RobotOptions
from needleforce.cli.terminal import say


def record_signals(
    arm_name: str, output: Path, options: ArmOptions, robot: RobotOptions
) -> int:
    """Write the joint signals of an arm as they come; return the exit code."""
    has_torque = True
    with (
        open_arm(arm_name, robot, options.motor_constants) as (arm, model),
        Recorder(output, model.joint_names) as to,
    ):
        for sample in samples_until_stopped(arm, options):
            to.put(sample)
            has_torque = sample.tau_Nm is not None
    require_samples(arm_name, arm)
    say(f"{to.rows} samples, {to.time_s:.3f} s in {output}; {arm.report}")
    if not has_torque:
        say(f"warning: {output} holds no joint torques: {NO_TORQUES}")
    return 0
