"""Teleoperation: a hand on a haptic device moves the needle and feels the force at its tip.

The device's side and the needle's side exchange packets over a line that may be late. Motion goes
one way, scaled; force comes back, scaled and kept passive at both ends, see `passivity`.

    tele = Teleoperation(motion_scale=0.4, shown="tip")
    move = tele.update(device.read(), session_estimate, dt_s)
    device.render(move.force_N)                       # AxialSpeed(move.speed_m_s) for the arm

Of the force on the needle the part at its tip is shown: friction along the shaft hides ruptures,
and delayed friction is what makes a delayed loop swing.
"""

import math
from collections import deque
from typing import Generic, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.random import Generator
from numpy.typing import ArrayLike, NDArray

from needleforce.control.errors import SettingError
from needleforce.control.passivity import HandPort, NeedlePort
from needleforce.control.ports import MasterSample
from needleforce.session import SessionEstimate, Travel
from residual import Status

Array = NDArray[np.float64]
Shown = Literal["tip", "enhanced", "raw"]
Packet = TypeVar("Packet")

_CATCH_UP_PER_S = 10.0  # rate at which the needle makes up for travel that it could not follow
_FADE_S = 0.05  # a force that is not known, or belongs to no coupled hand, fades: no step is felt
_OWED_J = 10e-3  # by the hand to the needle, see `NeedlePort`
_SILENCE_S = 0.1  # without news from the device for so long, the needle stands


class HandPacket(NamedTuple):
    """From the device to the needle."""

    travel_m: float  # of the handle along the needle while coupled, scaled to the needle
    speed_m_s: float  # its rate, scaled
    energy_J: float  # that the hand has put in


class NeedlePacket(NamedTuple):
    """From the needle to the device."""

    force_N: float  # to be shown, scaled to the hand
    energy_J: float  # that the tissue has given back, scaled to the hand


class DelayLine(Generic[Packet]):
    """A line on which packets are late: ``delay ± jitter``, drawn evenly for each of them.

    The newest that has arrived counts; one that an older packet overtakes is dropped.

    Raises:
        SettingError: A delay or jitter below zero, or a jitter beyond the delay.
    """

    def __init__(self, delay_s: float, jitter_s: float, rng: Generator | None = None) -> None:
        if not (0.0 <= jitter_s < math.inf and 0.0 <= delay_s < math.inf):
            raise SettingError(f"delay {delay_s} s ± {jitter_s} s: expected finite numbers >= 0")
        if jitter_s > 0.0 and rng is None:
            raise SettingError("jitter is drawn at random: pass rng=numpy.random.default_rng(seed)")
        self._delay_s, self._jitter_s, self._rng = delay_s, jitter_s, rng
        self._under_way: deque[tuple[float, Packet]] = deque()
        self._time_s = 0.0
        self._newest: Packet | None = None

    def exchange(self, packet: Packet, dt_s: float) -> Packet | None:
        """Send a packet, let time pass, and return the newest that has arrived so far."""
        self._time_s += dt_s
        late_s = self._delay_s
        if self._rng is not None:
            late_s = max(0.0, late_s + self._rng.uniform(-self._jitter_s, self._jitter_s))
        line, arrival_s = self._under_way, self._time_s + late_s
        while line and line[-1][0] >= arrival_s:
            line.pop()  # overtaken by this one
        line.append((arrival_s, packet))
        while line and line[0][0] <= self._time_s:
            self._newest = line.popleft()[1]
        return self._newest


def shown_force(estimate: SessionEstimate, shown: Shown = "tip") -> float:
    """The force to be felt [N], positive against insertion.

    Never beyond the measured force nor against it: a friction estimate extrapolated to the speed
    of a jump would else pull the hand, with energy that no tissue has given.
    """
    axial_N = estimate.wrench.axial
    if shown == "raw":
        return axial_N
    found = estimate.identification
    wanted_N = found.tip_force_N if shown == "tip" else found.enhanced_force_N
    return min(max(wanted_N, min(axial_N, 0.0)), max(axial_N, 0.0))


