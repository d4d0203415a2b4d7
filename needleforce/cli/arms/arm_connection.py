"""The arm that a user names, its model, its samples until Ctrl-C, their recording."""

import signal
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from groundtruth import simulate
from groundtruth.rig_arm import SimulatedArm
from needleforce import devices
from needleforce.cli.options import ArmOptions, MotorConstants, RobotOptions
from needleforce.cli.patient.case_files import read_plan_fields
from needleforce.cli.robot import (
    file_of_description,
    labels_of_arm,
    robot_from_options,
)
from needleforce.cli.terminal import (
    OTHER_ROBOT,
    CommandError,
    progress_bar,
    say,
    stop_request,
)
from needleforce.control import Limits
from needleforce.devices import ArmReading, LinkError, ReplayArm, pace
from needleforce.devices.datagram_link import DatagramLink
from needleforce.devices.guard import GuardedArm
from needleforce.devices.link import SILENCE_S
from needleforce.recorder import Recorder
from needleforce.recordings.output import check_writable
from needleforce.ros2 import require_ros
from needleforce.simulation.patient import insert_into_patient

ROBOTS = {"fri": "lwr", "franka": "panda", "ur": "ur10e"}
"""The robot of a kind of arm, unless options describe another."""

NO_TORQUES = (
    "a UR sends motor currents, no torques: give --motor-constants K1 ... K6 [Nm/A]; "
    "docs/how-to/arm-ur.md has those of one arm, and its friction"
)


def say_silence(silent_s: float, what: str = "") -> None:
    """Say on stderr that nothing comes: when it begins, and once a second."""
    if silent_s % 1.0 < SILENCE_S or silent_s < 2.0 * SILENCE_S:
        say(f"{what}silent {silent_s:.1f} s")


class OpenedArm(NamedTuple):
    """An arm that a user has named.

    Attributes:
        arm: The connection, one of `needleforce.devices`, or a simulated arm; with its
            model as `robot`.
        options: Options that describe that robot.
    """

    arm: Any
    options: RobotOptions


@contextmanager
def open_arm(
    name: str,
    options: RobotOptions,
    constants_Nm_A: MotorConstants | None = None,
    *,
    takes_commands: bool = False,
) -> Iterator[OpenedArm]:
    """Open the arm that a user names; it is closed in the end.

    Args:
        name: The arm as the command line names it, such as ``fri:30200``.
        options: Options that describe the robot.
        constants_Nm_A: Torque per motor current of each joint of a UR [Nm/A].
        takes_commands: Whether the arm shall move.

    Raises:
        CommandError: There is no such arm, or the model does not fit it.
    """
    kind, _, place = name.partition(":")
    if constants_Nm_A is not None and kind != "ur":
        raise CommandError(f"--motor-constants describes a ur:ADDRESS, not {name}")
    if kind == "sim":
        simulated = _simulated_arm(name, options, takes_commands=takes_commands)
        yield OpenedArm(simulated, options)
        return
    with ExitStack() as stack:
        described = options
        if kind != "ros2":
            described = _describe_arm(name, options, stack)
        elif not place:
            raise CommandError(f"{name}: expected ros2:TOPIC, as ros2:/joint_states")
        if not described.is_named:
            raise CommandError(
                f"{name} does not say what arm it is, expected --urdf FILE",
                OTHER_ROBOT,
            )
        robot = robot_from_options(described, None)
        if kind == "ros2":
            require_ros()
            from needleforce.ros2.arm import Ros2Arm

            opened: Any = Ros2Arm(
                place, robot.joint_names, takes_commands=takes_commands, robot=robot
            )
        else:
            opened = devices.connect_arm(
                name,
                takes_commands=takes_commands,
                robot=robot,
                torque_constant_Nm_A=constants_Nm_A,
            )
        arm = stack.enter_context(opened)
        if arm.joints != robot.nv:
            raise CommandError(
                f"{name} has {arm.joints} joints, the robot that describes it "
                f"{robot.nv}",
                OTHER_ROBOT,
            )
        yield OpenedArm(arm, described)


def _simulated_arm(
    name: str, options: RobotOptions, *, takes_commands: bool
) -> SimulatedArm | ReplayArm:
    """Return an LWR 4+ that replays a simulated insertion, or moves in free air."""
    scenario = name.removeprefix("sim").removeprefix(":")
    if replace(options, robot=None) != RobotOptions() or not options.is_lwr:
        raise CommandError(
            f"{name} simulates an LWR 4+ with its needle, expected no options of the "
            "robot"
        )
    if takes_commands and scenario:
        raise CommandError(f"{name} moves in free air, expected sim alone")
    if takes_commands:
        return SimulatedArm(plant="clean")
    with progress_bar("simulating"):
        if scenario.endswith(".json"):
            run = insert_into_patient(read_plan_fields(Path(scenario)))
        else:
            run = simulate(scenario or "stack-glove-constant", plant="clean")
    signals = run.signals
    dt_s = np.diff(signals.t_s, prepend=2.0 * signals.t_s[0] - signals.t_s[1])
    return ReplayArm(dt_s, signals.q_rad, signals.dq_rad_s, signals.tau_Nm, run.robot)


