"""Teleoperation: a hand on a haptic device moves the needle and feels the force at its
tip.

The device's side and the needle's side exchange packets over a line that may be late.
Motion goes one way, scaled; force comes back, scaled and kept passive at both ends, see
`passivity`.

    tele = Teleoperation(motion_scale=0.4, shown="tip")
    move = tele.update(device.read(), session_estimate, dt_s)
    device.render(move.force_N)                       # AxialSpeed(move.speed_m_s) for the arm
"""

import math
from typing import TYPE_CHECKING, Literal, NamedTuple, Protocol, TypeVar, get_args

import numpy as np
from numpy.typing import ArrayLike

from needleforce.control.errors import SettingError, require_positive
from needleforce.control.passivity import (
    HANDLE_kg,
    HandPort,
    MOST_DAMPING_Ns_m,
    NeedlePort,
)
from needleforce.control.ports import Array, MasterSample
from needleforce.control.tasks import vector
from residual.checks.input import as_float
from residual.estimate import Status

if TYPE_CHECKING:
    from needleforce.session import SessionEstimate

Shown = Literal["tip", "enhanced", "raw"]
Packet = TypeVar("Packet")

_CATCH_UP_PER_S = (
    10.0  # rate at which the needle makes up for travel that it could not follow
)
_SPEED_LAG_S = (
    0.01  # low-pass on the speed of the handle, which comes from its encoder's steps
)
# A delayed spring drives a hand (a stiffness k takes k T of damping away: more than the
# usual T is made up for), and so does unknown friction, both the more the less its
# motion is scaled down; and it springs forward at a rupture. So what is not steady is
# damped: at least so much, and per scale.
_LEAST_DAMPING_Ns_m = 15.0
_DAMPING_Ns_m = 50.0
_STEADY_S = 0.3
_USUAL_LAG_S = 0.015
# Where both oscillate all the same, by 3 Hz or more, damping grows up to the port's: of
# means over so long, twice the square of the mean is no swing, nor is what is slow.
_SWING_S = 0.12
_STEADIER = 2.0
_CALM_m_s = 3e-3
_FADE_S = 0.05  # a force that is not known any more fades
# Noise that is shown moves a light hand by millimetres per second, friction follows,
# and what comes back has the opposite sign: neither the loop nor the identification
# stands that. So the shown force is smooth, but never further from the known one, until
# a rupture shows at once for a while. With travel it grows by the stiffness identified,
# at most so much: a force that grows is not late.
_SMOOTH_S = 0.2
_FURTHEST_N = 0.3
_STIFFEST_N_per_m = 1000.0
_RUPTURE_S = 0.3
_AT_ONCE_S = 0.014
_COUPLING_S = (
    0.2  # so softly the force comes and goes with the clutch: no step throws the hand
)
# by the hand to the needle, see `NeedlePort`
_OWED_J = 10e-3
_OWED_W = 2e-3
_SILENCE_S = 0.1  # without news from the device for so long, the needle stands
_HELD_S = 0.02
_GAP_MEMORY_S = 1.0
"""Between two samples of the device its force stays; without one for so long it ends.
For so long a gap between two of them may come again."""
_MOST = 100.0  # no handle is further away [m], or quicker [m/s]


class HandPacket(NamedTuple):
    """From the device to the needle.

    Attributes:
        speed_m_s: Its rate, scaled.
        energy_J: That the hand has put in.
        is_coupled: Whether the hand moves the needle, which stands otherwise.
    """

    travel_m: (
        float  # of the handle along the needle while coupled, scaled to the needle
    )
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


class Line(Protocol[Packet]):
    """One way between the two sides."""

    def exchange(self, packet: Packet, dt_s: float) -> Packet | None:
        """Send a packet, let time pass, and return the newest that has arrived so
        far.
        """
        ...


def shown_force(estimate: "SessionEstimate", shown: Shown = "tip") -> float:
    """The force to be felt [N], positive against insertion.

    Never beyond the measured force nor against it: a friction estimate extrapolated to
    the speed of a jump would else pull the hand, with energy that no tissue has given.
    """
    axial_N = estimate.wrench.axial_unsmoothed  # as the tip force, which is made of it
    if shown == "raw":
        return axial_N
    found = estimate.identification
    wanted_N = found.tip_force_N if shown == "tip" else found.enhanced_force_N
    return min(max(wanted_N, min(axial_N, 0.0)), max(axial_N, 0.0))


