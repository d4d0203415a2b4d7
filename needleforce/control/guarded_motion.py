"""A motion that a program makes with an arm by itself.

It begins with the first command that is taken, and ends at rest, well or with the
reason why not.
"""

from collections.abc import Sequence

from needleforce.control.controller import Command, Controller
from needleforce.control.ports import Arm, ArmSample
from needleforce.control.tasks import Task

MAX_WAIT_s = 30.0
"""So long the arm may take to accept commands."""


class GuardedMotion:
    """Sends the commands of a motion; call `send` for every sample.

    Args:
        arm: It moves without a question.
        controller: Of its commands.
        duration_s: Of the motion.

    Attributes:
        reason: Why it has failed; empty if it has not. Set it to end the motion.
        has_begun: Whether the arm has taken a command.
        time_s: Since then.
        is_at_rest: Whether it is over, and the arm is told to rest.
    """

    def __init__(self, arm: Arm, controller: Controller, duration_s: float) -> None:
        self.reason = ""
        self.has_begun = False
        self.time_s = 0.0
        self.is_at_rest = False
        self._arm = arm
        self._controller = controller
        self._duration_s = duration_s
        self._waited_s = 0.0

    @property
    def is_over(self) -> bool:
        """Whether the motion has ended, well or not; the arm may brake still."""
        return bool(self.reason) or self.time_s > self._duration_s

    def send(self, sample: ArmSample, tasks: Sequence[Task]) -> Command:
        """Send the command for tasks, or for rest before and after the motion."""
        was_over = self.is_over
        is_moving = self.has_begun and not was_over
        command = self._controller.update(sample, tasks if is_moving else ())
        is_accepted = self._arm.send(command.dq_rad_s)
        self.is_at_rest = was_over and not command.dq_rad_s.any()
        if is_moving:
            self.time_s += sample.dt_s
            self.reason = "" if is_accepted else "the arm has refused a command"
        elif not self.has_begun and not was_over:
            self.has_begun = is_accepted
            self._waited_s += sample.dt_s
            if self._waited_s > MAX_WAIT_s:
                self.reason = (
                    f"the arm took no command in {MAX_WAIT_s:g} s: let it take "
                    "commands at its own panel"
                )
        return command
