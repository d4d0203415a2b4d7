"""Motion of the needle in a scenario.

The protocol is rest, tare stroke, insertion, rest, withdrawal, rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from groundtruth.errors import MotionError, require_positive

Profile = Literal["rest", "quintic", "cruise", "cosine"]
"""`quintic`: minimum jerk; `cruise`: constant speed between smooth ramps; `cosine`:
half a period of a sinusoid."""


class Move(NamedTuple):
    """A stroke without its place in time and space.

    Attributes:
        profile: Course of the speed.
        duration_s: Length in time.
        travel_m: Travel, signed.
    """

    profile: Profile
    duration_s: float
    travel_m: float


TARE_STROKE_M = 100e-3
"""Length of the tare stroke in free air: about as long as the deepest insertion, since
what is learnt on it is carried on along the insertion."""
TARE_SPEED_M_S = 25e-3  # Mean, of the tare stroke: excites the arm and is safe in air
# Time in which a constant-speed stroke reaches its speed: under 1 mm of travel.
RAMP_S = 0.5
TREMOR_FADE_S = 1.0


@dataclass(frozen=True, slots=True)
class Stroke:
    """A stroke from rest to rest.

    Position and speed are continuous, acceleration is bounded.

    Attributes:
        profile: Course of the speed.
        start_s: Time of the start.
        duration_s: Length in time.
        start_m: Position at the start.
        travel_m: Travel, signed.
        ramp_fraction: Fraction of the duration that each ramp of a `cruise` takes, up
            to 0.5.
    """

    profile: Profile
    start_s: float
    duration_s: float
    start_m: float
    travel_m: float
    ramp_fraction: float = 0.1

    @property
    def end_s(self) -> float:
        """Time of its end."""
        return self.start_s + self.duration_s

    @property
    def end_m(self) -> float:
        """Position of its end."""
        return self.start_m + self.travel_m

    def evaluate(self, t_s: Array) -> tuple[Array, Array]:
        """Return position [m] and speed [m/s] at any times.

        Outside the stroke they are those of its ends, at rest.
        """
        time = np.clip((t_s - self.start_s) / self.duration_s, 0.0, 1.0)
        travelled, rate = _COURSES[self.profile](time, self.ramp_fraction)
        position_m = self.start_m + self.travel_m * travelled
        return position_m, self.travel_m / self.duration_s * rate


def _rest_course(time: Array, _: float) -> tuple[Array, Array]:
    """Return no travel at no rate."""
    return np.zeros_like(time), np.zeros_like(time)


def _quintic_course(time: Array, _: float) -> tuple[Array, Array]:
    """Return the travelled fraction and its rate over time from 0 to 1: minimum jerk.

    x = 10 t³ - 15 t⁴ + 6 t⁵
    """
    travelled = time**3 * (10.0 + time * (6.0 * time - 15.0))
    rate = 30.0 * (time * (1.0 - time)) ** 2
    return travelled, rate


def _cosine_course(time: Array, _: float) -> tuple[Array, Array]:
    """Return the travelled fraction and its rate: half a period of a sinusoid.

    x = (1 - cos πt) / 2
    """
    travelled = 0.5 - 0.5 * np.cos(np.pi * time)
    rate = 0.5 * np.pi * np.sin(np.pi * time)
    return travelled, rate


def _cruise_course(time: Array, ramp: float) -> tuple[Array, Array]:
    """Return the travelled fraction and its rate: constant speed between ramps.

    Speed rises as 3q² - 2q³, q the fraction of the ramp, holds, and falls alike.

    Args:
        time: From 0 to 1.
        ramp: Fraction of the time that each ramp takes.
    """
    mirrored = np.minimum(time, 1.0 - time)
    q = np.minimum(mirrored / ramp, 1.0)
    full_rate = 1.0 / (1.0 - ramp)
    on_ramp = ramp * q**3 * (1.0 - 0.5 * q)
    half = full_rate * (on_ramp + np.maximum(mirrored - ramp, 0.0))
    travelled = np.where(time <= 0.5, half, 1.0 - half)
    rate = full_rate * q * q * (3.0 - 2.0 * q)
    return travelled, rate


_COURSES = {
    "rest": _rest_course,
    "quintic": _quintic_course,
    "cosine": _cosine_course,
    "cruise": _cruise_course,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Tremor:
    """The trembling of a hand that holds the needle: a sine along its axis.

    It fades in within a second from the end of the tare stroke, and out within the
    second before the withdrawal.

    Attributes:
        amplitude_m: Its amplitude.
        frequency_hz: Its frequency.
    """

    amplitude_m: float
    frequency_hz: float

    def evaluate(self, t_s: Array, start_s: float, end_s: float) -> tuple[Array, Array]:
        """Return the position [m] and speed [m/s] that it adds at any times.

        Args:
            t_s: Times.
            start_s: When it begins to fade in.
            end_s: When it has faded out.
        """
        rate_rad_s = 2.0 * np.pi * self.frequency_hz
        inside_s = np.minimum(t_s - start_s, end_s - t_s)
        grown = np.clip(inside_s / TREMOR_FADE_S, 0.0, 1.0)
        is_fading = (grown > 0.0) & (grown < 1.0)
        is_growing = t_s - start_s < end_s - t_s
        growth_per_s = is_fading * np.where(is_growing, 1.0, -1.0) / TREMOR_FADE_S
        wave = np.sin(rate_rad_s * t_s)
        wave_per_s = rate_rad_s * np.cos(rate_rad_s * t_s)
        speed_m_s = self.amplitude_m * (grown * wave_per_s + growth_per_s * wave)
        return self.amplitude_m * grown * wave, speed_m_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Position of the needle tip along the insertion axis over time.

    Zero is the undeformed surface of the tissue; negative is above it, in free air.
    Before the first stroke and after the last the needle rests. A tremor is added to
    the strokes; what is said of them is said without it.

    Attributes:
        strokes: Contiguous in time and position.
        tare_end_s: End of the stroke in free air; contact has not happened before it.
        insertion_end_s: Time at which the needle is at its deepest and rests.
        withdrawal_start_s: Time at which the withdrawal begins.
        withdrawal_end_s: Time at which the needle is back above the surface.
        tremor: Of the hand that holds the needle; None for a steady one.
    """

    strokes: tuple[Stroke, ...]
    tare_end_s: float
    insertion_end_s: float
    withdrawal_start_s: float
    withdrawal_end_s: float
    tremor: Tremor | None = None

    @property
    def duration_s(self) -> float:
        """End of the last rest."""
        return self.strokes[-1].end_s

    @property
    def start_m(self) -> float:
        """Position at which the tip begins."""
        return self.strokes[0].start_m

    @property
    def deepest_m(self) -> float:
        """Largest depth that is reached, without the tremor."""
        return max(stroke.end_m for stroke in self.strokes)

    def position_m(self, t_s: ArrayLike) -> Array:
        """Return the position of the tip at one time or at an array of times."""
        return self._evaluate(t_s)[0]

    def speed_m_s(self, t_s: ArrayLike) -> Array:
        """Return the speed of the tip at one time or at an array of times.

        It is positive inwards.
        """
        return self._evaluate(t_s)[1]

    def _evaluate(self, t_s: ArrayLike) -> tuple[Array, Array]:
        """Return the motion at one time or at an array of times."""
        t = np.asarray(t_s, dtype=np.float64)
        index = np.searchsorted(
            [stroke.start_s for stroke in self.strokes[1:]], t, side="right"
        )
        position_m = np.empty_like(t)
        speed_m_s = np.empty_like(t)
        for i in np.unique(index):
            inside = index == i
            position_m[inside], speed_m_s[inside] = self.strokes[i].evaluate(t[inside])
        if self.tremor is not None:
            swing_m, swing_m_s = self.tremor.evaluate(
                t, self.tare_end_s, self.withdrawal_start_s
            )
            position_m = position_m + swing_m
            speed_m_s = speed_m_s + swing_m_s
        return position_m[()], speed_m_s[()]  # a number for a number


