"""The loop that moves an arm: the same for every program.

with arm:
    for tick in run(arm, Controller(arm.robot, arm.limits), manager):
        tick.tasks = [RemoteCentre(trocar_m), TipVelocity(wish_m_s)]

However it ends, the arm comes to rest.
"""

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, field

from needleforce.control.controller import Command, Controller
from needleforce.control.errors import SettingError
from needleforce.control.handle_watch import HandleReport, HandleWatch
from needleforce.control.manager import Manager, Situation
from needleforce.control.monitors import Beside
from needleforce.control.ports import Arm, ArmSample, MasterSample
from needleforce.control.tasks import Task


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
        was_taken: Whether the arm took that.
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
) -> Generator[Tick]:
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
    is_taken = True
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
        _bring_to_rest(arm, samples, controller)


def _bring_to_rest(
    arm: Arm, samples: Iterator[ArmSample], controller: Controller
) -> None:
    """Brake until the arm stands, refuses, or its samples end."""
    if not controller.last_rad_s.any():
        return
    for sample in samples:
        command = controller.update(sample, ())
        if not arm.send(command.dq_rad_s) or not command.dq_rad_s.any():
            return
