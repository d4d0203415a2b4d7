"""One tick: joint velocities for a sample of the arm and a stack of tasks.

The tasks are served in strict priority within the limits of the joints, see
`priority_solver` and `joint_limits`.
"""

import math
from collections.abc import Sequence
from enum import StrEnum
from operator import is_
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from foundation.jit import compile_waiting
from needleforce.control.errors import ControlCode, SettingError
from needleforce.control.joint_limits import (
    Limits,
    SLACK_rad_s,
    write_velocity_bounds,
)
from needleforce.control.ports import ArmSample
from needleforce.control.priority_solver import Solver, Stack, hierarchical
from needleforce.control.setting_checks import as_vector
from needleforce.control.tasks import JointTask, MAX_STEP_s, Task, ToolState
from urdf import Robot

FIRST_STEP_s = 1e-3
"""Time step that a first, invalid sample is braked with: the usual cycle."""


class CommandStatus(StrEnum):
    """How a command came about."""

    OK = "ok"  # the tasks in order of priority, no limit in the way
    SATURATED = "saturated"  # the same, with at least one joint at a limit
    BRAKING = "braking"  # no task: as slow as the limits allow
    SKIPPED = "skipped"  # sample or task invalid: braking without them


class Command(NamedTuple):
    """Joint velocities for the coming cycle.

    Attributes:
        dq_rad_s: To be sent to the arm, shape (n,).
        status: How they came about.
        reason: Why the sample or a task was skipped; empty otherwise.
    """

    dq_rad_s: Array
    status: CommandStatus
    reason: str = ""


class Controller:
    """Turns samples and stacks of tasks into joint velocities; see `update`.

    Args:
        robot: The arm; the z axis of its tool frame is the needle.
        limits: What its joints may do.
        solve: Strict priority within limits; another one to compare with, not to move
            an arm.

    Attributes:
        tool: Pose and Jacobian of the tip at the last valid sample.
        last_rad_s: The velocity commanded last, shape (n,).

    Raises:
        SettingError: The limits are those of another robot.
    """

    def __init__(
        self, robot: Robot, limits: Limits, solve: Solver = hierarchical
    ) -> None:
        compile_waiting()
        if (joints := limits.joints.speed_rad_s.size) != robot.nv:
            raise SettingError(
                f"limits of {joints} joints, the robot has {robot.nv}",
                ControlCode.LIMITS,
            )
        self.tool = ToolState(robot)
        self._limits = limits.joints
        self._limit_rows = np.array(limits.joints)
        self._joints = joints
        self._solve = solve
        self._stacks: dict[tuple[int, ...], Stack] = {}
        self._tasks = list[Task]()
        self._stack = Stack((), robot.nv)
        self._step_s = FIRST_STEP_s
        self.reset()

    def reset(self, dq_rad_s: Array | None = None) -> None:
        """Begin from the velocity that the arm has, within its limits, or from rest.

        Call it when the arm has not followed: its commands were refused, or it has
        stopped itself.

        Raises:
            SettingError: The velocity is anything but n finite numbers.
        """
        velocity_rad_s = np.zeros(self._joints)
        if dq_rad_s is not None:
            velocity_rad_s = as_vector(dq_rad_s, self._joints, "dq_rad_s")
        max_rad_s = self._limits.speed_rad_s
        self.last_rad_s = np.clip(velocity_rad_s, -max_rad_s, max_rad_s)

    def update(self, sample: ArmSample, stack: Sequence[Task]) -> Command:
        """Return the command for the coming cycle; never raise, always answer.

        Errors of tasks are of the measured positions, and the command starts from the
        last one: that keeps noise of measured velocities out of it, and the
        accelerations within limits.

        Args:
            sample: What the arm reports.
            stack: Tasks, the most important first; with none the arm brakes and rests.
        """
        try:
            q_rad = np.ascontiguousarray(sample.q_rad, np.float64)
            dt_s = float(sample.dt_s)
            if q_rad.shape != (self._joints,) or not 0.0 < dt_s < math.inf:
                return self._brake(f"{q_rad.size} positions, dt_s = {dt_s:g}")
            if not math.isfinite(q_rad.dot(q_rad)):
                return self._brake("positions are not finite")
            self._step_s = min(dt_s, MAX_STEP_s)
            self.tool.update(q_rad)
            self._select_stack(stack)
            numbers = self._stack
            numbers.fill(stack, self.tool)
            write_velocity_bounds(
                self._limit_rows, q_rad, self.last_rad_s, self._step_s, numbers.bounds
            )
            if not stack:
                slowest_rad_s = np.clip(0.0, *numbers.bounds)
                return self._command(slowest_rad_s, CommandStatus.BRAKING)
            velocity_rad_s, is_limited = self._solve(numbers)
        except Exception as error:  # whatever a sample or a stranger's task brings
            return self._brake(f"{type(error).__name__}: {error}")
        return self._command(
            velocity_rad_s, CommandStatus.SATURATED if is_limited else CommandStatus.OK
        )

    def _select_stack(self, tasks: Sequence[Task]) -> None:
        """Select the arrays for tasks of these sizes; make them where they are new.

        The tasks of the last tick need no look: whatever has changed in them, their
        sizes have not.
        """
        if len(tasks) == len(self._tasks) and all(map(is_, tasks, self._tasks)):
            return
        has_joint_task = bool(tasks) and isinstance(tasks[-1], JointTask)
        key = (has_joint_task, *[task.size for task in tasks])
        if key not in self._stacks:
            self._stacks[key] = Stack(tasks, self._joints)
        self._tasks = list(tasks)
        self._stack = self._stacks[key]

    def _brake(self, reason: str) -> Command:
        """Brake from the last command at the rate that limits allow."""
        change = self._limits.acceleration_rad_s2 * self._step_s - SLACK_rad_s
        velocity_rad_s = self.last_rad_s - np.clip(self.last_rad_s, -change, change)
        return self._command(velocity_rad_s, CommandStatus.SKIPPED, reason)

    def _command(
        self, velocity_rad_s: Array, status: CommandStatus, reason: str = ""
    ) -> Command:
        """Remember a velocity as the last one, and return it as a command."""
        velocity_rad_s.setflags(write=False)
        self.last_rad_s = velocity_rad_s
        return Command(velocity_rad_s, status, reason)
