"""One tick: from a sample of the arm and a stack of tasks to joint velocities within limits."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Literal, NamedTuple

import numpy as np

from needleforce.control.errors import ControlError, SettingError
from needleforce.control.ports import ArmReading, Array
from needleforce.control.priority_solver import Hierarchical, Published, Solver, Stack
from needleforce.control.tasks import Task
from needleforce.control.tool_state import ToolState
from needleforce.control.velocity_box import (
    ACCELERATION,
    Limits,
    LONGEST_STEP_s,
    assess,
    fill_bounds,
)
from urdf import Robot

SOLVERS: dict[str, type[Solver]] = {"hierarchical": Hierarchical, "published": Published}


class CommandStatus(StrEnum):
    """How a command came about."""

    OK = "ok"
    """The tasks in order of priority, no limit in the way."""
    SATURATED = "saturated"
    """The same, with at least one joint at a limit."""
    BRAKING = "braking"
    """No task, or none that could be solved: as slow as the limits allow."""
    SKIPPED = "skipped"
    """The sample or a task was no good, see `Command.reason`: braking without looking at them."""


class Command(NamedTuple):
    """Joint velocities for the coming cycle.

    Attributes:
        dq_rad_s: To be sent to the arm, shape (n,).
        status: How it came about.
        missed: Largest part of each task's rates that this command leaves unmet [m/s or rad/s];
            empty unless solved. A posture below other tasks always misses something.
        reason: Why it was skipped or braked; empty otherwise.
    """

    dq_rad_s: Array
    status: CommandStatus
    missed: Array
    reason: str = ""


_OK, _SATURATED = CommandStatus.OK, CommandStatus.SATURATED
_NOTHING = np.zeros(0)
_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick


class Controller:
    """Turns samples and stacks of tasks into joint velocities; see `update`.

    Args:
        robot: The arm; the z axis of its tool frame is the needle.
        limits: What its joints may do.
        solver: ``hierarchical``, or ``published`` for the recursion as published, which knows no
            limits: to compare with, not to move an arm.

    Attributes:
        tool: Pose and Jacobian of the tip at the last valid sample.

    Raises:
        SettingError: For another solver, or limits of another robot.
    """

    def __init__(
        self,
        robot: Robot,
        limits: Limits,
        solver: Literal["hierarchical", "published"] = "hierarchical",
    ) -> None:
        if solver not in SOLVERS:
            raise SettingError(f"no solver {solver!r}; expected one of {', '.join(SOLVERS)}")
        if limits.table.shape != (4, robot.nv):
            raise SettingError(
                f"limits of {limits.table.shape[1]} joints, the robot has {robot.nv}"
            )
        self.tool = ToolState(robot)
        self._limits, self._joints = limits.table, robot.nv
        self._solver = SOLVERS[solver]
        self._box = np.zeros((2, robot.nv))
        endless = np.full((2, robot.nv), np.inf) * [[-1.0], [1.0]]
        self._clip = self._box if solver == "hierarchical" else endless
        self._solvers: dict[tuple[int, ...], tuple[Stack, Solver]] = {}
        self._step_s = 1e-3
        self.reset()

    def reset(self, dq_rad_s: Array | None = None) -> None:
        """Begin from the velocity that the arm has, shape (n,), or from rest.

        Call it when the arm has not followed: its commands were refused, or it has stopped itself.
        """
        self._last = np.zeros(self._joints) if dq_rad_s is None else np.array(dq_rad_s, np.float64)

    def update(self, sample: ArmReading, stack: Sequence[Task]) -> Command:
        """The command for the coming cycle. It never raises and always answers.

        Errors of tasks are of the measured positions, and the command starts from the last one:
        that keeps noise of measured velocities out of it, and the accelerations within limits.

        Args:
            sample: What the arm reports.
            stack: Tasks, the most important first; with none the arm brakes and rests.
        """
        try:
            q = np.ascontiguousarray(sample.q_rad, np.float64)
            dt_s = float(sample.dt_s)
            if q.shape != (self._joints,) or not 0.0 < dt_s < np.inf:
                return self._skip(f"{q.size} positions, dt_s = {dt_s:g}")
            self._step_s = min(dt_s, LONGEST_STEP_s)
            self.tool.update(q)
            numbers, solver = self._numbers_for(tuple([task.size for task in stack]))
            first = 0
            for task in stack:
                task.write(self.tool, numbers.rows, numbers.rates, first)
                first += task.size
        except (TypeError, ValueError, ControlError) as error:
            return self._skip(str(error))
        box, bounds = self._box, numbers.bounds
        if not fill_bounds(self._limits, q, self._last, self._step_s, box, bounds):
            return self._skip("positions or tasks are not finite")
        velocity = solver.solve() if first else None
        if velocity is None:
            velocity = np.clip(0.0, box[0], box[1])
            reason = "the solver found no velocity" if first else ""
            return self._send(Command(velocity, CommandStatus.BRAKING, _NOTHING, reason))
        missed = np.empty(len(stack))
        is_limited = assess(velocity, self._clip, numbers.rows, numbers.rates, numbers.ends, missed)
        status = _SATURATED if is_limited else _OK
        return self._send(_new(Command, (velocity, status, missed, "")))

    def _numbers_for(self, sizes: tuple[int, ...]) -> tuple[Stack, Solver]:
        """Numbers and solver of a stack; made when such a stack comes first."""
        made = self._solvers.get(sizes)
        if made is None:
            numbers = Stack(sizes, self._joints)
            made = self._solvers[sizes] = numbers, self._solver(numbers)
        return made

    def _skip(self, reason: str) -> Command:
        """Brake from the last command at the rate that limits allow."""
        change = self._limits[ACCELERATION] * self._step_s
        velocity = self._last - np.clip(self._last, -change, change)
        return self._send(Command(velocity, CommandStatus.SKIPPED, _NOTHING, reason))

    def _send(self, command: Command) -> Command:
        command.dq_rad_s.setflags(write=False)
        self._last = command.dq_rad_s
        return command
