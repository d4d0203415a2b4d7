"""The loop that moves an arm: the same for every program.

with arm:
    for tick in run(arm, Controller(arm.robot, arm.limits), manager):
        tick.tasks = [RemoteCentre(trocar_m), TipVelocity(wish_m_s)]

However it ends, the arm comes to rest.
"""

from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field

import numpy as np

from needleforce.control.controller import Command, Controller
from needleforce.control.errors import ControlError, SettingError
from needleforce.control.handle_watch import HandleReport, HandleWatch
from needleforce.control.manager import Manager, Situation
from needleforce.control.monitors import Beside, CommandTracking
from needleforce.control.ports import Arm, ArmSample, MasterSample
from needleforce.control.tasks import Task

MAX_WAIT_s = 30.0
"""So long the arm may take to accept commands."""

RIGHT_ARM = "Let the arm take commands, in free air, nothing touching it, with room."


@dataclass(slots=True)
class Tick:
    """One cycle of an arm.

    Attributes:
        sample: What the arm reports.
        situation: What the manager says; None without one.
        tasks: To be set by the program; with none the arm brakes and rests, and so it
            does in states of the manager that do not move.
        handle: What the program has found out of a haptic device by `check_handle`.
        last: The command of the cycle before; None in the first.
        was_taken: Whether the arm took that; not so in the first.
    """

    sample: ArmSample
    situation: Situation | None
    last: Command | None
    was_taken: bool
    tasks: Sequence[Task] = ()
    handle: HandleReport | None = None
    _handle_watch: HandleWatch = field(default_factory=HandleWatch)

    def check_handle(self, sample: MasterSample | None) -> HandleReport:
        """Return what a sample of the haptic device is good for; the manager learns it.

        Args:
            sample: What it has sent, or None if that is nothing new.
        """
        self.handle = self._handle_watch.update(sample, self.sample.dt_s)
        return self.handle


def run(
    arm: Arm,
    controller: Controller,
    manager: Manager | None = None,
    *,
    without_force_limit: bool = False,
) -> Generator[Tick, None, None]:
    """Yield every cycle of an arm, and send the command for its tasks.

    The manager, which holds the force limit, gets the heartbeat and what the arm
    refused; in its states that do not move the arm rests. After a refusal the
    controller begins from rest, as the arm does. However the loop ends, the arm is
    brought to rest; put it into a ``with`` statement, so that an error in its body
    brakes at once.

    Args:
        arm: Iterated over until it ends.
        controller: Of its commands.
        manager: Watches and schedules. Without one nothing limits the force: only a
            simulated arm goes then, or one that `without_force_limit` allows.
        without_force_limit: Move a real arm without a manager, in free air.

    Yields:
        The cycle. Set its `Tick.tasks`.

    Raises:
        SettingError: A real arm without a manager; nothing has moved.
    """
    samples = iter(arm)
    beside = Beside()
    handle_watch = HandleWatch()
    command: Command | None = None
    is_taken = False
    try:
        for sample in samples:
            situation: Situation | None = None
            if manager is not None:
                manager.heartbeat()
                situation = manager.update(sample, beside)
            elif getattr(sample, "is_real", False) and not without_force_limit:
                raise SettingError(
                    "a real arm without a manager, which limits the force",
                    "Give run() a Manager(session, SafetyLimits(axial_N=6.0)); in free "
                    "air without_force_limit=True allows it.",
                )
            tick = Tick(
                sample, situation, command, is_taken, _handle_watch=handle_watch
            )
            yield tick
            is_moving = situation is None or situation.is_moving
            command = controller.update(sample, tick.tasks if is_moving else ())
            is_taken = arm.send(command.dq_rad_s)
            beside = Beside(
                # An arm that rests may take no commands.
                accepted=is_taken or not is_moving,
                command_rad_s=command.dq_rad_s,
                handle=tick.handle,
            )
            if not is_taken:
                controller.reset()
            if tick.handle is None:  # what it does while nobody asks is no motion
                handle_watch = HandleWatch()
    finally:
        for sample in samples if controller.last_rad_s.any() else ():
            command = controller.update(sample, ())
            if not arm.send(command.dq_rad_s) or not command.dq_rad_s.any():
                break


def move_guarded(
    arm: Arm, controller: Controller, duration_s: float
) -> Iterator[tuple[float, Tick]]:
    """Yield every cycle of an arm that a program moves by itself, and those after it.

    The motion begins with the first command that is taken. An arm that then refuses
    one, does not follow or is pushed is brought to rest.

    Args:
        arm: It moves without a question.
        controller: Of its commands.
        duration_s: Of the motion.

    Yields:
        The time since the arm has taken a command, zero before, and the cycle; its
        tasks are the program's, none before and after the motion.

    Raises:
        ControlError: The arm has not moved as it should, or its samples have ended.
    """
    tracking = CommandTracking(max_rad=0.02)  # one that moves further is pushed
    time_s = 0.0
    waited_s = 0.0
    with closing(run(arm, controller, without_force_limit=True)) as ticks:
        for tick in ticks:
            dt_s = tick.sample.dt_s
            fault = ""
            if time_s > 0.0 or tick.was_taken:
                time_s += dt_s
                q_rad = np.array(tick.sample.q_rad, dtype=np.float64)
                fault = tracking.check(q_rad, controller.last_rad_s, dt_s)
                if not tick.was_taken and time_s <= duration_s:
                    fault = "the arm has refused a command"
            elif (waited_s := waited_s + dt_s) > MAX_WAIT_s:
                fault = f"the arm took no command in {MAX_WAIT_s:g} s"
            if fault:
                raise ControlError(fault, RIGHT_ARM)
            yield time_s, tick
    raise ControlError("the samples of the arm have ended", RIGHT_ARM)
