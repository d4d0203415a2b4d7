"""One tick: from a sample of the arm and a stack of tasks to joint velocities within limits."""

import itertools
from collections.abc import Sequence
from enum import StrEnum
from typing import Literal, NamedTuple

import numpy as np

from needleforce.control.errors import ControlError, SettingError
from needleforce.control.ports import ArmReading, Array
from needleforce.control.priority_solver import Hierarchical, Published, Solver, Stack
from needleforce.control.tasks import JointVelocity, Task
from needleforce.control.tool_state import ToolState
from needleforce.control.velocity_box import (
    ACCELERATION,
    Limits,
    LONGEST_STEP_s,
    SLACK_rad_s,
    joint_bounds,
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
        reason: Why it was skipped or braked; empty otherwise.
    """

    dq_rad_s: Array
    status: CommandStatus
    reason: str = ""


_OK, _SATURATED = CommandStatus.OK, CommandStatus.SATURATED
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
        self._numbers = Stack((), robot.nv)
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
            last = stack[-1] if stack else None
            # A wish of the joints that comes last needs no rows: it is the QP's own cost.
            above = stack[:-1] if isinstance(last, JointVelocity) else stack
            numbers, solver = self._numbers_for(tuple([task.size for task in above]))
            if isinstance(last, JointVelocity):
                last.write_velocity(q, numbers.wish)
            else:
                numbers.wish[:] = 0.0
            first = 0
            for task in above:
                task.write(self.tool, numbers.rows, numbers.rates, first)
                first += task.size
        except (TypeError, ValueError, ControlError) as error:
            return self._skip(str(error))
        self._numbers, bounds = numbers, numbers.bounds
        if not joint_bounds(self._limits, q, self._last, self._step_s, bounds):
            return self._skip("positions or tasks are not finite")
        velocity, is_limited = solver.solve() if stack else (None, False)
        if velocity is None:
            velocity = np.clip(0.0, bounds[0, : self._joints], bounds[1, : self._joints])
            reason = "the solver found no velocity" if stack else ""
            return self._send(Command(velocity, CommandStatus.BRAKING, reason))
        return self._send(_new(Command, (velocity, _SATURATED if is_limited else _OK, "")))

    @property
    def last_rad_s(self) -> Array:
        """What was commanded last, shape (n,)."""
        return self._last

    @property
    def missed(self) -> list[float]:
        """Largest part of each task's rates that the last command leaves unmet [m/s or rad/s].

        Without that of a wish of the joints that comes last; of the last valid sample.
        """
        numbers = self._numbers
        left = np.abs(numbers.rows[: numbers.rates.size] @ self._last - numbers.rates)
        return [float(left[i:k].max()) for i, k in itertools.pairwise((0, *numbers.ends))]

    def _numbers_for(self, sizes: tuple[int, ...]) -> tuple[Stack, Solver]:
        """Numbers and solver of a stack; made when such a stack comes first."""
        made = self._solvers.get(sizes)
        if made is None:
            numbers = Stack(sizes, self._joints)
            made = self._solvers[sizes] = numbers, self._solver(numbers)
        return made

    def _skip(self, reason: str) -> Command:
        """Brake from the last command at the rate that limits allow."""
        change = self._limits[ACCELERATION] * self._step_s - SLACK_rad_s
        velocity = self._last - np.clip(self._last, -change, change)
        return self._send(Command(velocity, CommandStatus.SKIPPED, reason))

    def _send(self, command: Command) -> Command:
        command.dq_rad_s.setflags(write=False)
        self._last = command.dq_rad_s
        return command
