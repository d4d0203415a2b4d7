"""A motion that a program makes with an arm by itself.

It begins with the first command that is taken. An arm that then refuses one, does not
follow or is pushed ends it with the reason why, and is brought to rest.
"""

from collections.abc import Iterator
from contextlib import closing
from typing import NamedTuple

import numpy as np

from needleforce.control.command_tracking import CommandTracking
from needleforce.control.controller import Controller
from needleforce.control.errors import ControlError
from needleforce.control.ports import Arm
from needleforce.control.run import Tick, run

MAX_WAIT_s = 30.0
"""So long the arm may take to accept commands."""

MAX_STRAY_rad = 0.02
"""A joint that has moved so far without a command is pushed, or runs away."""

RIGHT_ARM = "Let the arm take commands, in free air, nothing touching it, with room."


class MotionTick(NamedTuple):
    """A cycle of the arm, and where the motion is in it.

    Attributes:
        time_s: Since the arm has taken a command; zero before.
        tick: The cycle; its tasks are the program's, none before and after the motion.
        is_at_rest: Whether the motion is over, and the arm was told to rest.
    """

    time_s: float
    tick: Tick
    is_at_rest: bool


def move_guarded(
    arm: Arm, controller: Controller, duration_s: float
) -> Iterator[MotionTick]:
    """Yield every cycle of an arm that a program moves, and those after the motion.

    Args:
        arm: It moves without a question.
        controller: Of its commands.
        duration_s: Of the motion.

    Raises:
        ControlError: The arm has not moved as it should, or its samples have ended.
    """
    tracking = CommandTracking(MAX_STRAY_rad)
    time_s = 0.0
    waited_s = 0.0
    with closing(run(arm, controller, without_force_limit=True)) as ticks:
        for tick in ticks:
            dt_s = tick.sample.dt_s
            last = tick.last
            if last is None or (time_s == 0.0 and not tick.was_taken):
                waited_s += dt_s
                if waited_s > MAX_WAIT_s:
                    raise ControlError(
                        f"the arm took no command in {MAX_WAIT_s:g} s", RIGHT_ARM
                    )
                yield MotionTick(0.0, tick, is_at_rest=False)
                continue
            time_s += dt_s
            is_over = time_s > duration_s
            if not (tick.was_taken or is_over):
                raise ControlError("the arm has refused a command", RIGHT_ARM)
            position_rad = np.array(tick.sample.q_rad, dtype=np.float64)
            if stray := tracking.check(position_rad, last.dq_rad_s, dt_s):
                raise ControlError(stray, RIGHT_ARM)
            yield MotionTick(time_s, tick, is_over and not last.dq_rad_s.any())
            if is_over:
                tick.tasks = ()
    raise ControlError("the samples of the arm have ended", RIGHT_ARM)
