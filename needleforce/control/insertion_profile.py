"""An insertion by itself: approach, tare stroke, insertion, dwell, withdrawal.

A program is a plan, and a function of what the manager knows: it returns the speed along the needle
and the event that ends the present state. Ends that are planned are reached with gentle braking; a
stop asks for rest at once, and the controller brakes with all that the arm's limits allow.
"""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification import Estimate, RuptureState
from needleforce.control.errors import SettingError
from needleforce.control.manager import Situation, State

Array = NDArray[np.float64]

_TRACK_PER_S = 10.0
"""Gain with which a stroke keeps to its course."""
_NEAR_M = 2e-5
"""So near to its end a motion has arrived."""
_SMOOTH_S, _NOISE_S, _LEARN_S, _PEAK_S = 3e-3, 0.015, 1.0, 0.25
"""Time constants: of the force, of what its noise is measured against, of that measurement, and of
the memory of the last peak."""
_SIGMAS = 7.0
"""A fall of the force by so many standard deviations of its noise is one."""
_APART_M = 3e-3
"""Two ruptures less far apart are one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InsertionPlan:
    """What to do, in metres along the needle, inwards positive.

    Attributes:
        speed_m_s: Of insertion and withdrawal.
        depth_m: Where the insertion ends at the latest, from the place of the tare.
        layer: Layer after whose rupture it ends; None for the depth.
        approach_m: Way to the place of the tare, in free air.
        tare_stroke_m: Length of the stroke back and forth before the tare.
        stroke_s: Time of the approach, and of the stroke each way.
        dwell_s: Time at the end of the insertion.
        acceleration_m_s2: Of starts and of planned ends.

    Raises:
        SettingError: A number that cannot be.
    """

    speed_m_s: float
    depth_m: float
    layer: int | None = None
    approach_m: float = 0.0
    tare_stroke_m: float = 0.06
    stroke_s: float = 3.0
    dwell_s: float = 1.0
    acceleration_m_s2: float = 0.3

    def __post_init__(self) -> None:
        """Check every number."""
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "layer" and value is None:
                continue
            is_number = isinstance(value, int | float) and math.isfinite(value)
            if not (
                is_number and (value > 0.0 or (value == 0.0 and field.name[:2] in ("ap", "dw")))
            ):
                raise SettingError(f"{field.name} is {value!r}, expected a positive number")


def depth_of(
    target_m: ArrayLike, tip_m: ArrayLike, axis: Array, *, tolerance_m: float = 1e-3
) -> float:
    """Depth [m] at which a needle reaches a planned target.

    Args:
        target_m: The target, base frame, shape (3,).
        tip_m: Where the tip will be at the tare, shape (3,).
        axis: Direction of the needle, shape (3,).
        tolerance_m: By how much the needle may miss the target.

    Raises:
        SettingError: The target lies behind the tip, or off the needle's line.
    """
    way = np.subtract(target_m, tip_m)
    depth_m = float(axis @ way)
    miss_m = float(np.linalg.norm(way - depth_m * axis))
    if depth_m <= 0.0 or miss_m > tolerance_m:
        raise SettingError(
            f"the target lies {1e3 * depth_m:.1f} mm ahead and {1e3 * miss_m:.1f} mm beside the "
            f"needle's line, expected ahead and within {1e3 * tolerance_m:g} mm: align the needle"
        )
    return depth_m


class RuptureCount:
    """Ruptures as a program counts them that knows how the needle is commanded.

    The identification alone must wait whether a fall of the force is a needle that brakes. Here the
    speed is known to be steady: a rupture that is likely (more likely than not) counts as soon as
    the force has fallen by more than its noise, and an alarm without such a fall does not count:
    a tip that meets the next membrane leaves no layer yet.
    """

    def __init__(self) -> None:
        self.count = 0
        self._force_N = self._peak_N = self._before_N = self._last_m = -math.inf
        self._variance_N2 = 0.0

    def update(self, found: Estimate, force_N: float, depth_m: float, dt_s: float) -> bool:
        """Whether one more layer has been left, at a steady speed.

        Args:
            found: Of the identification.
            force_N: Axial force that it was given.
            depth_m: Of the tip.
            dt_s: Since the last call.
        """
        if not math.isfinite(self._force_N):
            self._force_N = self._peak_N = self._before_N = force_N
        self._force_N += -math.expm1(-dt_s / _SMOOTH_S) * (force_N - self._force_N)
        self._before_N += -math.expm1(-dt_s / _NOISE_S) * (self._force_N - self._before_N)
        off_N2 = (self._force_N - self._before_N) ** 2
        weight = dt_s / (_LEARN_S if off_N2 < 9.0 * self._variance_N2 else 10.0 * _LEARN_S)
        self._variance_N2 += min(weight, 1.0) * (off_N2 - self._variance_N2)
        self._peak_N -= dt_s / _PEAK_S * (self._peak_N - self._force_N)
        self._peak_N = max(self._peak_N, self._force_N)
        least_N = _SIGMAS * math.sqrt(self._variance_N2)
        has_fallen = self._peak_N - self._force_N > least_N
        alarm = found.rupture
        if alarm is not None:
            has_fallen |= alarm.force_N - self._force_N > least_N
        is_likely = alarm is not None or found.rupture_state is RuptureState.EXPECTED
        if not (is_likely and has_fallen) or depth_m < self._last_m + _APART_M:
            return False
        self.count, self._last_m = self.count + 1, depth_m
        return True


class Step(NamedTuple):
    """What to do in the coming cycle."""

    speed_m_s: float  # along the needle, inwards
    event: str = ""  # to request of the manager


class InsertionProfile:
    """Runs a plan once; call `update` after every `Manager.update`."""

    def __init__(self, plan: InsertionPlan) -> None:
        self._plan = plan
        self._program = (
            ["tare", "insert"] if plan.approach_m == 0.0 else ["approach", "tare", "insert"]
        )
        self._speed_m_s = self._from_m = self._last_s = 0.0
        self._ruptures = RuptureCount()

    def update(
        self, now: Situation, identification: Estimate | None = None, force_N: float | None = None
    ) -> Step:
        """Speed and event that follow from what is known now.

        Args:
            now: From the manager.
            identification: Of another force sensor; by default that of the session.
            force_N: Axial force of that sensor.
        """
        plan, state, depth_m = self._plan, now.state, now.estimate.depth_m
        dt_s, self._last_s = now.time_s - self._last_s, now.time_s
        if now.state_s == 0.0 or not now.is_moving:
            self._from_m, self._speed_m_s = depth_m, 0.0
        if state is State.IDLE and self._program:
            return Step(0.0, self._program.pop(0))
        if state is State.DWELL and now.state_s >= plan.dwell_s:
            return Step(0.0, "arrived")
        if state is State.APPROACH:
            return self._stroke(now, (plan.approach_m,))
        if state is State.TARE:
            return self._stroke(now, (-plan.tare_stroke_m, plan.tare_stroke_m))
        if state is State.WITHDRAW:
            return self._travel(-depth_m, dt_s, plan.speed_m_s)
        if state is State.INSERTION:
            found = identification or now.estimate.identification
            force_N = now.estimate.wrench.axial if force_N is None else force_N
            return self._insert(found, force_N, depth_m, dt_s)
        return Step(0.0)

    def _insert(self, found: Estimate, force_N: float, depth_m: float, dt_s: float) -> Step:
        plan, ruptures = self._plan, self._ruptures
        if ruptures.update(found, force_N, depth_m, dt_s) and ruptures.count == plan.layer:
            return Step(0.0, "rupture")
        return self._travel(plan.depth_m - depth_m, dt_s, plan.speed_m_s)

    def _travel(self, left_m: float, dt_s: float, most_m_s: float) -> Step:
        """Speed on a way that is left, to its end and no further."""
        if abs(left_m) < _NEAR_M:
            return Step(0.0, "arrived")
        gain = self._plan.acceleration_m_s2
        wish = min(most_m_s, math.sqrt(2.0 * gain * abs(left_m)), _TRACK_PER_S * abs(left_m))
        wish = math.copysign(wish, left_m)
        change = gain * dt_s
        self._speed_m_s = min(max(self._speed_m_s, -most_m_s), most_m_s)
        self._speed_m_s += min(max(wish - self._speed_m_s, -change), change)
        return Step(self._speed_m_s)

    def _stroke(self, now: Situation, legs_m: tuple[float, ...]) -> Step:
        """Speed on quintic strokes from rest to rest, one after another."""
        leg, since_s = divmod(now.state_s, self._plan.stroke_s)
        index = int(leg)
        if index >= len(legs_m):
            return Step(0.0, "arrived")
        s, length_m = since_s / self._plan.stroke_s, legs_m[index]
        course_m = (
            self._from_m + sum(legs_m[:index]) + length_m * s**3 * (10.0 + s * (6.0 * s - 15.0))
        )
        rate = 30.0 * (s * (1.0 - s)) ** 2 / self._plan.stroke_s
        return Step(length_m * rate + _TRACK_PER_S * (course_m - now.estimate.depth_m))