class DeviceSide:
    """The end at the haptic device: scales its motion, shows a passive force.

    Args:
        axis: Direction of the handle that drives the needle inwards, shape (3,), unit length.
        motion_scale: Needle travel per travel of the handle.
        port: Observer and controller of the hand's energy.
    """

    def __init__(self, axis: Array, motion_scale: float, port: HandPort) -> None:
        self._axis, self._scale, self.port = axis, motion_scale, port
        self._travel_m, self._position_m = 0.0, None
        self._packet = HandPacket(0.0, 0.0, 0.0)
        self._wanted_N = 0.0

    def update(
        self, sample: MasterSample | None, news: NeedlePacket | None, dt_s: float
    ) -> tuple[float, HandPacket]:
        """The force to render, positive against insertion, and the packet to send.

        Args:
            sample: Newest of the device; None if there is none: its force then goes to zero.
            news: Newest packet of the needle.
            dt_s: Time since the last call.
        """
        is_coupled = sample is not None and sample.clutch
        wanted_N = news.force_N if news is not None and is_coupled else 0.0
        fade = 1.0 if is_coupled else dt_s / (_FADE_S + dt_s)
        self._wanted_N += fade * (wanted_N - self._wanted_N)
        if sample is None:
            self._position_m = None
            self._packet = self._packet._replace(speed_m_s=0.0)
            return 0.0, self._packet
        position_m = float(self._axis @ sample.position_m)
        speed_m_s = float(self._axis @ sample.velocity_m_s)
        if is_coupled and self._position_m is not None:
            self._travel_m += self._scale * (position_m - self._position_m)
        self._position_m = position_m
        incoming_J = 0.0 if news is None else news.energy_J
        force_N = self.port.update(self._wanted_N, position_m, speed_m_s, incoming_J, dt_s)
        rate_m_s = self._scale * speed_m_s if is_coupled else 0.0
        self._packet = HandPacket(self._travel_m, rate_m_s, self.port.energy.in_J)
        return force_N, self._packet


class NeedleSide:
    """The end at the robot: follows the hand within a speed limit, sends the force to be shown.

    Args:
        scale: Energy at the hand per energy at the needle: force scale / motion scale.
        force_scale: Force at the hand per force at the needle.
        speed_limit_m_s: Largest speed of the needle.
        port: Observer and controller of the energy given to the tissue.
    """

    def __init__(
        self, scale: float, force_scale: float, speed_limit_m_s: float, port: NeedlePort
    ) -> None:
        self._scale, self._force_scale = scale, force_scale
        self._limit_m_s, self.port = speed_limit_m_s, port
        self._start_m: float | None = None
        self._last: HandPacket | None = None
        self._silent_s = 0.0

    def update(
        self, news: HandPacket | None, force_N: float, tip: Travel, dt_s: float
    ) -> tuple[float, NeedlePacket]:
        """The speed to move with, positive inwards, and the packet to send.

        Args:
            news: Newest packet of the device.
            force_N: Force to be shown, not scaled.
            tip: Depth of the tip, from any zero, and its rate.
            dt_s: Time since the last call.
        """
        self._silent_s = self._silent_s + dt_s if news is self._last else 0.0
        self._last = news
        wanted_m_s, incoming_J = 0.0, 0.0
        if news is not None:
            if self._start_m is None:
                self._start_m = tip.depth_m - news.travel_m
            incoming_J = news.energy_J
            if self._silent_s < _SILENCE_S:
                behind_m = self._start_m + news.travel_m - tip.depth_m
                wanted_m_s = news.speed_m_s + _CATCH_UP_PER_S * behind_m
        wanted_m_s = min(max(wanted_m_s, -self._limit_m_s), self._limit_m_s)
        speed_m_s = self.port.update(
            wanted_m_s, force_N, tip.speed_m_s, incoming_J / self._scale, dt_s
        )
        energy_J = self._scale * self.port.energy.in_J
        return speed_m_s, NeedlePacket(self._force_scale * force_N, energy_J)


