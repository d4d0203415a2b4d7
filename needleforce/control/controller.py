"""One tick: from a sample of the arm and a stack of tasks to joint velocities within limits."""

import math
from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from needleforce.control.errors import SettingError
from needleforce.control.ports import ArmSample, Array
from needleforce.control.priority_solver import (
    ACCELERATION,
    SPEED,
    Limits,
    LONGEST_STEP_s,
    SLACK_rad_s,
    Solver,
    Stack,
    hierarchical,
    joint_bounds,
)
from needleforce.control.tasks import JointVelocity, Task, ToolState, vector
from urdf import Robot


class CommandStatus(StrEnum):
    """How a command came about."""

    OK = "ok"  # the tasks in order of priority, no limit in the way
    SATURATED = "saturated"  # the same, with at least one joint at a limit
    BRAKING = "braking"  # no task: as slow as the limits allow
    SKIPPED = "skipped"  # sample or task no good, see `Command.reason`: braking without them


_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick
_OK, _SATURATED = CommandStatus.OK, CommandStatus.SATURATED


class Command(NamedTuple):
    """Joint velocities for the coming cycle."""

    dq_rad_s: Array  # to be sent to the arm, shape (n,)
    status: CommandStatus
    reason: str = ""  # why it was skipped; empty otherwise


class Controller:
    """Turns samples and stacks of tasks into joint velocities; see `update`.

    Args:
        robot: The arm; the z axis of its tool frame is the needle.
        limits: What its joints may do; `SettingError` for those of another robot.
        solve: Strict priority within limits; another one to compare with, not to move an arm.

    Attributes:
        tool: Pose and Jacobian of the tip at the last valid sample.
        last_rad_s: What was commanded last, shape (n,).
    """

    def __init__(self, robot: Robot, limits: Limits, solve: Solver = hierarchical) -> None:
        if limits.table.shape != (4, robot.nv):
            raise SettingError(
                f"limits of {limits.table.shape[1]} joints, the robot has {robot.nv}"
            )
        self.tool = ToolState(robot)
        self._limits, self._joints, self._solve = limits.table, robot.nv, solve
        self._stacks: dict[tuple[int, ...], Stack] = {}
        self._tasks, self._numbers = list[Task](), Stack((), robot.nv)
        self._step_s = 1e-3
        self.reset()

    def reset(self, dq_rad_s: Array | None = None) -> None:
        """Begin from the velocity that the arm has, shape (n,), within its limits, or from rest.

        Call it when the arm has not followed: its commands were refused, or it has stopped itself.
        `SettingError` for anything but n finite numbers.
        """
        rest = np.zeros(self._joints)
        now = rest if dq_rad_s is None else vector(dq_rad_s, self._joints, "dq_rad_s")
        self.last_rad_s = np.clip(now, -self._limits[SPEED], self._limits[SPEED])

    def update(self, sample: ArmSample, stack: Sequence[Task]) -> Command:
        """The command for the coming cycle. It never raises and always answers.

        Errors of tasks are of the measured positions, and the command starts from the last one:
        that keeps noise of measured velocities out of it, and the accelerations within limits.

        Args:
            sample: What the arm reports.
            stack: Tasks, the most important first; with none the arm brakes and rests.
        """
        try:
            q, dt_s = np.ascontiguousarray(sample.q_rad, np.float64), float(sample.dt_s)
            if q.shape != (self._joints,) or not 0.0 < dt_s < math.inf:
                return self._skip(f"{q.size} positions, dt_s = {dt_s:g}")
            if not math.isfinite(q.dot(q)):
                return self._skip("positions are not finite")
            self._step_s = min(dt_s, LONGEST_STEP_s)
            self.tool.update(q)
            numbers = self._numbers_of(stack)
            numbers.fill(stack, self.tool)
            joint_bounds(self._limits, q, self.last_rad_s, self._step_s, numbers.bounds)
            if not stack:
                return self._send(np.clip(0.0, *numbers.bounds), CommandStatus.BRAKING)
            velocity, is_limited = self._solve(numbers)
        except Exception as error:  # whatever a sample or a stranger's task brings
            return self._skip(f"{type(error).__name__}: {error}")
        return self._send(velocity, _SATURATED if is_limited else _OK)

    def _numbers_of(self, stack: Sequence[Task]) -> Stack:
        """Room for the numbers of a stack; made when one of such tasks comes first."""
        if stack != self._tasks:  # the same tasks are equal, whatever has changed in them
            has_wish = bool(stack) and isinstance(stack[-1], JointVelocity)
            key = (has_wish, *[task.size for task in stack])
            if key not in self._stacks:
                self._stacks[key] = Stack(stack, self._joints)
            self._numbers, self._tasks = self._stacks[key], list(stack)
        return self._numbers

    def _skip(self, reason: str) -> Command:
        """Brake from the last command at the rate that limits allow."""
        change = self._limits[ACCELERATION] * self._step_s - SLACK_rad_s
        velocity = self.last_rad_s - np.clip(self.last_rad_s, -change, change)
        return self._send(velocity, CommandStatus.SKIPPED, reason)

    def _send(self, velocity: Array, status: CommandStatus, reason: str = "") -> Command:
        velocity.setflags(write=False)
        self.last_rad_s = velocity
        return _new(Command, (velocity, status, reason))