def _along(
    axis: Array, sample: MasterSample | None
) -> tuple[float, float, bool] | None:
    """Place and speed along an axis, and the clutch; None if no handle can have such
    ones.
    """
    try:
        numbers = np.array((sample.position_m, sample.velocity_m_s), np.float64)  # type: ignore[union-attr]
        clutch = bool(sample.clutch)  # type: ignore[union-attr]
    except (AttributeError, TypeError, ValueError):
        return None
    if numbers.shape != (2, 3) or not (np.abs(numbers) < _MOST).all():
        return None
    return float(axis @ numbers[0]), float(axis @ numbers[1]), clutch


class DeviceSide:
    """The end at the haptic device: scales its motion, shows a passive force.

    Args:
        motion_scale, force_lag_s: See `Teleoperation`.
    """

    def __init__(self, motion_scale: float, force_lag_s: float = _USUAL_LAG_S) -> None:
        late_s = max(force_lag_s - _USUAL_LAG_S, 0.0)
        self._scale = motion_scale
        damping_Ns_m = _DAMPING_Ns_m + _STIFFEST_N_per_m * late_s
        self._damping_Ns_m = max(_LEAST_DAMPING_Ns_m, damping_Ns_m * motion_scale)
        self.port = HandPort()
        self.position_m: float | None = None  # of the handle, until a reset
        self.force_N = 0.0  # to render, positive against insertion
        self._packet = HandPacket(0.0, 0.0, 0.0, False)
        self._rate_m_s = self._steady_m_s = self._still_s = self._since_s = 0.0
        self._coupled = 0.0  # 0 to 1
        self._gap_s = (
            0.0  # the longest of late between two samples, over which a force is held
        )
        self._swing_m_s = self._square = (
            0.0  # means of the swing's speed and of its square
        )

    def release(self, travel_m: float = 0.0) -> None:
        """No force is held any more, after about so much travel; begin from where
        the handle is.
        """
        self.port.release(travel_m)
        self.position_m = None
        self.force_N = 0.0
        self._since_s = _HELD_S
        self._packet = self._packet._replace(speed_m_s=0.0, is_coupled=False)

    def update(
        self,
        handle: tuple[float, float, bool] | None,
        news: NeedlePacket | None,
        dt_s: float,
    ) -> HandPacket:
        """Find the force to render, and return the packet to send.

        Between samples of the handle, its place and speed inwards and the clutch, both
        stay: then the energy through the port is known exactly.
        """
        self._since_s += dt_s
        if handle is None:
            if self._since_s >= _HELD_S:
                self._coupled -= self._coupled * dt_s / (_COUPLING_S + dt_s)
                if self.position_m is not None:  # the same packet again is no news
                    self.release(self._rate_m_s * self._since_s)
            return self._packet
        before_m = self.position_m
        position_m, rate_m_s, is_coupled = handle
        dt_s = min(self._since_s, _HELD_S)
        self._since_s = 0.0
        self.position_m = position_m
        self._coupled += (is_coupled - self._coupled) * dt_s / (_COUPLING_S + dt_s)
        self._gap_s = max(dt_s, self._gap_s * math.exp(-dt_s / _GAP_MEMORY_S))
        # A handle that moves changes its place; one that only says so repeats an old
        # sample.
        self._still_s = self._still_s + dt_s if position_m == before_m else 0.0
        speed_m_s = 0.0 if self._still_s > _SILENCE_S else rate_m_s
        self._rate_m_s += (speed_m_s - self._rate_m_s) * dt_s / (_SPEED_LAG_S + dt_s)
        self._steady_m_s += (
            (self._rate_m_s - self._steady_m_s) * dt_s / (_STEADY_S + dt_s)
        )
        known_N, incoming_J = news or (0.0, 0.0)
        swing_m_s = self._rate_m_s - self._steady_m_s
        damping_N = self._damping_for(swing_m_s, dt_s) * swing_m_s
        wanted_N = known_N * self._coupled + damping_N
        times_s = (dt_s, self._gap_s)
        self.force_N = self.port.update(
            wanted_N, position_m, speed_m_s, incoming_J, times_s
        )
        scale = self._scale * is_coupled
        moved_m = 0.0 if before_m is None else position_m - before_m
        travel_m = self._packet.travel_m + scale * moved_m
        self._packet = HandPacket(
            travel_m, scale * self._rate_m_s, self.port.in_J, is_coupled
        )
        return self._packet

    def _damping_for(self, swing_m_s: float, dt_s: float) -> float:
        """Damping of what is not steady in the hand's motion [Ns/m]: more where it
        oscillates.
        """
        part = dt_s / (_SWING_S + dt_s)
        self._swing_m_s += part * (swing_m_s - self._swing_m_s)
        self._square += part * (swing_m_s**2 - self._square)
        # The mean square of a hand that springs forward is that of its mean, of a swing
        # it is more.
        swing = max(self._square - _STEADIER * self._swing_m_s**2, 0.0)
        share = swing / (self._square + _CALM_m_s**2)
        least = self._damping_Ns_m
        # A light device that is read seldom would be thrown back by more.
        most = max(min(MOST_DAMPING_Ns_m, HANDLE_kg / (2.0 * self._gap_s)), least)
        return least + share * (most - least)


