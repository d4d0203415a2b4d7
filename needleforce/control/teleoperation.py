"""Teleoperation: a hand on a haptic device moves the needle and feels its tip force.

The device's side and the needle's side exchange packets over a line that may be late.
Motion goes one way, scaled; force comes back, scaled and kept passive at both ends, see
`passivity`.

    tele = Teleoperation(motion_scale=0.4, shown="tip")
    move = tele.update(tick.check_handle(device.read()), session_estimate, dt_s)
    device.render(move.force_N)
    stack = [fixture, AxialSpeed(move.speed_m_s)]               # for the arm
"""

import math
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.control.errors import SettingError, as_vector, require_positive
from needleforce.control.handle_watch import HandleReport
from needleforce.control.passivity import MAX_FORCE_N
from needleforce.control.teleoperation_sides import (
    DeviceSide,
    HandPacket,
    MAX_STIFFNESS_N_per_m,
    NeedlePacket,
    NeedleSide,
    USUAL_FORCE_LAG_s,
)
from residual.checks.input import as_float
from residual.estimate import Status

if TYPE_CHECKING:
    from needleforce.session import SessionEstimate

Shown = Literal["tip", "enhanced", "raw"]
Packet = TypeVar("Packet")

# Noise that is shown moves a light hand by millimetres per second, friction follows,
# and what comes back has the opposite sign: neither the loop nor the identification
# stands that. So the shown force is smooth.

SMOOTHING_s = 0.2
"""Time constant of the shown force."""

MAX_DIFFERENCE_N = 0.3
"""The shown force is never further from the estimate than this, however late it is."""

RUPTURE_SHOWN_s = 0.3
"""For so long after a rupture the estimate is shown at once."""

RUPTURE_SMOOTHING_s = 0.014
"""Time constant of the shown force during that time: one lag of the observer."""

FADING_s = 0.05
"""Time constant with which a force fades that is not known any more."""

MIN_MOTION_SCALE = 0.1
"""A smaller scale would make the hand travel more than a meter into an abdomen."""

MAX_MOTION_SCALE = 1.0
"""A needle is not to be quicker than the hand."""


class Line(Protocol[Packet]):
    """One way between the two sides."""

    def exchange(self, packet: Packet, dt_s: float) -> Packet | None:
        """Send a packet, let time pass, return the newest that has arrived so far."""


def shown_force(estimate: "SessionEstimate", shown: Shown = "tip") -> float:
    """Return the force to be felt [N], positive against insertion.

    It is never beyond the measured force nor against it: a friction estimate
    extrapolated to the speed of a jump would else pull the hand, with energy that no
    tissue has given.
    """
    axial_N = estimate.wrench.axial_unsmoothed  # as the tip force, which is made of it
    if shown == "raw":
        return axial_N
    force_N = estimate.identification.tip_force_N
    if shown == "enhanced":
        force_N = estimate.identification.enhanced_force_N
    return min(max(force_N, min(axial_N, 0.0)), max(axial_N, 0.0))


class TeleopCommand(NamedTuple):
    """What to do until the next tick.

    Attributes:
        speed_m_s: Of the needle along its axis, positive inwards.
        force_N: To render at the device, shape (3,), in its axes.
        reason: Why the needle stands although the clutch is closed; empty if it does
            not.
    """

    speed_m_s: float
    force_N: Array
    reason: str = ""


