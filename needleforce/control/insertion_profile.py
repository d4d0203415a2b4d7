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
        cautious: Part of the speed that is kept while a rupture seems likely but is not certain,
            where the insertion ends with one.

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
    cautious: float = 1.0

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
        self._speed_m_s = self._from_m = 0.0
        self._last_s = 0.0

    def update(self, now: Situation, identification: Estimate | None = None) -> Step:
        """Speed and event that follow from what is known now.

        Args:
            now: From the manager.
            identification: Of another force sensor; by default that of the session.
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
            return self._insert(identification or now.estimate.identification, depth_m, dt_s)
        return Step(0.0)

    def _insert(self, found: Estimate, depth_m: float, dt_s: float) -> Step:
        plan = self._plan
        speed_m_s = plan.speed_m_s
        if plan.layer is not None:
            if found.rupture is not None and found.rupture.layer >= plan.layer:
                return Step(0.0, "rupture")
            if found.rupture_state is RuptureState.EXPECTED:
                speed_m_s *= plan.cautious
        return self._travel(plan.depth_m - depth_m, dt_s, speed_m_s)

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