class NeedleSide:
    """The end at the robot: follows the hand within a speed limit, sends the force to
    be shown.

    Energy at the hand is that at the needle times force scale / motion scale.
    """

    def __init__(
        self, motion_scale: float, force_scale: float, speed_limit_m_s: float
    ) -> None:
        self._scale = scale = force_scale / motion_scale
        self._force_scale = force_scale
        self._limit_m_s = speed_limit_m_s
        self.port = NeedlePort(_OWED_J / scale, _OWED_W / scale)
        self.start_m: float | None = (
            None  # depth without travel of the hand, until a reset
        )
        self._last: HandPacket | None = None
        self._silent_s = 0.0

    def update(
        self,
        news: HandPacket | None,
        force_N: float,
        depth_m: float,
        now_m_s: float,
        dt_s: float,
    ) -> tuple[float, NeedlePacket]:
        """The speed to move with, positive inwards, and the packet to send.

        The force is the one to be shown, not scaled; depth counts from any zero.
        """
        self._silent_s = self._silent_s + dt_s if news is self._last else 0.0
        self._last = news
        wanted_m_s = incoming_J = 0.0
        if news is not None:
            if (
                self.start_m is None
                or not news.is_coupled
                or self._silent_s >= _SILENCE_S
            ):
                self.start_m = depth_m - news.travel_m
            incoming_J = news.energy_J
            if self._silent_s < _SILENCE_S:
                behind_m = self.start_m + news.travel_m - depth_m
                wanted_m_s = news.speed_m_s + _CATCH_UP_PER_S * behind_m
        wanted_m_s = min(max(wanted_m_s, -self._limit_m_s), self._limit_m_s)
        speed_m_s = self.port.update(
            wanted_m_s, force_N, now_m_s, incoming_J / self._scale, dt_s
        )
        return speed_m_s, NeedlePacket(
            self._force_scale * force_N, self._scale * self.port.in_J
        )


class TeleopCommand(NamedTuple):
    """What to do until the next tick.

    Attributes:
        speed_m_s: Of the needle along its axis, positive inwards.
        force_N: To render at the device, shape (3,), in its axes.
    """

    speed_m_s: float
    force_N: Array