class TeleopCommand(NamedTuple):
    """What to do until the next tick."""

    speed_m_s: float  # of the needle along its axis, positive inwards
    force_N: Array  # to render at the device, shape (3,), in its axes


class Teleoperation:
    """Both sides and the line between them, for a loop that has the device and the arm.

    Args:
        axis: Direction of the handle, in the device's axes, that drives the needle inwards.
        motion_scale: Needle travel per travel of the handle, 0.1 to 1.
        force_scale: Force at the hand per force at the needle.
        shown: Force at the tip; ``enhanced``, without the friction of layers already traversed; or
            ``raw``, as measured.
        speed_limit_m_s: Largest speed of the needle.
        delay_s: Delay of the line, each way.
        jitter_s: Largest deviation from it.
        rng: Source of the jitter.
        force_lag_s: Lag of the force estimate, see `InsertionSession.lag_s`.

    Raises:
        SettingError: A scale out of range, a limit that is not positive, an unknown force, an axis
            without a direction, or a line that cannot be.
    """

    def __init__(
        self,
        *,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        motion_scale: float = 0.4,
        force_scale: float = 1.0,
        shown: Shown = "tip",
        speed_limit_m_s: float = 0.02,
        delay_s: float = 0.0,
        jitter_s: float = 0.0,
        rng: Generator | None = None,
        force_lag_s: float = 0.015,
    ) -> None:
        direction = np.asarray(axis, dtype=np.float64)
        length = float(np.linalg.norm(direction))
        if direction.shape != (3,) or not 0.0 < length < math.inf:
            raise SettingError(f"axis is {axis!r}, expected three numbers that are not all zero")
        if not 0.1 <= motion_scale <= 1.0:
            raise SettingError(f"motion_scale is {motion_scale!r}, expected 0.1 to 1")
        if not (0.0 < force_scale < math.inf and 0.0 < speed_limit_m_s < math.inf):
            raise SettingError(
                f"force_scale {force_scale!r} and speed_limit_m_s {speed_limit_m_s!r} must be "
                "positive and finite"
            )
        if shown not in ("tip", "enhanced", "raw"):
            raise SettingError(f"shown is {shown!r}, expected 'tip', 'enhanced' or 'raw'")
        self._shown: Shown = shown
        self._back = -direction / length
        scale = force_scale / motion_scale
        self.device = DeviceSide(-self._back, motion_scale, HandPort())
        port = NeedlePort(_OWED_J / scale, force_lag_s)
        self.needle = NeedleSide(scale, force_scale, speed_limit_m_s, port)
        self._there: DelayLine[HandPacket] = DelayLine(delay_s, jitter_s, rng)
        self._here: DelayLine[NeedlePacket] = DelayLine(delay_s, jitter_s, rng)
        self._from_hand: HandPacket | None = None
        self._from_needle: NeedlePacket | None = None
        self._force_N = 0.0

    def update(
        self, sample: MasterSample | None, estimate: SessionEstimate, dt_s: float
    ) -> TeleopCommand:
        """Take the device's newest sample and the newest force; never raises.

        Args:
            sample: Of the haptic device; None if it gave none.
            estimate: Of the session: force and depth.
            dt_s: Time since the last call.
        """
        if estimate.status is Status.OK:
            self._force_N = shown_force(estimate, self._shown)
        else:
            self._force_N *= _FADE_S / (_FADE_S + dt_s)
        force_N, to_needle = self.device.update(sample, self._from_needle, dt_s)
        self._from_hand = self._there.exchange(to_needle, dt_s)
        speed_m_s, to_hand = self.needle.update(
            self._from_hand,
            self._force_N,
            Travel(estimate.depth_m, estimate.speed_m_s),
            dt_s,
        )
        self._from_needle = self._here.exchange(to_hand, dt_s)
        return TeleopCommand(speed_m_s, force_N * self._back)
