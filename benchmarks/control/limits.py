"""Whether commands stay within what each arm accepts, for a minute about an entry.

The needle goes in 10 mm past a remote centre, tilts by 20 degrees in two seconds (half
a second where *quick*) and goes round on that cone. Positions carry noise of 1e-5 rad;
commands act at once or after 10 ms, which the controller knows where *known*, and one
cycle in a hundred is lost, which repeats the command before. The arm integrates what
reaches it: no dynamics, so that what is counted is the controller's. Limits are those
of `ARM_LIMITS`, errors those of true positions.
"""

import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from time import thread_time_ns
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.jobs import Figure, Job
from foundation.arrays import Array
from groundtruth.rig_arm import ArmSample
from groundtruth.rig_contacts import distance_to_axis_m
from needleforce.control.controller import Controller
from needleforce.control.joint_limits import Limits
from needleforce.control.tasks import (
    Posture,
    RemoteCentre,
    TipVelocity,
    ToolState,
)
from needleforce.devices.arm_limits import ARM_LIMITS, ArmLimits
from urdf import NeedleTool, Robot, load_example, load_lwr

DURATION_s = 60.0
"""Of a run."""
DEPTH_m = 0.01
"""Of the tip past the entry."""
MILLI = 1e3


class Arm(NamedTuple):
    """An arm of the benchmark.

    Attributes:
        load: Returns its model with the needle.
        posture_rad: Where it begins.
    """

    load: Callable[[], Robot]
    posture_rad: tuple[float, ...]


def _load_iiwa() -> Robot:
    """Return an iiwa 14 with the needle: the LWR's axes and limits, other lengths.

    Base to A2 360 mm, A2 to A4 420 mm, A4 to A6 400 mm, A6 to the flange 126 mm, of
    KUKA's data sheet; no masses matter here.
    """
    robot = load_lwr(payload=NeedleTool())
    placements = robot.model.jointPlacements
    heights_m = [placement.translation[2] for placement in placements]
    for lower, upper, length_m in ((1, 2, 0.36), (3, 4, 0.42), (5, 6, 0.40)):
        own_m = heights_m[lower] + heights_m[upper]
        for joint in (lower, upper):
            placements[joint].translation[2] *= length_m / own_m
    placements[7].translation[2] = 0.126
    return robot


def _load_panda() -> Robot:
    """Return a Franka arm with the needle; FER and FR3 have the same lengths."""
    return load_example("panda", without=["panda_hand"], payload=NeedleTool())


_KUKA_POSTURE_rad = (0.0, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0)
_FRANKA_POSTURE_rad = (0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785)
ARMS = {
    "lwr": Arm(lambda: load_lwr(payload=NeedleTool()), _KUKA_POSTURE_rad),
    "fr3": Arm(_load_panda, _FRANKA_POSTURE_rad),
    "fer": Arm(_load_panda, _FRANKA_POSTURE_rad),
    "ur5e": Arm(
        lambda: load_example("ur5e", payload=NeedleTool()),
        (0.0, -1.571, 1.571, -1.571, -1.571, 0.0),
    ),
    "iiwa14": Arm(_load_iiwa, _KUKA_POSTURE_rad),
}


LATE_ms = 10
"""A delay as networks and soft servos have it."""
CASES = tuple(
    f"{arm} {rest}"
    for arm in ARMS
    for rest in (
        "0ms",
        "0ms quick",
        f"{LATE_ms}ms",
        f"{LATE_ms}ms quick",
        f"{LATE_ms}ms quick known",
    )
)
"""The arm, the delay from command to motion, whether the needle tilts quickly, whether
the controller knows the delay."""


@dataclass(frozen=True)
class ConeRun:
    """What a minute on the cone leaves.

    Attributes:
        robot: The arm.
        positions_rad: True positions, cycle by cycle, shape (N, n).
        commands_rad_s: What reached the arm's inlet, shape (N, n).
        errors_m: True axis to entry, shape (N,).
        taken_us: Processor time of each update that was not lost.
        is_limited: Whether its command met a limit.
    """

    robot: Robot
    positions_rad: Array
    commands_rad_s: Array
    errors_m: Array
    taken_us: Array
    is_limited: NDArray[np.bool_]


class Cone:
    """The cone that the needle goes round, and the tasks that lead it.

    Args:
        tool: The needle, as it begins.
        posture_rad: Joint positions that the arm keeps near to, shape (n,).

    Attributes:
        entry_m: Its apex, shape (3,).
        tasks: The entry first, then the tip, then the posture.
    """

    def __init__(self, tool: ToolState, posture_rad: Array) -> None:
        self._axes = tool.rotation
        self.entry_m = tool.tip_m - DEPTH_m * tool.axis
        self._tip = TipVelocity((0.0, 0.0, 0.0), tool.tip_m, 10.0)
        self.tasks = (RemoteCentre(self.entry_m), self._tip, Posture(posture_rad))

    def move_goal(self, t_s: float, tilt_s: float) -> None:
        """Set the goal of the tip at a time, with the time of the tilt."""
        grown = min(t_s / tilt_s, 1.0)
        tilt_rad = math.radians(20.0) * grown**2 * (3.0 - 2.0 * grown)
        angle_rad = 2.0 * math.pi * t_s / 8.0  # once round in 8 s
        across = math.sin(tilt_rad)
        direction = np.array(
            (
                across * math.cos(angle_rad),
                across * math.sin(angle_rad),
                math.cos(tilt_rad),
            )
        )
        self._tip.goal_m = self.entry_m + DEPTH_m * self._axes @ direction


