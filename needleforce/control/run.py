"""The loop that moves an arm: the same for every program.

with arm:
    for tick in run(arm, Controller(arm.robot, arm.limits), manager):
        tick.tasks = [RemoteCentre(trocar_m), TipVelocity(wish_m_s)]

However it ends, the arm comes to rest.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from needleforce.control.controller import Command, Controller
from needleforce.control.manager import Manager, Situation
from needleforce.control.monitors import Beside
from needleforce.control.ports import Arm, ArmSample
from needleforce.control.tasks import Task


@dataclass(slots=True)
class Tick:
    """One cycle of an arm.

    Attributes:
        sample: What the arm reports.
        situation: What the manager says; None without one.
        tasks: To be set by the program; with none the arm brakes and rests.
        last: The command of the cycle before; None in the first.
        was_taken: Whether the arm took that.
    """

    sample: ArmSample
    situation: Situation | None
    last: Command | None
    was_taken: bool
    tasks: Sequence[Task] = ()


def run(
    arm: Arm, controller: Controller, manager: Manager | None = None
) -> Iterator[Tick]:
    """Yield every cycle of an arm, and send the command for its tasks.

    The manager, which holds the force limit, gets the heartbeat and what the arm
    refused. After a refusal the controller begins from rest, as the arm does. However
    the loop ends, the arm is brought to rest; put it into a ``with`` statement, so that
    an error in its body brakes at once.

    Args:
        arm: Iterated over until it ends.
        controller: Of its commands.
        manager: Watches and schedules; None for a motion without a force limit.

    Yields:
        The cycle. Set its `Tick.tasks`.
    """
    samples = iter(arm)
    beside = Beside()
    command: Command | None = None
    is_taken = True
    try:
        for sample in samples:
            situation: Situation | None = None
            if manager is not None:
                manager.heartbeat()
                situation = manager.update(sample, beside)
            tick = Tick(sample, situation, command, is_taken)
            yield tick
            command = controller.update(sample, tick.tasks)
            is_taken = arm.send(command.dq_rad_s)
            beside = Beside(
                is_taken, command.dq_rad_s, loop_failure=command.loop_failure
            )
            if not is_taken:
                controller.reset()
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
