"""One tick: joint velocities for a sample of the arm and a stack of tasks.

The tasks are served in strict priority within the limits of the joints, see
`priority_solver` and `joint_limits`.
"""

import math
from collections import deque
from collections.abc import Sequence
from operator import is_
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from foundation.jit import compile_waiting
from needleforce.control.errors import SettingError, require_positive
from needleforce.control.joint_limits import Limits, SLACK_rad_s
from needleforce.control.ports import ArmSample
from needleforce.control.priority_solver import Stack, hierarchical
from needleforce.control.tasks import JointTask, MAX_STEP_s, Task, ToolState
from needleforce.devices.rate_limiter import write_velocity_bounds
from urdf import Robot

MAX_DELAY_s = 0.3
"""No loop of control lives with longer delays."""


class Command(NamedTuple):
    """Joint velocities for the coming cycle.

    Attributes:
        dq_rad_s: To be sent to the arm, shape (n,).
        reason: Why the sample or a task was skipped, and the arm brakes as fast as the
            limits allow; empty otherwise.
        is_limited: Whether tasks have at least one joint at a limit.
        is_damped: Whether tasks ask for a direction that joints hardly move.
    """

    dq_rad_s: Array
    reason: str = ""
    is_limited: bool = False
    is_damped: bool = False


class DelayPrediction:
    """Predicts where the arm will be once a command acts, from those on their way.

        q(t + T) = q(t) + integral of the commands sent within T before t

    with the delay T from command to measured motion (Smith, Chem. Eng. Prog. 1957). An
    error of T adds an error of at most that time times the speed of a joint.

    Args:
        joints: Number n of joints.
        delay_s: The delay T, as `needleforce lag` measures it; 0 for no prediction.

    Attributes:
        motion_ahead_rad: How far the joints will move beyond what is measured now,
            shape (n,).

    Raises:
        SettingError: The delay is negative, not finite or above `MAX_DELAY_s`.
    """

    def __init__(self, joints: int, delay_s: float) -> None:
        require_positive({"delay_s": delay_s}, or_zero=("delay_s",))
        if delay_s > MAX_DELAY_s:
            raise SettingError(
                f"delay_s is {delay_s:g}, expected at most {MAX_DELAY_s:g} seconds",
            )
        self._delay_s = float(delay_s)
        self._commands = deque[tuple[float, Array]]()  # a time, and the velocity in it
        self._commands_s = 0.0
        self.motion_ahead_rad = np.zeros(joints)

    def note_command(self, dq_rad_s: Array, dt_s: float) -> None:
        """Remember a velocity, shape (n,), that was commanded for a time until now.

        Of a time beyond the delay only the end counts; what is no positive number is
        left out.
        """
        if self._delay_s == 0.0 or not 0.0 < dt_s < math.inf:
            return
        dt_s = min(dt_s, self._delay_s)
        self._commands.append((dt_s, dq_rad_s))
        self._commands_s += dt_s
        self.motion_ahead_rad = self.motion_ahead_rad + dt_s * dq_rad_s
        while (shown_s := self._commands_s - self._delay_s) > 0.0:
            oldest_s, oldest_rad_s = self._commands.popleft()
            if shown_s < oldest_s:
                self._commands.appendleft((oldest_s - shown_s, oldest_rad_s))
            shown_s = min(shown_s, oldest_s)
            self._commands_s -= shown_s
            self.motion_ahead_rad = self.motion_ahead_rad - shown_s * oldest_rad_s


