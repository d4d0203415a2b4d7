"""The two sides of a teleoperation, and the packets between them.

The device's side scales the motion of the hand and shows it a passive force; the
needle's side follows within a speed limit and sends the force. See `teleoperation`.
"""

import math
from typing import NamedTuple

from foundation.arrays import Array
from needleforce.control.handle_watch import HandleReport
from needleforce.control.passivity import (
    HANDLE_kg,
    HandPort,
    MAX_DAMPING_Ns_m,
    NeedlePort,
)

USUAL_FORCE_LAG_s = 0.015
"""Lag of the force that the usual damping makes up for: of the default observer."""

MAX_STIFFNESS_N_per_m = 1000.0
"""Largest stiffness of tissue that is reckoned with."""

DAMPING_Ns_m = 50.0
"""Damping of quick motion, per motion scale. A delayed spring drives a hand (a
stiffness k takes k T of damping away), and so does friction that is not known yet, both
the more the less its motion is scaled down; and a hand springs forward at a rupture."""

MIN_DAMPING_Ns_m = 15.0
"""Least damping of quick motion, whatever the scale."""

STEADY_s = 0.3
"""Motion that lasts longer is steady: it is not damped, as far as the needle follows
it."""

SPEED_LAG_s = 0.01
"""Low-pass on the speed of the handle, which comes from its encoder's steps."""

MAX_SPEED_ERROR_m_s = 0.01
"""The needle is sent that speed, which is never further than this from the handle's: a
needle at 100 mm/s would go on by a millimetre after a hand that stops dead."""

SWING_MEMORY_s = 0.12
"""Time of the means that show a swing of 3 Hz or more, where damping grows up to the
port's."""

SWING_RATIO = 2.0
"""Of a hand that springs forward the mean square of the speed is that of its mean; what
exceeds so many times that is a swing."""

CALM_m_s = 3e-3
"""A slower swing is none that must be damped."""

COUPLING_s = 0.2
"""So softly the force comes with the clutch: no step throws the hand."""

MAX_HOLD_s = 0.02
"""Between two samples of the device its force stays; without one for so long it
ends."""

GAP_MEMORY_s = 1.0
"""For so long a gap between two samples of the device may come again."""

MAX_SILENCE_s = 0.1
"""Without news from the device for so long the needle stands."""

CATCH_UP_PER_s = 10.0
"""Rate at which the needle makes up for travel that it could not follow."""

MAX_BACKLOG_s = 0.04
"""Travel that the needle's largest speed does not make up for in so long is dropped:
when the hand stands the needle has at most this left, 0.8 mm at 20 mm/s."""

MAX_BACKLOG_m = 1e-3
"""The same, whatever the largest speed is."""

NEEDLE_ALLOWANCE_J = 10e-3
"""What the hand may owe the needle, see `NeedlePort`: a delayed force is shown too low
while it rises."""

NEEDLE_ALLOWANCE_W = 2e-3
"""By so much that allowance is refilled: hand and tissue dissipate as much in any
case."""


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
        late_s = max(force_lag_s - USUAL_FORCE_LAG_s, 0.0)
        damping_Ns_m = DAMPING_Ns_m + MAX_STIFFNESS_N_per_m * late_s
        self._damping_Ns_m = max(MIN_DAMPING_Ns_m, damping_Ns_m * motion_scale)
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
        self._gap_s = max(dt_s, self._gap_s * math.exp(-dt_s / GAP_MEMORY_s))
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
        slowest_m_s = speed_m_s - MAX_SPEED_ERROR_m_s
        fastest_m_s = speed_m_s + MAX_SPEED_ERROR_m_s
        self._packet = HandPacket(
            travel_m=self._packet.travel_m + scale * (position_m - last_m),
            speed_m_s=scale * min(max(self._speed_m_s, slowest_m_s), fastest_m_s),
            energy_J=self.port.in_J,
            is_coupled=is_coupled,
        )
        return self._packet

    def _damp_motion(self, speed_m_s: float, dt_s: float, *, is_coupled: bool) -> float:
        """Return the force that damps what is not steady in the hand's motion.

        Steady motion is damped, too, where it is faster than a coupled needle may
        follow: the hand feels that travel is dropped.

        The damping grows where the motion swings. A light device that is read seldom
        would be thrown back by more than its mass over twice the time between samples.
        """
        self._speed_m_s += (speed_m_s - self._speed_m_s) * dt_s / (SPEED_LAG_s + dt_s)
        self._steady_m_s += (
            (self._speed_m_s - self._steady_m_s) * dt_s / (STEADY_s + dt_s)
        )
        quick_m_s = self._speed_m_s - self._steady_m_s
        weight = dt_s / (SWING_MEMORY_s + dt_s)
        self._quick_m_s += weight * (quick_m_s - self._quick_m_s)
        self._quick_m2_s2 += weight * (quick_m_s**2 - self._quick_m2_s2)
        swing_m2_s2 = max(self._quick_m2_s2 - SWING_RATIO * self._quick_m_s**2, 0.0)
        swing_fraction = swing_m2_s2 / (self._quick_m2_s2 + CALM_m_s**2)
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

    Travel of the hand that is too quick for the needle is dropped: it goes on for no
    longer than `MAX_BACKLOG_s` would take. Both ports count what hand and needle really
    do, so passivity does not depend on what is dropped.

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
        scale = force_scale / motion_scale
        self._energy_scale = scale
        self._force_scale = force_scale
        self._limit_m_s = speed_limit_m_s
        self.port = NeedlePort(NEEDLE_ALLOWANCE_J / scale, NEEDLE_ALLOWANCE_W / scale)
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
            is_silent = self._silent_s >= MAX_SILENCE_s
            if self.start_m is None or not news.is_coupled or is_silent:
                self.start_m = depth_m - news.travel_m
            behind_m = self.start_m + news.travel_m - depth_m
            # What the hand is ahead by beyond this is dropped: its zero moves with it.
            max_m = min(MAX_BACKLOG_s * self._limit_m_s, MAX_BACKLOG_m)
            dropped_m = behind_m - min(max(behind_m, -max_m), max_m)
            self.start_m -= dropped_m
            if not is_silent:
                wanted_m_s = news.speed_m_s + CATCH_UP_PER_s * (behind_m - dropped_m)
        wanted_m_s = min(max(wanted_m_s, -self._limit_m_s), self._limit_m_s)
        passive_m_s = self.port.update(
            wanted_m_s, force_N, speed_m_s, incoming_J / self._energy_scale, dt_s
        )
        return passive_m_s, NeedlePacket(
            force_N=self._force_scale * force_N,
            energy_J=self._energy_scale * self.port.in_J,
        )