class Teleoperation:
    """Both sides and the line between them, for a loop that has the device and the arm.

    Args:
        axis: Direction of the handle, in the device's axes, that drives the needle
            inwards.
        motion_scale: Needle travel per travel of the handle, 0.1 to 1.
        force_scale: Force at the hand per force at the needle.
        shown: Force at the tip; ``enhanced``, less friction of layers traversed;
            ``raw``, measured.
        speed_limit_m_s: Largest speed of the needle. What a quicker hand is ahead by
            more than the needle covers in 40 ms, or 1 mm, is dropped, and the hand is
            damped: the needle stands when the hand stands.
        force_lag_s: Lag of the session's observer, one over its gain; a later force is
            damped more.
        max_force_N: Largest force at the hand; it takes 10 ms to grow that large.
        lines: From the device to the needle, and back; None for no delay.

    Attributes:
        device: The device's side.
        needle: The needle's side.
        shown_N: The force that is to be felt, before scale, delay and passivity.

    Raises:
        SettingError: A scale out of range, a limit not positive, an unknown force, a
            zero axis.
    """

    def __init__(
        self,
        *,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        motion_scale: float = 0.4,
        force_scale: float = 1.0,
        shown: Shown = "tip",
        speed_limit_m_s: float = 0.02,
        force_lag_s: float = USUAL_FORCE_LAG_s,
        max_force_N: float = MAX_FORCE_N,
        lines: tuple[Line[HandPacket], Line[NeedlePacket]] | None = None,
    ) -> None:
        direction = as_vector(axis, 3, "axis")
        if not direction.any():
            raise SettingError(
                f"axis is {axis!r}, expected three numbers that are not all zero"
            )
        if not MIN_MOTION_SCALE <= as_float(motion_scale) <= MAX_MOTION_SCALE:
            raise SettingError(f"motion_scale is {motion_scale!r}, expected 0.1 to 1")
        require_positive(
            {
                "force_scale": force_scale,
                "speed_limit_m_s": speed_limit_m_s,
                "force_lag_s": force_lag_s,
                "max_force_N": max_force_N,
            }
        )
        if shown not in get_args(Shown):
            raise SettingError(
                f"shown is {shown!r}, expected 'tip', 'enhanced' or 'raw'"
            )
        self._shown: Shown = shown
        self._axis = direction / np.linalg.norm(direction)
        self._lines = lines
        self.device = DeviceSide(
            self._axis, motion_scale, speed_limit_m_s, force_lag_s, max_force_N
        )
        self.needle = NeedleSide(motion_scale, force_scale, speed_limit_m_s)
        self._from_needle: NeedlePacket | None = None
        self.shown_N = 0.0
        self._rupture_left_s = 0.0  # time for which a rupture is still shown at once

    def reset(self) -> None:
        """Begin anew from where handle and needle are; accounts of energy go on.

        Call it after a pause or a new zero of depth, or the needle makes up for the
        hand's motion.
        """
        self.device.let_go()
        self.device.doubt = ""
        self.needle.start_m = None

    def update(
        self, report: HandleReport, estimate: "SessionEstimate", dt_s: float
    ) -> TeleopCommand:
        """Return what to do until the next tick; never raise.

        A handle that jumps, or whose velocity goes on contradicting its positions, lets
        the needle stand until the clutch has been opened, or `reset`.

        Args:
            report: What a sample of the haptic device is good for, by `HandleWatch`.
            estimate: Of the session: force and depth.
            dt_s: Since the last call; if it does not advance, the needle stands, the
                force stays.
        """
        dt_s = as_float(dt_s)
        if not 0.0 < dt_s < math.inf:
            return TeleopCommand(0.0, -self.device.force_N * self._axis)
        is_known = estimate.status is Status.OK
        shown_N = self._smooth_force(estimate, dt_s) if is_known else math.nan
        if not math.isfinite(shown_N):
            shown_N = FADING_s / (FADING_s + dt_s) * self.shown_N
        self.shown_N = shown_N
        news: HandPacket | None = self.device.update(report, self._from_needle, dt_s)
        if self._lines is not None:
            news = self._lines[0].exchange(news, dt_s)
        speed_m_s, self._from_needle = self.needle.update(
            news, self.shown_N, estimate.depth_m, estimate.speed_m_s, dt_s
        )
        if self._lines is not None:
            self._from_needle = self._lines[1].exchange(self._from_needle, dt_s)
        force_N = -self.device.force_N * self._axis
        return TeleopCommand(speed_m_s, force_N, report.fault or self.device.doubt)

    def _smooth_force(self, estimate: "SessionEstimate", dt_s: float) -> float:
        """Return the force to be felt, less its noise; the raw one as it is.

        After an alarm, confirmed or provisional, the force is smoothed less: a rupture
        is felt at once, and one that is retracted costs some noise.

        With travel the shown force grows by the stiffness identified: a force that
        grows is not late. A needle that is drawn back touches nothing.
        """
        known_N = shown_force(estimate, self._shown)
        if self._shown == "raw":
            return known_N
        alarms = estimate.identification
        has_alarm = alarms.rupture is not None or alarms.provisional is not None
        left_s = max(self._rupture_left_s - dt_s, 0.0)
        self._rupture_left_s = RUPTURE_SHOWN_s if has_alarm else left_s
        lag_s = RUPTURE_SMOOTHING_s if self._rupture_left_s > 0.0 else SMOOTHING_s
        stiffness_N_per_m = min(
            max(estimate.identification.stiffness_N_per_m, 0.0), MAX_STIFFNESS_N_per_m
        )
        pressing_m_s = estimate.speed_m_s if known_N > 0.0 else 0.0
        grown_N = self.shown_N + stiffness_N_per_m * pressing_m_s * dt_s
        smooth_N = grown_N + (known_N - grown_N) * dt_s / (lag_s + dt_s)
        return min(
            max(smooth_N, known_N - MAX_DIFFERENCE_N), known_N + MAX_DIFFERENCE_N
        )
