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
from abc import abstractmethod
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.control.errors import SettingError, as_vector, require_positive
from needleforce.control.handle_watch import HandleReport
from needleforce.control.passivity import (
    MAX_FORCE_N,
    HANDLE_kg,
    HandPort,
    MAX_DAMPING_Ns_m,
    NeedlePort,
)
from residual.checks.input import as_float
from residual.estimate import Status

if TYPE_CHECKING:
    from needleforce.session import SessionEstimate

Shown = Literal["tip", "enhanced", "raw"]
Packet = TypeVar("Packet")

USUAL_FORCE_LAG_s = 0.015
"""Lag of the force that the usual damping makes up for: of the default observer."""

MAX_STIFFNESS_N_per_m = 1000.0
"""Largest stiffness of tissue that is reckoned with."""

COUPLING_s = 0.2
"""So softly the force comes with the clutch: no step throws the hand."""

MAX_HOLD_s = 0.02
"""Between two samples of the device its force stays; without one for so long it
ends."""


class Line(Protocol[Packet]):
    """One way between the two sides."""

    @abstractmethod
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


class HandPacket(NamedTuple):
    """From the device to the needle.

    Attributes:
        travel_m: Of the handle along the needle while coupled, scaled to the needle.
        speed_m_s: Its rate, scaled.
        energy_J: That the hand has put in.
        is_coupled: Whether the hand moves the needle, which stands otherwise.
    """

    travel_m: float
    speed_m_s: float
    energy_J: float
    is_coupled: bool


class NeedlePacket(NamedTuple):
    """From the needle to the device.

    Attributes:
        force_N: To be shown, scaled to the hand.
        energy_J: That the tissue has given back, scaled to the hand.
    """

    force_N: float
    energy_J: float