def chain_strokes(
    start_m: float, moves: Sequence[Move], *, ramp_fraction: float = 0.1
) -> tuple[Stroke, ...]:
    """Return strokes one after the other, the first at time zero."""
    strokes: list[Stroke] = []
    time_s = 0.0
    position_m = start_m
    for profile, duration_s, travel_m in moves:
        stroke = Stroke(
            profile, time_s, duration_s, position_m, travel_m, ramp_fraction
        )
        strokes.append(stroke)
        time_s = stroke.end_s
        position_m = stroke.end_m
    return tuple(strokes)


def protocol(
    standoff_m: float,
    insertion: Sequence[Move],
    *,
    ramp_fraction: float = 0.5,
    tare_stroke_m: float = TARE_STROKE_M,
) -> Motion:
    """Return the whole protocol around the strokes of an insertion.

    The last of the strokes is also the profile of the withdrawal, over all they travel.
    Without a tare stroke the needle rests as long as three of the usual ones would
    take.

    Args:
        standoff_m: Height of the tip above the surface before the insertion.
        insertion: Strokes of the insertion.
        ramp_fraction: See `Stroke`.
        tare_stroke_m: Length of the tare stroke; 0 for none.
    """
    tare_s = (tare_stroke_m or TARE_STROKE_M) / TARE_SPEED_M_S
    tare = [Move("quintic", tare_s, sign * tare_stroke_m) for sign in (1.0, -1.0, 1.0)]
    travel_m = sum(move.travel_m for move in insertion)
    final = insertion[-1]
    withdrawal_s = final.duration_s * travel_m / final.travel_m
    moves = [
        Move("rest", 1.0, 0.0),
        *tare,
        *insertion,
        Move("rest", 2.0, 0.0),
        Move(final.profile, withdrawal_s, -travel_m),
        Move("rest", 0.5, 0.0),
    ]
    strokes = chain_strokes(
        -standoff_m - tare_stroke_m, moves, ramp_fraction=ramp_fraction
    )
    return Motion(
        strokes=strokes,
        tare_end_s=strokes[3].end_s,
        insertion_end_s=strokes[-4].end_s,
        withdrawal_start_s=strokes[-3].end_s,
        withdrawal_end_s=strokes[-2].end_s,
    )


