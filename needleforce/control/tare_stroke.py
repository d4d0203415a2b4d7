"""The motion before a tare: a stroke along the needle while the elbow swings.

The needle is drawn back and returns, on its line:

    x(t) = -L s(t / T),  then  -L + L s(t / T - 1),    s(u) = 10 u^3 - 15 u^4 + 6 u^5

and the elbow of a redundant arm meanwhile swings N times to one side and back:

    angle(t) = A / 2 (1 - cos(2 pi N t / 2 T))

Where the elbow swings, torques and positions of the joints reverse at different places;
that tells the hysteresis of the torque sensors from friction. Friction of bearings
depends on their speed: so the motion is slow, as the insertion is. See `residual.bias`.
"""

import math
from collections.abc import Callable
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from needleforce.control.controller import Command, Controller
from needleforce.control.elbow_swivel import ElbowSwivel
from needleforce.control.errors import ControlError, SettingError
from needleforce.control.joint_limits import Limits
from needleforce.control.ports import Arm, ArmSample
from needleforce.control.setting_checks import require_positive
from needleforce.control.tasks import AxialSpeed, Fixture
from needleforce.tare_run import TareRun
from urdf import Robot

if TYPE_CHECKING:
    from needleforce.session import InsertionSession, SessionEstimate

LINE_GAIN_PER_S = 10.0
"""Gain that keeps the needle to its line and its course: arms follow late, and
positions may be rounded to 2e-4 rad."""

MAX_STRAY_m = 5e-3
"""A tip that is so far off its course is held back, pushed, or runs away."""

POSTURE_MARGIN_rad = 0.05
"""A joint stays so far from its limits: the room for a swivel is only predicted from
the posture in which it begins."""

MAX_WAIT_S = 30.0
"""So long the arm may take to accept commands."""

REST_S = 0.5
"""Rest before the motion, and after it."""


class Course(NamedTuple):
    """Where something shall be at a time.

    Attributes:
        position: In m or rad.
        rate: Per second.
    """

    position: float
    rate: float


AT_REST = Course(0.0, 0.0)


class TareMotion(NamedTuple):
    """How the arm moves before a tare.

    Attributes:
        stroke_m: L, the way back along the needle, and forth again.
        leg_s: T, time each way; a quick stroke meets other friction than an insertion.
        swivel_rad: A, how far the joint that moves most in a swivel of the elbow turns;
            0 for the stroke alone. Keep it slow: 0.14 rad with five swings in 20 s.
        swings: N, swings of the elbow in the whole motion.
    """

    stroke_m: float = 0.06
    leg_s: float = 10.0
    swivel_rad: float = 0.0
    swings: int = 5

    @property
    def duration_s(self) -> float:
        """Time of the motion."""
        return 2.0 * self.leg_s

    def travel_at(self, time_s: float) -> Course:
        """Return the travel along the needle, inwards positive."""
        if not 0.0 < time_s < self.duration_s:
            return AT_REST
        leg = min(int(time_s / self.leg_s), 1)
        s = time_s / self.leg_s - leg
        sign = 1.0 if leg else -1.0
        fraction = s**3 * (10.0 + s * (6.0 * s - 15.0))
        rate = 30.0 * (s * (1.0 - s)) ** 2 / self.leg_s
        position_m = self.stroke_m * (sign * fraction - leg)
        return Course(position_m, sign * self.stroke_m * rate)

    def elbow_at(self, time_s: float) -> Course:
        """Return the angle of the elbow, on its positive side."""
        if not 0.0 < time_s < self.duration_s:
            return AT_REST
        pulse_rad_s = 2.0 * math.pi * self.swings / self.duration_s
        phase = pulse_rad_s * time_s
        amplitude_rad = 0.5 * self.swivel_rad
        return Course(
            amplitude_rad * (1.0 - math.cos(phase)),
            amplitude_rad * pulse_rad_s * math.sin(phase),
        )


USUAL_MOTION = TareMotion()
"""What `tare_with_stroke` moves unless it is given another motion."""


class StrokeState(StrEnum):
    """How far the motion before a tare has come."""

    WAITING = "waiting"  # for the arm to take commands
    MOVING = "moving"
    DONE = "done"
    FAILED = "failed"  # see `TareStroke.reason`