class DeviceSide:
    """The end at the haptic device: scales its motion, shows a passive force.

    Args:
        axis: Direction of the handle that drives the needle inwards, of length one,
            shape (3,).
        motion_scale: See `Teleoperation`.
        speed_limit_m_s: Of the needle, see `Teleoperation`.
        force_lag_s: See `Teleoperation`.
        max_force_N: See `Teleoperation`.

    Attributes:
        port: Energy between device and hand.
        force_N: To render, positive against insertion.
        doubt: Why the needle stands until the clutch has been opened; else empty.
    """

    def __init__(
        self,
        axis: Array,
        motion_scale: float,
        speed_limit_m_s: float,
        force_lag_s: float,
        max_force_N: float,
    ) -> None:
        # Quick motion is damped by 50 Ns/m per motion scale, and 15 at least. A delayed
        # spring drives a hand (a stiffness k takes k T of damping away), and so does
        # friction that is not known yet, both the more the less its motion is scaled
        # down; and a hand springs forward at a rupture.
        late_s = max(force_lag_s - USUAL_FORCE_LAG_s, 0.0)
        damping_Ns_m = 50.0 + MAX_STIFFNESS_N_per_m * late_s
        self._damping_Ns_m = max(15.0, damping_Ns_m * motion_scale)
        self._axis = axis
        self._scale = motion_scale
        self._max_followed_m_s = speed_limit_m_s / motion_scale  # of the handle
        self.port = HandPort(max_force_N)
        self.force_N = 0.0
        self.doubt = ""
        self._position_m: float | None = None  # None after a release
        self._packet = HandPacket(0.0, 0.0, 0.0, False)
        self._speed_m_s = 0.0  # of the handle, smoothed
        self._steady_m_s = 0.0  # the slow part of it
        self._quick_m_s = 0.0  # mean of the rest of it, and of its square
        self._quick_m2_s2 = 0.0
        self._since_s = 0.0  # time since the last sample
        self._coupling = 0.0  # 0 to 1, follows the clutch
        self._gap_s = 0.0  # longest of late between two samples

    def let_go(self) -> None:
        """Let go of a handle that is gone, or elsewhere: the next sample says where."""
        if self._position_m is None:
            return
        self.port.release(self._speed_m_s * self._since_s)
        self._position_m = None
        self.force_N = 0.0
        self._since_s = MAX_HOLD_s
        self._packet = self._packet._replace(speed_m_s=0.0, is_coupled=False)

    def update(
        self, report: HandleReport, news: NeedlePacket | None, dt_s: float
    ) -> HandPacket:
        """Find the force to render, and return the packet to send.

        Between samples of the handle its force stays: then the energy through the port
        is known exactly. A handle that has jumped, or is in doubt, drives no needle
        until the clutch has been opened.

        Args:
            report: What a sample of the haptic device is good for, by `HandleWatch`.
            news: The newest packet from the needle, or None.
            dt_s: Time since the last call.
        """
        reading = report.reading
        if report.fault or report.has_jumped:
            self.let_go()
        if reading is not None and not reading.is_coupled:
            self.doubt = ""
        elif reading is not None and report.doubt and not self.doubt:
            self.doubt = f"{report.doubt}: open the clutch and close it again"
        self._since_s += dt_s
        if reading is None or report.has_jumped:
            if self._since_s >= MAX_HOLD_s:
                self._coupling -= self._coupling * dt_s / (COUPLING_s + dt_s)
                self.let_go()
            return self._packet
        position_m = float(self._axis @ reading.position_m)
        speed_m_s = float(self._axis @ reading.velocity_m_s)
        is_coupled = reading.is_coupled and not self.doubt
        dt_s = min(self._since_s, MAX_HOLD_s)
        self._since_s = 0.0
        last_m = position_m if self._position_m is None else self._position_m
        self._position_m = position_m
        self._coupling += (is_coupled - self._coupling) * dt_s / (COUPLING_s + dt_s)
        # For a second a gap between two samples may come again.
        self._gap_s = max(dt_s, self._gap_s * math.exp(-dt_s))
        damping_N = self._damp_motion(speed_m_s, dt_s, is_coupled=is_coupled)
        known_N, incoming_J = news or (0.0, 0.0)
        self.force_N = self.port.update(
            known_N * self._coupling + damping_N,
            position_m,
            speed_m_s,
            incoming_J,
            dt_s=dt_s,
            ahead_s=self._gap_s,
            is_coupled=is_coupled,
        )
        scale = self._scale * is_coupled
        # A needle at 100 mm/s would go on by a millimetre after a hand that stops dead.
        sent_m_s = min(max(self._speed_m_s, speed_m_s - 0.01), speed_m_s + 0.01)
        self._packet = HandPacket(
            travel_m=self._packet.travel_m + scale * (position_m - last_m),
            speed_m_s=scale * sent_m_s,
            energy_J=self.port.in_J,
            is_coupled=is_coupled,
        )
        return self._packet

    def _damp_motion(self, speed_m_s: float, dt_s: float, *, is_coupled: bool) -> float:
        """Return the force that damps what is not steady in the hand's motion.

        Motion that lasts longer than 0.3 s is steady. It is damped, too, where it is
        faster than a coupled needle may follow: the hand feels that travel is dropped.

        The damping grows where the motion swings by 3 Hz or more, over means of 0.12 s.
        Of a hand that springs forward the mean square of the speed is that of its mean;
        what exceeds twice that is a swing, and one below 3 mm/s need not be damped. A
        light device that is read seldom
        would be thrown back by more than its mass over twice the time between samples.
        """
        self._speed_m_s += (speed_m_s - self._speed_m_s) * dt_s / (0.01 + dt_s)
        self._steady_m_s += (self._speed_m_s - self._steady_m_s) * dt_s / (0.3 + dt_s)
        quick_m_s = self._speed_m_s - self._steady_m_s
        weight = dt_s / (0.12 + dt_s)
        self._quick_m_s += weight * (quick_m_s - self._quick_m_s)
        self._quick_m2_s2 += weight * (quick_m_s**2 - self._quick_m2_s2)
        swing_m2_s2 = max(self._quick_m2_s2 - 2.0 * self._quick_m_s**2, 0.0)
        swing_fraction = swing_m2_s2 / (self._quick_m2_s2 + 3e-3**2)
        lowest_Ns_m = self._damping_Ns_m
        highest_Ns_m = max(
            min(MAX_DAMPING_Ns_m, HANDLE_kg / (2.0 * self._gap_s)), lowest_Ns_m
        )
        damping_Ns_m = lowest_Ns_m + swing_fraction * (highest_Ns_m - lowest_Ns_m)
        if not is_coupled:
            return damping_Ns_m * quick_m_s
        max_m_s = self._max_followed_m_s
        followed_m_s = min(max(self._steady_m_s, -max_m_s), max_m_s)
        return damping_Ns_m * (self._speed_m_s - followed_m_s)


