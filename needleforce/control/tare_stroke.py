"""The motion before a tare: a stroke along the needle.

The needle is drawn back and returns, on its line:

    x(t) = -L s(t / T),  then  -L + L s(t / T - 1),    s(u) = 10 u^3 - 15 u^4 + 6 u^5

Friction of bearings depends on their speed: so the motion is slow, as the insertion is.
See `residual.bias`.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from needleforce.control.controller import Controller
from needleforce.control.errors import require_positive
from needleforce.control.joint_limits import Limits
from needleforce.control.ports import Arm
from needleforce.control.run import move_guarded
from needleforce.control.tasks import AxialSpeed, Fixture, Posture
from needleforce.tare_run import TareRun
from urdf import Robot

if TYPE_CHECKING:
    from needleforce.session import InsertionSession

LINE_GAIN_PER_S = 10.0
"""Gain that keeps the needle to its line and its course: arms follow late, and
positions may be rounded to 2e-4 rad."""

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
    # Twice the fastest of the course.
    max_m_s = 3.75 * max(map(abs, legs_m)) / leg_s
    return min(max(speed_m_s, -max_m_s), max_m_s)


def tare_with_stroke(
    arm: Arm,
    session: "InsertionSession",
    limits: Limits,
    *,
    stroke_m: float = 0.06,
    leg_s: float = 10.0,
    robot: Robot | None = None,
) -> None:
    """Move an arm in free air, and tare a session from that motion.

    The needle is drawn back and returns; the arm rests while the tare is fitted. At the
    end the arm is at rest where it began, and the session is tared.

    Args:
        arm: It moves without a question.
        session: Of the same arm; what it recorded before is not used for the tare.
        limits: What the joints may do.
        stroke_m: L, the way back along the needle, and forth again.
        leg_s: T, time each way; a quick stroke meets other friction than an insertion.
        robot: The model of the arm; None for `Arm.robot`.

    Raises:
        ControlError: The arm has not moved as it should; it has been brought to rest.
        TareError: The motion looks like contact or like other torques than the model's.
        SettingError: The stroke or its time is not positive.
    """
    require_positive({"stroke_m": stroke_m, "leg_s": leg_s})
    controller = Controller(arm.robot if robot is None else robot, limits)
    tare = TareRun()
    session.start_tare_recording()
    line: Fixture | None = None
    posture: Posture | None = None
    moved_s = 2.0 * leg_s + 2.0 * REST_S
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
            line = line or Fixture.here(controller.tool, LINE_GAIN_PER_S)
            posture = posture or Posture(controller.tool.q_rad)
            speed_m_s = find_stroke_speed(
                (-stroke_m, stroke_m),
                leg_s,
                time_s - REST_S,
                0.0,
                float(line.rotation[:, 2] @ (controller.tool.tip_m - line.goal_m)),
            )
            tick.tasks = [line, AxialSpeed(speed_m_s), posture]