class Controller:
    """Turns samples and stacks of tasks into joint velocities; see `update`.

    Args:
        robot: The arm; the z axis of its tool frame is the needle.
        limits: What its joints may do.
        delay_s: From command to measured motion, as `needleforce lag` prints it; None
            if it is not known. Tasks then act on where the arm will be when the command
            does.

    Attributes:
        tool: Pose and Jacobian of the tip at the last valid sample, ahead of it by
            ``delay_s``.
        last_rad_s: The velocity commanded last, shape (n,).

    Raises:
        SettingError: The limits are those of another robot, or the delay is negative.
    """

    def __init__(
        self,
        robot: Robot,
        limits: Limits,
        *,
        delay_s: float | None = None,
    ) -> None:
        compile_waiting()
        if (joints := limits.joints.speed_rad_s.size) != robot.nv:
            raise SettingError(
                f"limits of {joints} joints, the robot has {robot.nv}",
            )
        self.tool = ToolState(robot)
        self._limit_rows = np.array((*limits.joints, limits.joints.acceleration_rad_s2))
        self._cycle_s = limits.cycle_s
        self._tip_m_s = limits.tip_m_s
        self._joints = joints
        self._delay_s = delay_s or 0.0
        self._stacks: dict[tuple[int, ...], Stack] = {}
        self._tasks = list[Task]()
        self._stack = Stack((), robot.nv)
        # Time over which a change of the command counts: where the jerk is limited the
        # arm's cycle, however many samples were lost since the last command.
        self._change_s = 1e-3 if limits.cycle_s is None else limits.cycle_s
        self.reset()

    def reset(self) -> None:
        """Begin from rest.

        Call it when the arm has not followed: its commands were refused, or it has
        stopped itself.
        """
        self.last_rad_s = np.zeros(self._joints)
        self._acceleration_rad_s2 = np.zeros(self._joints)
        self._position_rad: Array | None = None  # low-passed
        # An arm that has not followed its commands is not where they lead.
        self._prediction = DelayPrediction(self._joints, self._delay_s)

    def update(self, sample: ArmSample, stack: Sequence[Task]) -> Command:
        """Return the command for the coming cycle; always answer, whatever the sample.

        Errors of tasks are of the measured positions, or of those predicted over the
        delay, and the command starts from the last one: that keeps noise of measured
        velocities out of it, and the accelerations within limits.

        Args:
            sample: What the arm reports.
            stack: Tasks, the most important first; with none the arm brakes and rests.

        Raises:
            SettingError: The sample is of a real arm, and the limits have none of the
                jerk: nothing has moved yet.
        """
        if self._cycle_s is None and getattr(sample, "is_real", False):
            raise SettingError(
                "this arm is real and the controller's limits have none of the jerk: "
                "expected Limits.of_arm(robot, arm.preset) or Limits(robot, "
                "jerk_rad_s3=...)",
            )
        try:
            q_rad = np.ascontiguousarray(sample.q_rad, np.float64)
            dt_s = float(sample.dt_s)
        except (TypeError, ValueError, OverflowError) as error:
            return self._brake(f"q_rad, dt_s: {error}")
        try:
            self._prediction.note_command(self.last_rad_s, dt_s)
            if q_rad.shape != (self._joints,) or not 0.0 < dt_s < math.inf:
                return self._brake(f"{q_rad.size} positions, dt_s = {dt_s:g}")
            if not math.isfinite(q_rad.dot(q_rad)):
                return self._brake("positions are not finite")
            if self._cycle_s is None:
                self._change_s = min(dt_s, MAX_STEP_s)
            predicted_rad = q_rad + self._prediction.motion_ahead_rad
            self.tool.update(self._filter_positions(predicted_rad, dt_s))
            self._select_stack(stack)
            self._stack.fill(stack, self.tool)
            self._write_bounds(predicted_rad, self._stack.bounds)
            if not stack:
                return self._command(np.clip(0.0, *self._stack.bounds))
            velocity_rad_s, is_limited = hierarchical(self._stack)
            velocity_rad_s = self._slow_tip(velocity_rad_s, self._stack.bounds)
        # Of values, a shape or a number; a program's own faults pass through.
        except (NeedleforceError, ValueError) as error:
            return self._brake(f"{type(error).__name__}: {error}")
        return self._command(
            velocity_rad_s, is_limited=is_limited, is_damped=self._stack.is_damped
        )

    def _filter_positions(self, q_rad: Array, dt_s: float) -> Array:
        """Return positions, low-passed about the commanded motion if jerk is limited.

            q_f <- q_f + T dq_last + (q - q_f - T dq_last) T / (T + tau)

        which lags behind a motion that was not commanded only, by 8 ms (20 Hz). An arm
        that is further than 0.01 rad from where its commands have led it has been
        moved: its positions are used as they are.
        """
        if self._cycle_s is None:
            return q_rad
        led_rad = q_rad
        if self._position_rad is not None and dt_s <= MAX_STEP_s:
            led_rad = self._position_rad + dt_s * self.last_rad_s
        surprise_rad = q_rad - led_rad
        self._position_rad = led_rad + surprise_rad * dt_s / (8e-3 + dt_s)
        if np.abs(surprise_rad).max() > 0.01:
            self._position_rad = q_rad.copy()
        return self._position_rad

    def _write_bounds(self, q_rad: Array, bounds: Array) -> None:
        """Write the bounds of the coming cycle, see `write_velocity_bounds`."""
        write_velocity_bounds(
            self._limit_rows,
            q_rad,
            self.last_rad_s,
            self._acceleration_rad_s2,
            self._change_s,
            SLACK_rad_s,
            bounds,
        )

    def _slow_tip(self, velocity_rad_s: Array, bounds: Array) -> Array:
        """Return a velocity of the joints that keeps the limit of the tip's speed.

        All joints slow down alike, as far as the bounds allow.
        """
        if self._tip_m_s is None:
            return velocity_rad_s
        tip_m_s = self.tool.jacobian[:3] @ velocity_rad_s
        speed_m_s = math.sqrt(float(tip_m_s @ tip_m_s))
        if speed_m_s <= self._tip_m_s:
            return velocity_rad_s
        return np.clip(velocity_rad_s * (self._tip_m_s / speed_m_s), *bounds)

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
        bounds = np.zeros((2, self._joints))
        self._write_bounds(np.full(self._joints, np.nan), bounds)
        return self._command(np.clip(0.0, *bounds), reason)

    def _command(
        self,
        velocity_rad_s: Array,
        reason: str = "",
        is_limited: bool = False,
        is_damped: bool = False,
    ) -> Command:
        """Remember a velocity as the last one, and return it as a command."""
        velocity_rad_s.setflags(write=False)
        change_rad_s = velocity_rad_s - self.last_rad_s
        self._acceleration_rad_s2 = change_rad_s / self._change_s
        self.last_rad_s = velocity_rad_s
        return Command(velocity_rad_s, reason, is_limited, is_damped)