def constant_motion(*, speed_m_s: float, depth_m: float, standoff_m: float) -> Motion:
    """Return the protocol with an insertion at constant speed.

    It has smooth ramps, begins at the standoff above the surface, and the withdrawal
    ends there. `MotionError` if a value is not positive, or the travel is too short to
    reach the speed.
    """
    require_positive(
        MotionError, speed_m_s=speed_m_s, depth_m=depth_m, standoff_m=standoff_m
    )
    travel = depth_m + standoff_m
    duration = travel / speed_m_s + RAMP_S
    if duration < 2.0 * RAMP_S:
        raise MotionError(
            f"{travel} m are too short to reach {speed_m_s} m/s: go deeper or slower"
        )
    return protocol(
        standoff_m, [Move("cruise", duration, travel)], ramp_fraction=RAMP_S / duration
    )


def sinusoidal_motion(
    *, stroke_m: float, frequency_hz: float, standoff_m: float
) -> Motion:
    """Return the protocol with an insertion z = A/2 (1 - cos 2πft), A the stroke.

    In and out take one period, the rest between them aside. Contact happens inside the
    stroke, at the standoff below its start. `MotionError` if a value is not positive,
    or the stroke does not reach the surface.
    """
    require_positive(
        MotionError, stroke_m=stroke_m, frequency_hz=frequency_hz, standoff_m=standoff_m
    )
    if stroke_m <= standoff_m:
        raise MotionError(
            f"a stroke of {stroke_m} m ends above the surface, {standoff_m} m away"
        )
    return protocol(standoff_m, [Move("cosine", 0.5 / frequency_hz, stroke_m)])
