"""The stroke before a tare: `needleforce live --tare-stroke`."""

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

from foundation.jit import compile_waiting
from groundtruth.rig_arm import ArmSample, SimulatedArm
from needleforce.cli.arms.arm_connection import (
    NO_TORQUES,
    ConnectedArm,
    ask_to_move,
    limits_of,
    open_arm,
)
from needleforce.cli.shared_options import MotorConstants, RobotOptions
from needleforce.cli.terminal import CHECK_ARM, CommandError, say
from needleforce.control.tare_stroke import TareMotion, tare_with_stroke
from needleforce.devices.link import LinkReport
from needleforce.session import InsertionSession

MEAN_SPEED_m_s = 0.01
"""Mean speed of a stroke: slow, as an insertion is, since friction depends on it."""

MIN_LEG_S = 10.0
"""Time of a stroke each way, at least: the elbow needs it for its swings."""


class TareOptions(NamedTuple):
    """When, and from what motion, a session is tared.

    Attributes:
        after_s: Motion without contact before the tare, where the arm is not moved [s].
        motion: That the arm makes first, and is tared from; None for none.
        is_confirmed: Whether the arm may move without a question.
    """

    after_s: float
    motion: TareMotion | None
    is_confirmed: bool


def find_stroke(stroke_mm: float | None, swivel_deg: float) -> TareMotion | None:
    """Return the motion that options ask for; None without a stroke.

    Raises:
        CommandError: The stroke is not positive, or the swivel is no angle from 0 to
            less than 360 degrees.
    """
    full_turn_deg = 360.0
    if stroke_mm is None:
        return None
    if not 0.0 < stroke_mm < math.inf:
        raise CommandError(f"--tare-stroke {stroke_mm:g}: expected millimetres above 0")
    if not 0.0 <= swivel_deg < full_turn_deg:
        raise CommandError(
            f"--tare-swivel {swivel_deg:g}: expected degrees from 0 to less than 360"
        )
    return TareMotion(
        stroke_m=1e-3 * stroke_mm,
        leg_s=max(1e-3 * stroke_mm / MEAN_SPEED_m_s, MIN_LEG_S),
        swivel_rad=math.radians(swivel_deg),
    )


class _RestingArm:
    """A simulated arm that has moved, to be listened to like a connected one.

    Args:
        arm: The arm; it holds its place without commands.

    Attributes:
        report: Of its samples.
    """

    def __init__(self, arm: SimulatedArm) -> None:
        self.report = LinkReport()
        self._arm = arm

    def __iter__(self) -> Iterator[ArmSample]:
        for sample in self._arm:
            self.report.used += 1
            yield sample

    def end(self) -> None:
        """End the samples."""
        self._arm.close()


@contextmanager
def open_tared_arm(
    name: str,
    options: RobotOptions,
    constants_Nm_A: MotorConstants | None,
    taring: TareOptions,
) -> Iterator[tuple[ConnectedArm, InsertionSession]]:
    """Open an arm to be listened to; before, if asked, move it and tare.

    A simulated arm stays the one that has moved; any other is given back and opened
    anew, so that its user may move it. The session is not tared without a motion.

    Args:
        name: The arm as the command line names it.
        options: Options that describe the robot.
        constants_Nm_A: Torque per motor current of each joint of a UR [Nm/A].
        taring: With the motion; None for none.

    Raises:
        CommandError: The user says no, or the arm sends no torques.
        ControlError: The arm has not moved as it should.
        TareError: The motion is no free motion.
    """
    if taring.motion is None:
        with open_arm(name, options, constants_Nm_A) as connected:
            yield connected, InsertionSession(connected.robot)
        return
    if name.startswith("ur:") and constants_Nm_A is None:
        raise CommandError(f"{name}: {NO_TORQUES}", CHECK_ARM)
    motion = taring.motion
    text = (
        f"{name} will draw the needle back by {1e3 * motion.stroke_m:.0f} mm and return"
    )
    if motion.swivel_rad and motion.swings:
        text += (
            f"; the elbow of an arm of seven joints will swing {motion.swings} times "
            f"by {math.degrees(motion.swivel_rad):.0f} degrees"
        )
    text = f"{text}, in {motion.duration_s:.0f} s."
    if not taring.is_confirmed:
        ask_to_move(name, f"{text} Leave room for the elbow beside the arm.")
    compile_waiting()  # before the arm is open: a UR stops after 0.1 s of silence
    with open_arm(name, options, constants_Nm_A, takes_commands=True) as connected:
        arm, robot = connected
        session = InsertionSession(robot)
        say(text)
        tare_with_stroke(arm, session, limits_of(connected), motion, robot=robot)
        say("tared")
        if name.partition(":")[0] == "sim":
            yield ConnectedArm(_RestingArm(arm), robot), session
            return
    with open_arm(name, options, constants_Nm_A) as connected:
        yield connected, session
