"""The motion before a tare: a stroke along the needle while the elbow swings.

The needle is drawn back and returns, on its line:

    x(t) = -L s(t / T),  then  -L + L s(t / T - 1),    s(u) = 10 u^3 - 15 u^4 + 6 u^5

and the elbow of a redundant arm meanwhile swings N times to one side and back:

    angle(t) = A / 2 (1 - cos(2 pi N t / 2 T))

which leaves the tip at rest: dq = d (w + K (angle - angle_now)), with J d = 0 and
max |d_j| = 1, so that the angle is that of the joint that moves most.

Where the elbow swings, torques and positions of the joints reverse at different places;
that tells the hysteresis of the torque sensors from friction. Friction of bearings
depends on their speed: so the motion is slow, as the insertion is. See `residual.bias`.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.control.controller import Controller
from needleforce.control.errors import ControlError, SettingError
from needleforce.control.guarded_motion import GuardedMotion
from needleforce.control.joint_limits import Limits
from needleforce.control.ports import Arm
from needleforce.control.setting_checks import require_positive
from needleforce.control.tasks import AxialSpeed, Fixture, JointTask, Task, ToolState
from needleforce.tare_run import TareRun
from urdf import Robot

if TYPE_CHECKING:
    from collections.abc import Callable

    from needleforce.session import InsertionSession, SessionEstimate

LINE_GAIN_PER_S = 10.0
"""Gain that keeps the needle to its line and its course: arms follow late, and
positions may be rounded to 2e-4 rad."""

SWIVEL_GAIN_PER_S = 3.0
"""K. Gain with which the elbow keeps to its angle: slow enough for arms that follow
late and for positions that are rounded."""

MAX_STRAY_m = 5e-3
"""A tip that is so far off its course is held back, pushed, or runs away."""

POSTURE_MARGIN_rad = 0.05
"""A joint stays so far from its limits: the room for a swivel is only predicted from
the posture in which it begins."""

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


def find_course(legs_m: Sequence[float], leg_s: float, time_s: float) -> Course:
    """Return a course along legs, each from rest to rest, see s(u) of the module.

    Args:
        legs_m: Their lengths, with sign.
        leg_s: Time of each.
        time_s: Since the begin; the course rests before it and after the end.
    """
    if not 0.0 < time_s < leg_s * len(legs_m):
        return Course(sum(legs_m) if time_s > 0.0 else 0.0, 0.0)
    leg = min(int(time_s / leg_s), len(legs_m) - 1)
    u = time_s / leg_s - leg
    fraction = u**3 * (10.0 + u * (6.0 * u - 15.0))
    rate_per_s = 30.0 * (u * (1.0 - u)) ** 2 / leg_s
    return Course(sum(legs_m[:leg]) + legs_m[leg] * fraction, legs_m[leg] * rate_per_s)


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

    def elbow_at(self, time_s: float) -> Course:
        """Return the angle of the elbow, on its positive side."""
        if not 0.0 < time_s < self.duration_s:
            return Course(0.0, 0.0)
        pulse_rad_s = 2.0 * math.pi * self.swings / self.duration_s
        phase = pulse_rad_s * time_s
        amplitude_rad = 0.5 * self.swivel_rad
        return Course(
            amplitude_rad * (1.0 - math.cos(phase)),
            amplitude_rad * pulse_rad_s * math.sin(phase),
        )


USUAL_MOTION = TareMotion()
"""What `tare_with_stroke` moves unless it is given another motion."""


class ElbowSwivel(JointTask):
    """Turns the elbow along a course, see the module; put it last in a stack.

    Args:
        tool: Of the controller that runs the stack; the elbow's angle is zero where it
            is now.

    Attributes:
        wanted: Where the elbow shall be.
        direction: d, shape (n,); zero without a free motion.
    """

    def __init__(self, tool: ToolState) -> None:
        self.size = tool.q_rad.size
        self.wanted = Course(0.0, 0.0)
        self.direction = _find_self_motion(tool.jacobian, np.ones(self.size))
        self._angle_rad = 0.0
        self._tool = tool
        self._q_rad = tool.q_rad.copy()

    def velocity_at(self, q_rad: Array) -> Array:
        """Return the velocity asked for, shape (n,); zero without a free motion."""
        self.direction = _find_self_motion(self._tool.jacobian, self.direction)
        length_squared = max(float(self.direction @ self.direction), 1e-12)
        self._angle_rad += (
            float(self.direction @ (q_rad - self._q_rad)) / length_squared
        )
        self._q_rad = np.array(q_rad)
        error_rad = self.wanted.position - self._angle_rad
        return self.direction * (self.wanted.rate + SWIVEL_GAIN_PER_S * error_rad)


def _find_self_motion(jacobian: Array, near: Array) -> Array:
    """Return the direction d of joints that leaves the tip at rest, shape (n,).

    Args:
        jacobian: Of the tip, shape (6, n).
        near: Direction that it goes on from, shape (n,).

    Returns:
        d, its largest entry one; zero where no motion is free.
    """
    free = np.linalg.svd(jacobian)[2][len(jacobian) :]
    direction = free.T @ (free @ near)
    largest = float(np.abs(direction).max())
    return direction / largest if largest > 0.0 else direction


class _Stroke:
    """The tasks of the motion, from where the needle is.

    Args:
        tool: Of the controller.
        robot: The arm.
        motion: The stroke and the swings of the elbow.

    Attributes:
        reason: Why there is no room for it; empty if there is.
    """

    def __init__(self, tool: ToolState, robot: Robot, motion: TareMotion) -> None:
        self.reason = ""
        self._tool = tool
        self._motion = motion
        self._line = Fixture.here(tool, LINE_GAIN_PER_S)
        self._advance = AxialSpeed(0.0)
        self._elbow = ElbowSwivel(tool)
        self._side = 1.0  # to which the elbow swings
        if motion.swivel_rad and motion.swings and self._elbow.direction.any():
            self._choose_side(robot)

    def _choose_side(self, robot: Robot) -> None:
        """Choose the side with more room, by the self-motion at this posture."""
        turns_rad = np.outer(
            (1.0, -1.0), self._motion.swivel_rad * self._elbow.direction
        )
        q_rad = self._tool.q_rad + turns_rad
        rooms_rad = np.minimum(
            q_rad - robot.position_lower_rad, robot.position_upper_rad - q_rad
        )
        side = int(rooms_rad.min(axis=1).argmax())
        self._side = (1.0, -1.0)[side]
        if rooms_rad[side].min() < POSTURE_MARGIN_rad:
            joint = robot.joint_names[int(rooms_rad[side].argmin())]
            self.reason = (
                f"a swivel of {math.degrees(self._motion.swivel_rad):.0f} degrees "
                f"would bring {joint} within {POSTURE_MARGIN_rad} rad of its limit: "
                "swing less, or begin in another posture"
            )

    def tasks_at(self, time_s: float) -> list[Task]:
        """Return the tasks at a time; a tip that strays is a `reason` to stop."""
        length_m = self._motion.stroke_m
        travel = find_course((-length_m, length_m), self._motion.leg_s, time_s)
        elbow = self._motion.elbow_at(time_s)
        axis = self._line.rotation[:, 2]
        moved_m = self._tool.tip_m - self._line.goal_m
        stray_m = float(np.linalg.norm(moved_m - travel.position * axis))
        if not stray_m < MAX_STRAY_m:
            self.reason = (
                f"the tip is {1e3 * stray_m:.1f} mm off its course, expected less than "
                f"{1e3 * MAX_STRAY_m:g}: something holds the arm, it runs away, or a "
                "joint is at its limit"
            )
        error_m = travel.position - float(axis @ moved_m)
        self._advance.speed_m_s = travel.rate + LINE_GAIN_PER_S * error_m
        self._elbow.wanted = Course(
            self._side * elbow.position, self._side * elbow.rate
        )
        return [self._line, self._advance, self._elbow]


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
    require_positive(motion._asdict(), or_zero=("swivel_rad", "swings"))
    if motion.swings != int(motion.swings):
        raise SettingError(
            f"swings is {motion.swings:g}, expected a whole number: the elbow ends "
            "where it began"
        )
    robot = arm.robot if robot is None else robot
    controller = Controller(robot, limits)
    guarded = GuardedMotion(arm, controller, motion.duration_s + 2.0 * REST_S)
    tare = TareRun()
    session.start_tare_recording()
    stroke: _Stroke | None = None
    for sample in arm:
        estimate = session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        tare.after(session, estimate)
        tasks: list[Task] = []
        if guarded.has_begun and not guarded.is_over:
            stroke = stroke or _Stroke(controller.tool, robot, motion)
            tasks = stroke.tasks_at(guarded.time_s - REST_S)
            guarded.reason = stroke.reason
        guarded.send(sample, tasks)
        if watch is not None:
            watch(estimate)
        if session.tared:
            return
        if not guarded.is_at_rest:
            continue
        if guarded.reason:
            break
        _go_on_with(tare, session)
    raise ControlError(
        f"no tare: {guarded.reason or 'the samples of the arm have ended'}",
        "Let the arm take commands, in free air, with room for a stroke and a swivel.",
    )


def _go_on_with(tare: TareRun, session: "InsertionSession") -> None:
    """Start a tare unless one is under way; raise `TareError` if it was refused."""
    if not tare.is_running and tare.refusal is None:
        tare.start(session)
    if tare.refusal is not None:
        raise tare.refusal