def run_cone(
    name: str, delay_ms: int, words: Sequence[str], rng: np.random.Generator
) -> ConeRun:
    """Move an arm onto the cone, and round it for `DURATION_s`.

    Args:
        name: A name of `ARMS`.
        delay_ms: From command to motion.
        words: ``quick``: the needle tilts in half a second instead of two; ``known``:
            the controller knows the delay.
        rng: Draws noise and losses.
    """
    arm = ARMS[name]
    robot = arm.load()
    cycle_s = ARM_LIMITS[name].cycle_s
    tilt_s = 0.5 if "quick" in words else 2.0
    delay_s = delay_ms / MILLI
    limits = Limits.of_arm(robot, name)
    control = Controller(robot, limits, delay_s=delay_s if "known" in words else None)
    truth = ToolState(robot)
    q_rad = np.array(arm.posture_rad)
    truth.update(q_rad)
    cone = Cone(truth, q_rad)
    command_rad_s = np.zeros(robot.nv)
    waiting = deque([command_rad_s] * round(delay_s / cycle_s))
    since_s = 0.0
    positions = list[Array]()
    commands = list[Array]()
    errors_m = list[float]()
    taken_us = list[float]()
    limited = list[bool]()
    for cycle in range(round(DURATION_s / cycle_s)):
        cone.move_goal(cycle * cycle_s, tilt_s)
        since_s += cycle_s
        if rng.random() >= 0.01:  # else the cycle is lost
            measured_rad = q_rad + 1e-5 * rng.standard_normal(robot.nv)
            sample = ArmSample(since_s, measured_rad, None, np.zeros(robot.nv))
            begin_ns = thread_time_ns()
            command = control.update(sample, cone.tasks)
            taken_us.append(1e-3 * (thread_time_ns() - begin_ns))
            limited.append(command.is_limited)
            command_rad_s = command.dq_rad_s
            since_s = 0.0
        commands.append(command_rad_s)
        waiting.append(command_rad_s)
        q_rad = q_rad + cycle_s * waiting.popleft()
        truth.update(q_rad)
        positions.append(q_rad)
        errors_m.append(distance_to_axis_m(cone.entry_m, truth.tip_m, truth.axis))
    return ConeRun(
        robot,
        np.array(positions),
        np.array(commands),
        np.array(errors_m),
        np.array(taken_us),
        np.array(limited),
    )


def count_excess(run: ConeRun, preset: ArmLimits) -> dict[str, int]:
    """Count cycles in which a joint is beyond a limit, by its name."""
    at_rest = np.zeros((1, run.robot.nv))
    velocities = np.vstack((at_rest, run.commands_rad_s))
    accelerations = np.diff(velocities, axis=0) / preset.cycle_s
    jerks = np.diff(np.vstack((at_rest, accelerations)), axis=0) / preset.cycle_s
    ratios = {
        "speed": np.abs(velocities) / preset.speed_rad_s,
        "acceleration": np.abs(accelerations) / preset.acceleration_rad_s2,
        "jerk": np.abs(jerks) / preset.jerk_rad_s3,
    }
    # Passed by more than a millionth: differences of doubles round.
    counts = {
        name: int((ratio > 1.0 + 1e-6).any(axis=1).sum())
        for name, ratio in ratios.items()
    }
    is_below = run.positions_rad < run.robot.position_lower_rad
    is_above = run.positions_rad > run.robot.position_upper_rad
    counts["position"] = int((is_below | is_above).any(axis=1).sum())
    return counts


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of an arm at a delay; no plant plays a part."""
    arm, delay, *words = job.case.split()
    delay_ms = int(delay.removesuffix("ms"))
    run = run_cone(arm, delay_ms, words, np.random.default_rng(job.seed))
    for limit, count in count_excess(run, ARM_LIMITS[arm]).items():
        yield Figure(f"ticks_above_{limit}_limit", count)
    yield Figure("rcm_error_max_mm", MILLI * run.errors_m.max())
    yield Figure("rcm_error_rms_mm", MILLI * np.sqrt(np.mean(run.errors_m**2)))
    yield Figure("ticks_at_limit", run.is_limited.sum())
    # The first tick is slow: ten at a limit, and away from one, are needed.
    if 10 <= run.is_limited.sum() <= run.is_limited.size - 10:
        limited_us = np.median(run.taken_us[run.is_limited])
        ratio = limited_us / np.median(run.taken_us[~run.is_limited])
        yield Figure("tick_ratio_at_limit", ratio)