class Teleoperation:
    """Both sides and the line between them, for a loop that has the device and the arm.

    Args:
        axis: Direction of the handle, in the device's axes, that drives the needle
            inwards.
        motion_scale: Needle travel per travel of the handle, 0.1 to 1.
        force_scale: Force at the hand per force at the needle.
        shown: Force at the tip; ``enhanced``, less friction of layers traversed;
            ``raw``, measured.
        speed_limit_m_s: Largest speed of the needle.
        force_lag_s: Lag of the session's observer, one over its gain; a later force is
            damped more.
        lines: From the device to the needle, and back; None for no delay.

    Attributes:
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
        force_lag_s: float = _USUAL_LAG_S,
        lines: tuple[Line[HandPacket], Line[NeedlePacket]] | None = None,
    ) -> None:
        direction = vector(axis, 3, "axis")
        if not direction.any():
            raise SettingError(
                f"axis is {axis!r}, expected three numbers that are not all zero"
            )
        if not 0.1 <= as_float(motion_scale) <= 1.0:
            raise SettingError(f"motion_scale is {motion_scale!r}, expected 0.1 to 1")
        numbers = {"force_scale": force_scale, "speed_limit_m_s": speed_limit_m_s}
        require_positive(numbers | {"force_lag_s": force_lag_s})
        if shown not in get_args(Shown):
            raise SettingError(
                f"shown is {shown!r}, expected 'tip', 'enhanced' or 'raw'"
            )
        if lines is not None and not all(hasattr(line, "exchange") for line in lines):
            raise SettingError(f"lines are {lines!r}, expected two lines or None")
        self._shown: Shown = shown
        self._axis = direction / np.linalg.norm(direction)
        self._lines = lines
        self.device = DeviceSide(motion_scale, force_lag_s)
        self.needle = NeedleSide(motion_scale, force_scale, speed_limit_m_s)
        self._from_needle: NeedlePacket | None = None
        self.shown_N = self._ruptured_s = 0.0

    def reset(self) -> None:
        """Begin anew from where handle and needle are; accounts of energy go on.

        Call it after a pause or a new zero of depth, or the needle makes up for the
        hand's motion.
        """
        self.device.release()
        self.needle.start_m = None

    def update(
        self, sample: MasterSample | None, estimate: "SessionEstimate", dt_s: float
    ) -> TeleopCommand:
        """Take the device's newest sample and the newest force; never raises.

        Args:
            sample: Of the haptic device, or None; one that no handle can have counts as
                none.
            estimate: Of the session: force and depth.
            dt_s: Since the last call; if it does not advance, the needle stands, the
                force stays.
        """
        dt_s = as_float(dt_s)
        if not 0.0 < dt_s < math.inf:
            return TeleopCommand(0.0, -self.device.force_N * self._axis)
        faded_N = _FADE_S / (_FADE_S + dt_s) * self.shown_N
        is_ok = estimate.status is Status.OK
        self.shown_N = self._smoothed(estimate, dt_s) if is_ok else faded_N
        sent = self.device.update(_along(self._axis, sample), self._from_needle, dt_s)
        lines = self._lines
        travel = (estimate.depth_m, estimate.speed_m_s)
        arrived = sent if lines is None else lines[0].exchange(sent, dt_s)
        speed_m_s, answer = self.needle.update(arrived, self.shown_N, *travel, dt_s)
        self._from_needle = answer if lines is None else lines[1].exchange(answer, dt_s)
        return TeleopCommand(speed_m_s, -self.device.force_N * self._axis)

    def _smoothed(self, estimate: "SessionEstimate", dt_s: float) -> float:
        """The force to be felt, less its noise; the raw one as it is."""
        known_N = shown_force(estimate, self._shown)
        if self._shown == "raw":
            return known_N
        has_ruptured = estimate.identification.rupture is not None
        self._ruptured_s = (
            _RUPTURE_S if has_ruptured else max(self._ruptured_s - dt_s, 0.0)
        )
        lag_s = _AT_ONCE_S if self._ruptured_s > 0.0 else _SMOOTH_S
        slope = min(
            max(estimate.identification.stiffness_N_per_m, 0.0), _STIFFEST_N_per_m
        )
        pace = (
            estimate.speed_m_s if known_N > 0.0 else 0.0
        )  # drawn back it touches nothing
        grown_N = self.shown_N + slope * pace * dt_s
        smooth_N = grown_N + (known_N - grown_N) * dt_s / (lag_s + dt_s)
        return min(max(smooth_N, known_N - _FURTHEST_N), known_N + _FURTHEST_N)
