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
from needleforce.control.errors import ControlError, SettingError, require_positive
from needleforce.control.joint_limits import Limits
from needleforce.control.ports import Arm
from needleforce.control.run import move_guarded
from needleforce.control.tasks import AxialSpeed, Fixture, JointTask, ToolState
from needleforce.tare_run import TareRun
from urdf import Robot

if TYPE_CHECKING:
    from needleforce.session import InsertionSession

LINE_GAIN_PER_S = 10.0
"""Gain that keeps the needle to its line and its course: arms follow late, and
positions may be rounded to 2e-4 rad."""

SWIVEL_GAIN_PER_S = 3.0
"""K. Gain with which the elbow keeps to its angle: slow enough for arms that follow
late and for positions that are rounded."""

MAX_STROKE_SPEED = 3.75
"""Largest speed of a stroke, times its time over its length: twice the fastest of the
course."""

POSTURE_MARGIN_rad = 0.05
"""A joint stays so far from its limits: the room for a swivel is only predicted from
the posture in which it begins."""

REST_S = 0.5
"""Rest before the motion, and after it."""


def find_stroke_speed(
    legs_m: Sequence[float],
    leg_s: float,
    time_s: float,
    start_m: float,
    place_m: float,
) -> float:
    """Return the speed that keeps the needle to strokes, see s(u) of the module.

    Args:
        legs_m: Their lengths along the needle, each from rest to rest.
        leg_s: Time of each.
        time_s: Since the begin; the course rests before it and after the end.
        start_m: Where the needle began.
        place_m: Where it is now.
    """
    position_m = sum(legs_m) if time_s > 0.0 else 0.0
    speed_m_s = 0.0
    if 0.0 < time_s < leg_s * len(legs_m):
        leg = min(int(time_s / leg_s), len(legs_m) - 1)
        u = time_s / leg_s - leg
        fraction = u**3 * (10.0 + u * (6.0 * u - 15.0))
        position_m = sum(legs_m[:leg]) + legs_m[leg] * fraction
        speed_m_s = legs_m[leg] * (30.0 * (u * (1.0 - u)) ** 2 / leg_s)
    speed_m_s += LINE_GAIN_PER_S * (start_m + position_m - place_m)
    max_m_s = MAX_STROKE_SPEED * max(map(abs, legs_m)) / leg_s
    return min(max(speed_m_s, -max_m_s), max_m_s)


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


USUAL_MOTION = TareMotion()
"""What `tare_with_stroke` moves unless it is given another motion."""


class ElbowSwivel(JointTask):
    """Swings the elbow, see the module, to the side with more room; last in a stack.

    Args:
        tool: Of the controller that runs the stack; the elbow's angle is zero where it
            is now.
        robot: The arm.
        motion: The swings.

    Attributes:
        time_s: Since the begin, for its user to set.

    Raises:
        ControlError: A joint has no room for it.
    """

    def __init__(self, tool: ToolState, robot: Robot, motion: TareMotion) -> None:
        self.size = tool.q_rad.size
        self.time_s = 0.0
        self._motion = motion
        self._tool = tool
        self._q_rad = tool.q_rad.copy()
        self._angle_rad = 0.0
        self._direction = _find_self_motion(tool.jacobian, np.ones(self.size))
        reach_rad = motion.swivel_rad * self._direction * (motion.swings > 0)
        ends_rad = self._q_rad + np.outer((1.0, -1.0), reach_rad)
        rooms_rad = np.minimum(
            ends_rad - robot.position_lower_rad, robot.position_upper_rad - ends_rad
        )
        side = int(rooms_rad.min(axis=1).argmax())
        self._amplitude_rad = (0.5, -0.5)[side] * motion.swivel_rad
        if reach_rad.any() and rooms_rad[side].min() < POSTURE_MARGIN_rad:
            joint = robot.joint_names[int(rooms_rad[side].argmin())]
            raise ControlError(
                f"a swivel of {math.degrees(motion.swivel_rad):.0f} degrees would "
                f"bring {joint} within {POSTURE_MARGIN_rad} rad of its limit",
                "Swing less, or begin in another posture.",
            )

    def velocity_at(self, q_rad: Array) -> Array:
        """Return the velocity asked for, shape (n,); zero without a free motion."""
        self._direction = _find_self_motion(self._tool.jacobian, self._direction)
        length_squared = max(float(self._direction @ self._direction), 1e-12)
        self._angle_rad += (
            float(self._direction @ (q_rad - self._q_rad)) / length_squared
        )
        self._q_rad = np.array(q_rad)
        pulse_rad_s = 2.0 * math.pi * self._motion.swings / self._motion.duration_s
        phase = pulse_rad_s * min(max(self.time_s, 0.0), self._motion.duration_s)
        rate_rad_s = self._amplitude_rad * pulse_rad_s * math.sin(phase)
        error_rad = self._amplitude_rad * (1.0 - math.cos(phase)) - self._angle_rad
        return self._direction * (rate_rad_s + SWIVEL_GAIN_PER_S * error_rad)


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
    return direction / max(float(np.abs(direction).max()), 1e-12)


def tare_with_stroke(
    arm: Arm,
    session: "InsertionSession",
    limits: Limits,
    motion: TareMotion = USUAL_MOTION,
    *,
    robot: Robot | None = None,
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
    tool = controller.tool
    tare = TareRun()
    session.start_tare_recording()
    line: Fixture | None = None
    elbow: ElbowSwivel | None = None
    moved_s = motion.duration_s + 2.0 * REST_S
    for time_s, tick in move_guarded(arm, controller, moved_s):
        sample = tick.sample
        estimate = session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        tare.after(session, estimate)
        if session.tared:
            return
        if time_s > moved_s:
            if tare.refusal is None and not controller.last_rad_s.any():
                tare.start(session)
            if tare.refusal is not None:
                raise tare.refusal
        elif time_s > 0.0:
            line = line or Fixture.here(tool, LINE_GAIN_PER_S)
            elbow = elbow or ElbowSwivel(tool, robot, motion)
            elbow.time_s = time_s - REST_S
            speed_m_s = find_stroke_speed(
                (-motion.stroke_m, motion.stroke_m),
                motion.leg_s,
                time_s - REST_S,
                0.0,
                float(line.rotation[:, 2] @ (tool.tip_m - line.goal_m)),
            )
            tick.tasks = [line, AxialSpeed(speed_m_s), elbow]
