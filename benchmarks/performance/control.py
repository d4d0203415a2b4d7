"""What a tick of control costs, beside the bare Pinocchio calls it cannot do without.

The samples are those of an arm whose tip draws a circle about a remote centre, at
leisure and so fast that limits bind. Subjects take turns, so ratios hold on a busy
machine; tails are of processor time, on which other processes do not count.
"""

import math
from collections.abc import Iterator
from time import thread_time_ns

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.jobs import Figure, Job
from benchmarks.performance.ticks import (
    Update,
    cost_ratio,
    time_each,
    time_side_by_side,
)
from groundtruth.rig_arm import ArmSample, SimulatedArm
from needleforce.control import (
    Controller,
    Limits,
    Posture,
    RemoteCentre,
    Task,
    TipVelocity,
)

BARE = "Jacobian and placement"
CONTROL = "control"
FOLLOWING = "control, no remote centre"
SATURATED = "control, limits bind"
SECONDS = 8.0
WARM_TICKS = 1000
BEHIND_TIP_M = 0.08
RADIUS_M = 0.02


class _Loop:
    """Controller and tasks of one arm; the tip goes round once in a period.

    Its axis passes through a remote centre, unless it only follows with the tip.
    """

    def __init__(
        self, arm: SimulatedArm, period_s: float, *, has_centre: bool = True
    ) -> None:
        self.control = Controller(arm.robot, Limits(arm.robot))
        tool = self.control.tool
        tool.update(arm.home_rad)
        self._start_m = tool.tip_m
        self._rate = 2.0 * math.pi / period_s
        self._tip = TipVelocity((0.0, 0.0, 0.0), self._start_m, gain_per_s=10.0)
        centre = RemoteCentre(tool.tip_m - BEHIND_TIP_M * tool.axis)
        self._stack: list[Task] = [centre] if has_centre else []
        self._stack += [self._tip, Posture(arm.home_rad)]
        self._goals = [self._goal(1e-3 * k) for k in range(round(1e3 * SECONDS) + 1)]

    def _goal(self, t_s: float) -> NDArray[np.float64]:
        """Return the goal of the tip at a time [m]."""
        angle = self._rate * t_s
        return self._start_m + RADIUS_M * np.array(
            (math.cos(angle) - 1.0, math.sin(angle), 0.0)
        )

    def command(self, sample: ArmSample, k: int) -> NDArray[np.float64]:
        """Return joint velocities after sample k."""
        self._tip.goal_m = self._goals[k]
        return self.control.update(sample, self._stack).dq_rad_s


Recorded = tuple[float, list[ArmSample]]
"""The time in which the tip of an arm went round once [s], and a sample per cycle."""


def command_again(recorded: Recorded, *, has_centre: bool = True) -> Update:
    """Return what gives a new loop sample k."""
    period_s, samples = recorded
    arm = SimulatedArm(plant="clean", duration_s=SECONDS)
    loop = _Loop(arm, period_s, has_centre=has_centre)
    return lambda k: loop.command(samples[k], k)


def record(period_s: float) -> Recorded:
    """Let an arm go round once in a period."""
    arm = SimulatedArm(plant="clean", duration_s=SECONDS)
    loop = _Loop(arm, period_s)
    samples = []
    for k, sample in enumerate(arm):
        samples.append(sample)
        arm.send(loop.command(sample, k))
    return period_s, samples


def record_both() -> tuple[Recorded, Recorded]:
    """Return samples at leisure, and some so fast that limits bind."""
    return record(SECONDS), record(0.5)


def make_control(at_leisure: Recorded, hasty: Recorded) -> dict[str, Update]:
    """Return new loops, after their bare calls."""
    robot = SimulatedArm(plant="clean", duration_s=1.0).robot
    model = robot.model
    data = robot.create_data()
    frame = robot.tool_frame_id
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    _, samples = at_leisure

    def bare(k: int) -> None:
        pin.computeFrameJacobian(model, data, samples[k].q_rad, frame, axes)
        pin.updateFramePlacement(model, data, frame)

    return {
        BARE: bare,
        CONTROL: command_again(at_leisure),
        FOLLOWING: command_again(at_leisure, has_centre=False),
        SATURATED: command_again(hasty),
    }


def run(job: Job) -> Iterator[Figure]:
    """Time ticks of control."""
    at_leisure, hasty = record_both()
    subjects = make_control(at_leisure, hasty)
    times = time_side_by_side(subjects, WARM_TICKS, round(1e3 * SECONDS))
    again = range(WARM_TICKS, round(1e3 * SECONDS))
    for name, update in subjects.items():
        yield Figure("tick_median_us", np.median(times[name]), name)
        yield Figure("tick_ratio", cost_ratio(times[name], times[BARE]), name)
        # Processor time that 999 of 1000 updates keep to.
        again_us = time_each(update, again, thread_time_ns)
        yield Figure("tick_tail_us", np.percentile(again_us, 99.9), name)
