"""The arm that a user names, its model, and its samples until Ctrl-C."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from groundtruth import simulate
from needleforce.cli.robot import robot_from_options
from needleforce.cli.shared_options import ArmOptions, RobotOptions
from needleforce.cli.terminal import CommandError, progress_bar, say, stop_request
from needleforce.devices import (
    ArmReading,
    FrankaArm,
    FriArm,
    ReplayArm,
    UrArm,
    pace,
)
from urdf import Robot

ROBOTS = {
    "fri": "lwr",
    "franka": "panda",
    "ur": "ur10e",
}  # Of a kind of arm, unless described


NO_TORQUES = (
    "a UR sends motor currents, no torques: give --motor-constants K1 ... K6 [Nm/A]; "
    "docs/panda.md has those of one arm, and its friction"
)


@contextmanager
def open_arm(
    text: str, options: RobotOptions, constants_Nm_A: tuple[float, ...] | None = None
) -> Iterator[tuple[Any, Robot]]:
    """Open the arm that a user names, with its model; it is closed in the end."""
    kind, _, rest = text.partition(":")
    if constants_Nm_A is not None and kind != "ur":
        raise CommandError(f"--motor-constants describes a ur:ADDRESS, not {text}")
    if kind == "sim":
        if options not in (RobotOptions(), RobotOptions(robot="lwr")):
            raise CommandError(
                f"{text} simulates an LWR 4+ with its needle; leave the options of the robot out"
            )
        with progress_bar("simulating"):
            run = simulate(rest or "stack-glove-constant", plant="clean")
        signals = run.signals
        dt_s = np.diff(signals.t_s, prepend=2.0 * signals.t_s[0] - signals.t_s[1])
        yield (
            ReplayArm(dt_s, signals.q_rad, signals.dq_rad_s, signals.tau_Nm),
            run.robot,
        )
        return
    is_port = rest.isdecimal() or not rest
    if kind not in ROBOTS or (not is_port if kind == "fri" else not rest):
        raise CommandError(
            f"{text}: expected an arm as fri, fri:PORT, franka:ADDRESS, ur:ADDRESS or sim:SCENARIO"
        )
    if options.robot is None and options.urdf is None:
        options = replace(options, robot=ROBOTS[kind])
        say(
            f"{text} is taken for the arm {options.robot!r}; --robot or --urdf names another"
        )
    robot = robot_from_options(options, None)
    if kind == "fri":
        arm: Any = FriArm(port=int(rest)) if rest else FriArm()
    else:
        is_ur = kind == "ur"
        arm = (
            UrArm(rest, torque_constant_Nm_A=constants_Nm_A)
            if is_ur
            else FrankaArm(rest)
        )
    with arm:
        if arm.joints != robot.nv:
            raise CommandError(
                f"{text} has {arm.joints} joints, the robot that describes it {robot.nv}: "
                "name another with --robot or --urdf"
            )
        yield arm, robot


def samples_until_stopped(arm: Any, options: ArmOptions) -> Iterator[ArmReading]:
    """Samples until the time is over, the arm stays away, or Ctrl-C, SIGTERM or
    SIGHUP.
    """
    if not options.seconds > 0.0:
        raise CommandError(f"--seconds {options.seconds}: expected a positive time")
    # What nohup has the process ignore does not end it; else a signal does while
    # nothing comes.
    others = [
        n
        for n in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(n) != signal.SIG_IGN
    ]
    passed_s = 0.0
    with stop_request(*others, then=arm.end) as is_asked:
        for sample in pace(arm) if isinstance(arm, ReplayArm) else arm:
            passed_s += sample.dt_s
            yield sample
            if passed_s >= options.seconds or is_asked():
                return


def require_samples(arm_name: str, arm: Any) -> None:
    """Raise `CommandError` if nothing came from an arm."""
    if not arm.report.used:
        raise CommandError(
            f"no sample came from {arm_name} ({arm.report}): expected one per cycle; does the arm "
            "run, and does it send to this machine and port?"
        )