def _describe_arm(name: str, options: RobotOptions, stack: ExitStack) -> RobotOptions:
    """Return options with the robot that an arm is taken for, if they name none.

    Args:
        name: The arm as the command line names it.
        options: Options that describe the robot.
        stack: Keeps the file of the description that an arm sends.
    """
    try:
        address = devices.parse_arm_name(name)
    except devices.DeviceSettingError as error:
        # Arms without a connection of their own.
        raise CommandError(f"{error}, ros2:TOPIC or sim[:SCENARIO]") from error
    known = ROBOTS.get(address.kind)
    if options.is_named or (known is None and address.kind != "fr3"):
        return options
    if known is not None:
        say(f"{name} is taken for the arm {known!r}; --robot or --urdf names another")
        return replace(options, robot=known)
    with devices.Fr3Arm(address.host) as arm:
        text = arm.client.model_urdf
    # Names of its flange in its own description.
    names = (one for one in ("fr3_link8", "link8") if f'name="{one}"' in text)
    flange = options.tool_frame or next(names, None)
    say(
        f"the model is the arm's own, its flange {flange}; --urdf and --tool-frame "
        "name others"
    )
    path = stack.enter_context(file_of_description(text, "fr3.urdf"))
    return replace(options, urdf=path, tool_frame=flange)


def ask_to_move(name: str, motion: str) -> None:
    """Ask whether an arm may move; raise `CommandError` unless the answer is yes.

    Args:
        name: The arm as the command line names it.
        motion: In words how it will move.
    """
    if not sys.stdin.isatty():
        raise CommandError(f"{name} would move and nobody can be asked: give --yes")
    say(f"{motion} The needle must be in free air, and the stop button at hand.")
    if input("Move? [y/N] ").strip().lower() not in ("y", "yes"):
        raise CommandError("not confirmed: nothing has moved")


def limits_of(arm: GuardedArm | SimulatedArm) -> Limits:
    """Return the limits of an arm: its preset, or careful ones where that has none."""
    if isinstance(arm, GuardedArm):
        return arm.limits
    # Below those of every preset.
    return Limits(arm.robot, acceleration_rad_s2=5.0, jerk_rad_s3=2500.0)


def samples_until_stopped(
    arm: Any, options: ArmOptions, *, is_paced: bool = True
) -> Iterator[ArmReading]:
    """Yield samples until the time is over or a signal ends it.

    Signals are Ctrl-C, SIGTERM and SIGHUP.

    Args:
        arm: A connection of `needleforce.devices`.
        options: For how long it is listened to.
        is_paced: A simulated arm sends in real time, else as fast as it can.

    Raises:
        CommandError: Nothing came until then.
        LinkError: The arm is lost.
    """
    # What nohup has the process ignore does not end it; else a signal does while
    # nothing comes.
    signals = [
        number
        for number in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(number) != signal.SIG_IGN
    ]
    arm.on_silence = say_silence
    passed_s = 0.0
    with stop_request(*signals, then=arm.end) as is_asked:
        for sample in pace(arm) if is_paced and isinstance(arm, ReplayArm) else arm:
            if not passed_s:
                _say_sender(arm)
            passed_s += sample.dt_s
            yield sample
            if passed_s >= options.seconds or is_asked():
                return
    if not passed_s:
        raise CommandError(f"no sample came ({arm.report}), expected one per cycle")


def _say_sender(arm: Any) -> None:
    """Say which controller is listened to, where none was named."""
    if isinstance(arm, DatagramLink) and not arm.is_peer_named and arm.peer:
        host, port = arm.peer
        say(
            f"{host}, port {port}, was the first to send; only {host} is listened to "
            f"(@{host} after the arm's name makes sure)"
        )


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
    with (
        open_arm(arm_name, robot, options.motor_constants) as (arm, described),
        Recorder(
            output,
            arm.robot.joint_names,
            labels_of_arm(described, arm.robot),
            overwrites=overwrites,
        ) as recorder,
    ):
        if isinstance(arm, DatagramLink):
            arm.drop_waiting()  # what came while the command got ready
        try:
            for sample in samples_until_stopped(arm, options):
                recorder.put(sample)
        except LinkError as error:
            if not recorder.rows:
                raise
            raise error.reworded(
                f"{error}; {output} ends with the last sample, at "
                f"{recorder.time_s:.3f} s"
            ) from error
    say(f"{recorder.rows} samples, {recorder.time_s:.3f} s in {output}; {arm.report}")
    if arm_name.startswith("ur:") and options.motor_constants is None:
        say(f"warning: {output} holds no joint torques: {NO_TORQUES}")
    return 0