class TareStroke:
    """Moves the arm before a tare, see the module.

    Call `update`, send its velocity, then `note_sent`.

    Args:
        robot: The arm.
        limits: What its joints may do.
        motion: The stroke and the swings of the elbow.

    Attributes:
        state: How far it has come.
        reason: Why it has failed; empty otherwise.

    Raises:
        SettingError: A number of the motion is negative, zero where it may not be, or
            not whole where it has to be.
    """

    def __init__(
        self, robot: Robot, limits: Limits, motion: TareMotion = USUAL_MOTION
    ) -> None:
        require_positive(motion._asdict(), or_zero=("swivel_rad", "swings"))
        if motion.swings != int(motion.swings):
            raise SettingError(
                f"swings is {motion.swings:g}, expected a whole number: the elbow ends "
                "where it began",
            )
        self.state = StrokeState.WAITING
        self.reason = ""
        self._robot = robot
        self._motion = motion
        self._controller = Controller(robot, limits)
        self._line: Fixture | None = None  # once it moves
        self._start_m = np.zeros(3)
        self._advance = AxialSpeed(0.0)
        self._elbow = ElbowSwivel(self._controller.tool)
        self._side = 1.0  # to which the elbow swings
        self._waited_s = 0.0
        self._moving_s = 0.0

    @property
    def is_over(self) -> bool:
        """Whether the motion has ended, well or not."""
        return self.state in (StrokeState.DONE, StrokeState.FAILED)

    def update(self, sample: ArmSample) -> Command:
        """Return the command for the coming cycle; at rest once it is over."""
        if self.state is StrokeState.WAITING:
            self._wait(sample.dt_s)
        elif self.state is StrokeState.MOVING:
            self._moving_s += sample.dt_s
            if self._line is None:
                self._begin()
        if self._line is None or self.state is not StrokeState.MOVING:
            return self._controller.update(sample, [])
        travel = self._motion.travel_at(self._moving_s - REST_S)
        elbow = self._motion.elbow_at(self._moving_s - REST_S)
        self._check_course(self._line, travel.position)
        error_m = travel.position - self._travelled_m(self._line)
        self._advance.speed_m_s = travel.rate + LINE_GAIN_PER_S * error_m
        self._elbow.turn(self._side * elbow.position, self._side * elbow.rate)
        return self._controller.update(sample, [self._line, self._advance, self._elbow])

    def note_sent(self, command: Command, *, is_accepted: bool) -> None:
        """Note whether the arm has taken the command of this cycle."""
        if self.state is StrokeState.WAITING and is_accepted:
            self.state = StrokeState.MOVING
        elif self.state is StrokeState.MOVING and not is_accepted:
            self._fail("the arm has refused a command")

    def _wait(self, dt_s: float) -> None:
        """Count the time without commands."""
        self._waited_s += dt_s
        if self._waited_s > MAX_WAIT_S:
            self._fail(
                f"the arm took no command in {MAX_WAIT_S:g} s: let it take commands "
                "at its own panel"
            )

    def _begin(self) -> None:
        """Lay the line along the needle, and choose the side with more room."""
        tool = self._controller.tool
        self._line = Fixture.here(tool, LINE_GAIN_PER_S)
        self._start_m = tool.tip_m
        self._elbow = ElbowSwivel(tool)
        if not self._motion.swings:
            return
        swivel_rad = self._motion.swivel_rad
        rooms = {
            side: self._elbow.room_after(self._robot, side * swivel_rad)
            for side in (1.0, -1.0)
        }
        self._side = max(rooms, key=lambda side: rooms[side][0])
        room_rad, joint = rooms[self._side]
        if room_rad < POSTURE_MARGIN_rad:
            self._fail(
                f"a swivel of {math.degrees(swivel_rad):.0f} degrees would bring "
                f"{joint} within {POSTURE_MARGIN_rad} rad of its limit: swing less, or "
                "begin in another posture"
            )

    def _travelled_m(self, line: Fixture) -> float:
        """Return how far the tip has moved along its line since the start."""
        moved_m = self._controller.tool.tip_m - self._start_m
        return float(line.rotation[:, 2] @ moved_m)

    def _check_course(self, line: Fixture, travel_m: float) -> None:
        """End the motion if it is over, or where the tip has left its course."""
        wanted_m = self._start_m + travel_m * line.rotation[:, 2]
        stray_m = float(np.linalg.norm(self._controller.tool.tip_m - wanted_m))
        if not stray_m < MAX_STRAY_m:
            self._fail(
                f"the tip is {1e3 * stray_m:.1f} mm off its course, expected less than "
                f"{1e3 * MAX_STRAY_m:g}: something holds the arm, it runs away, or a "
                "joint is at its limit"
            )
        elif self._moving_s > self._motion.duration_s + 2.0 * REST_S:
            self.state = StrokeState.DONE

    def _fail(self, reason: str) -> None:
        """End the motion, and keep why."""
        self.state = StrokeState.FAILED
        self.reason = reason


def tare_with_stroke(
    arm: Arm,
    session: "InsertionSession",
    limits: Limits,
    motion: TareMotion = USUAL_MOTION,
    *,
    robot: Robot | None = None,
    watch: "Callable[[SessionEstimate], None] | None" = None,
) -> None:
    """Move an arm in free air, and tare a session from that motion.

    The needle is drawn back and returns; the arm rests while the tare is fitted. At the
    end the arm is at rest where it began, and the session is tared.

    Args:
        arm: It moves without a question.
        session: Of the same arm; what it recorded before is not used for the tare.
        limits: What the joints may do.
        motion: The stroke and the swings of the elbow.
        robot: The model of the arm; None for `Arm.robot`.
        watch: Called with every estimate.

    Raises:
        ControlError: The arm has not moved as it should; it has been brought to rest.
        TareError: The motion looks like contact or like other torques than the model's.
        SettingError: A number of the motion is negative, zero where it may not be, or
            not whole where it has to be.
    """
    stroke = TareStroke(arm.robot if robot is None else robot, limits, motion)
    tare = TareRun()
    session.start_tare_recording()
    for sample in arm:
        estimate = session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        tare.after(session, estimate)
        command = stroke.update(sample)
        is_accepted = arm.send(command.dq_rad_s)
        stroke.note_sent(command, is_accepted=is_accepted)
        if watch is not None:
            watch(estimate)
        if session.tared:
            return
        if not stroke.is_over or command.dq_rad_s.any() or tare.is_running:
            continue
        if stroke.state is StrokeState.FAILED:
            raise ControlError(
                f"no tare: {stroke.reason}",
                "Let the arm take commands, in free air, with room for a stroke "
                "and a swivel.",
            )
        if tare.refusal is None:
            tare.start(session)
        if tare.refusal is not None:
            raise tare.refusal
    raise ControlError(
        f"no tare: the arm's samples ended while the motion was {stroke.state}",
        "Let the arm take commands, in free air, with room for a stroke and a swivel.",
    )