class NeedleSide:
    """The end at the robot: follows the hand within a speed limit, sends the force.

    Travel of the hand that is too quick for the needle is dropped: when the hand stands
    the needle has at most 1 mm left, and what its largest speed makes up for in 40 ms:
    0.8 mm at 20 mm/s. Without news from the device for 0.1 s it stands. Both ports
    count what hand and needle really do, so passivity does not depend on what is
    dropped.

    Energy at the hand is that at the needle times force scale / motion scale.

    Args:
        motion_scale: See `Teleoperation`.
        force_scale: See `Teleoperation`.
        speed_limit_m_s: See `Teleoperation`.

    Attributes:
        port: Energy between needle and tissue.
        start_m: Depth without travel of the hand; None until the first packet and after
            a reset.
    """

    def __init__(
        self, motion_scale: float, force_scale: float, speed_limit_m_s: float
    ) -> None:
        self._energy_scale = force_scale / motion_scale
        self._force_scale = force_scale
        self._limit_m_s = speed_limit_m_s
        # What the hand may owe the needle: a delayed force is shown too low while it
        # rises. It is refilled by what hand and tissue dissipate in any case [J, W].
        self.port = NeedlePort(10e-3 / self._energy_scale, 2e-3 / self._energy_scale)
        self.start_m: float | None = None
        self._news: HandPacket | None = None
        self._silent_s = 0.0

    def update(
        self,
        news: HandPacket | None,
        force_N: float,
        depth_m: float,
        speed_m_s: float,
        dt_s: float,
    ) -> tuple[float, NeedlePacket]:
        """Return the speed to move with, and the packet to send.

        Args:
            news: The newest packet from the device, or None.
            force_N: The force to be shown, not scaled.
            depth_m: Of the needle, from any zero.
            speed_m_s: Of the needle, positive inwards.
            dt_s: Time since the last call.
        """
        self._silent_s = self._silent_s + dt_s if news is self._news else 0.0
        self._news = news
        wanted_m_s = 0.0
        incoming_J = 0.0
        if news is not None:
            incoming_J = news.energy_J
            is_silent = self._silent_s >= 0.1
            if self.start_m is None or not news.is_coupled or is_silent:
                self.start_m = depth_m - news.travel_m
            behind_m = self.start_m + news.travel_m - depth_m
            # What the hand is ahead by beyond this is dropped: its zero moves with it.
            max_m = min(0.04 * self._limit_m_s, 1e-3)
            dropped_m = behind_m - min(max(behind_m, -max_m), max_m)
            self.start_m -= dropped_m
            if not is_silent:
                wanted_m_s = news.speed_m_s + 10.0 * (behind_m - dropped_m)
        wanted_m_s = min(max(wanted_m_s, -self._limit_m_s), self._limit_m_s)
        passive_m_s = self.port.update(
            wanted_m_s, force_N, speed_m_s, incoming_J / self._energy_scale, dt_s
        )
        return passive_m_s, NeedlePacket(
            force_N=self._force_scale * force_N,
            energy_J=self._energy_scale * self.port.in_J,
        )


class Teleoperation:
    """Both sides and the line between them, for a loop that has the device and the arm.

    Args:
        axis: Direction of the handle, in the device's axes, that drives the needle
            inwards.
        motion_scale: Needle travel per travel of the handle, 0.1 to 1: the hand would
            travel more than a metre into an abdomen, the needle be quicker than it.
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
        if not 0.1 <= as_float(motion_scale) <= 1.0:
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
            shown_N = 0.05 / (0.05 + dt_s) * self.shown_N  # it fades over 50 ms
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

        Noise that is shown moves a light hand by millimetres per second, friction
        follows, and what comes back has the opposite sign: neither the loop nor the
        identification stands that.

        It is smoothed over 0.2 s. For 0.3 s after an alarm, confirmed or provisional,
        it is smoothed over one lag of the observer: a rupture is felt at once, and one
        that is retracted costs some noise. It is never further than 0.3 N from the
        estimate.

        With travel the shown force grows by the stiffness identified: a force that
        grows is not late. A needle that is drawn back touches nothing.
        """
        known_N = shown_force(estimate, self._shown)
        if self._shown == "raw":
            return known_N
        alarms = estimate.identification
        has_alarm = alarms.rupture is not None or alarms.provisional is not None
        left_s = max(self._rupture_left_s - dt_s, 0.0)
        self._rupture_left_s = 0.3 if has_alarm else left_s
        lag_s = 0.014 if self._rupture_left_s > 0.0 else 0.2
        stiffness_N_per_m = min(
            max(estimate.identification.stiffness_N_per_m, 0.0), MAX_STIFFNESS_N_per_m
        )
        pressing_m_s = estimate.speed_m_s if known_N > 0.0 else 0.0
        grown_N = self.shown_N + stiffness_N_per_m * pressing_m_s * dt_s
        smooth_N = grown_N + (known_N - grown_N) * dt_s / (lag_s + dt_s)
        return min(max(smooth_N, known_N - 0.3), known_N + 0.3)
