"""An insertion by itself: approach, tare stroke, insertion, dwell, withdrawal.

A program follows a plan: from what the manager knows it returns the speed along the
needle and the event that ends the present state. Planned ends are reached with gentle
braking; a stop asks for rest at once, and the controller brakes with all that the
limits of the arm allow.
"""

import math
from dataclasses import asdict, dataclass
from numbers import Integral
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from identification.estimate import Estimate, RuptureState
from needleforce.control.errors import SettingError, require_positive
from needleforce.control.manager import Situation
from needleforce.control.ports import Array

_TRACK_PER_S = 10.0  # Gain with which a stroke keeps to its course
_BACK_m_s2 = 0.3  # With which a command taken back comes to rest; a quicker one tugs at the tissue
_HOLD_PER_S = 5.0  # Gain with which a stopped tip is held; a soft arm follows in 0.1 s
_NEAR_M = 2e-5  # So near to its end a motion has arrived
# Time constants: of the force, and of the memory of its last peak
_SMOOTH_S = 3e-3
_PEAK_S = 0.1
_BLOCK_S = 0.2
_RUPTURE_S = 0.3
_PAST_S = 5.0
_FIRST_S = 1.0
"""Ordinary is the largest fall of the last seconds, without those newer than a block
and of counted ruptures. A heartbeat is, once the needle has been in tissue for a
second."""
_LARGE = 0.03
_FIRST_LARGE = 0.15
_LARGE_N = 0.08
_BEYOND = 2.0
_LEAST_N = 0.03
_LASTS_S = 1.5e-3
"""A fall by so much of the force, more in that second, in newtons, and so many times
the ordinary one is a rupture, if it lasts longer than a jerk of the arm; and the least
fall of an alarm."""
_MOST_RISE_N_per_s = (
    15.0  # A force that rises more quickly is a jerk of the arm, no push of tissue
)
_GAP_S = 2.5e-3
_GAP_STEPS = 2.5
_FADE_S = 0.05
"""A step so long, and so many usual ones, is a gap: an arm stops and starts, the
force is off."""
_APART_M = 3e-3  # Two ruptures less far apart are one
_SETTLED_S = 0.1  # So long after its last change a command is steady: late forces fall until then


@dataclass(frozen=True, slots=True, kw_only=True)
class InsertionPlan:
    """What to do, along the needle, inwards positive; `SettingError` for numbers
    that cannot be.

    Attributes:
        speed_m_s: Of insertion and withdrawal.
        depth_m: Where the insertion ends at the latest, from the place of the tare.
        layer: After whose rupture it ends; None for the depth.
        approach_m: Way to the place of the tare, in free air.
        tare_stroke_m: Length of the stroke back and forth before the tare.
        stroke_s: Time of the approach, and of the stroke each way.
        dwell_s: Time at the end of the insertion.
        acceleration_m_s2: Of starts and of planned ends.
    """

    speed_m_s: float
    depth_m: float
    layer: int | None = None
    approach_m: float = 0.0
    tare_stroke_m: float = 0.06
    stroke_s: float = 3.0
    dwell_s: float = 1.0
    acceleration_m_s2: float = 0.1

    def __post_init__(self) -> None:
        if not isinstance(self.layer, Integral | None):
            raise SettingError(
                f"layer is {self.layer!r}, expected a whole number or None"
            )
        numbers = asdict(self) | {"layer": 1 if self.layer is None else self.layer}
        require_positive(numbers, or_zero=("approach_m", "dwell_s"))


def depth_of(
    target_m: ArrayLike, tip_m: ArrayLike, axis: Array, *, tolerance_m: float = 1e-3
) -> float:
    """Depth [m] of a planned target, base frame, shape (3,), from the place of the tip
    at the tare.

    `SettingError` where it lies behind the tip, or off the needle's line by more than a
    tolerance.
    """
    if not np.linalg.norm(axis) > 0.0:
        raise SettingError(f"axis is {axis!r}, expected a direction of three numbers")
    way = np.subtract(target_m, tip_m)
    axis = axis / np.linalg.norm(axis)
    depth_m = float(axis @ way)
    miss_m = float(np.linalg.norm(way - depth_m * axis))
    if not (depth_m > 0.0 and miss_m <= tolerance_m):
        raise SettingError(
            f"the target lies {1e3 * depth_m:.1f} mm ahead and {1e3 * miss_m:.1f} mm beside the "
            f"needle's line, expected ahead and within {1e3 * tolerance_m:g} mm: align the needle"
        )
    return depth_m


class RuptureCount:
    """Ruptures, counted by a program that knows how the needle is commanded.

    By itself the identification must wait whether a fall of the force is a needle that
    brakes. At a steady command it is none, but a beating heart, a jerky arm and slow
    noise make the force fall, too, again and again. So one counts that is large, or
    likely a rupture, and several times the largest of the last seconds; with an alarm
    any larger one: a tip at a membrane has left nothing.
    """

    def __init__(self) -> None:
        self.count = 0
        self._last_m = -math.inf
        self._force_N = self._peak_N = self._inside_s = self._block_s = (
            self._fallen_s
        ) = 0.0
        self._newest_N = self._newer_N = self._ordinary_N = (
            0.0  # largest falls, by their age
        )

    def update(
        self,
        found: Estimate,
        axial_N: float,
        depth_m: float,
        dt_s: float,
        *,
        is_steady: bool,
    ) -> bool:
        """Whether one more layer has been left; steady is the speed that is
        commanded.
        """
        if not math.isfinite(axial_N):
            return False
        self._inside_s = max(
            self._inside_s + (dt_s if found.in_contact else -dt_s), 0.0
        )
        self._force_N -= math.expm1(-dt_s / _SMOOTH_S) * (axial_N - self._force_N)
        self._peak_N += dt_s / _PEAK_S * (self._force_N - self._peak_N)
        if (
            self._block_s < 0.0 or not is_steady
        ):  # what falls then is that rupture, or the start
            self._peak_N = self._force_N
        rise_N = min(max(self._force_N - self._peak_N, 0.0), _MOST_RISE_N_per_s * dt_s)
        self._peak_N = self._peak_N + rise_N
        alarm = found.rupture
        self._block_s += dt_s
        seen_N = self._peak_N - self._force_N
        self._newest_N = max(
            self._newest_N, seen_N if found.in_contact else min(seen_N, _LARGE_N)
        )
        self._ordinary_N *= math.exp(-dt_s / _PAST_S)
        if self._block_s > _BLOCK_S:
            self._ordinary_N = max(self._ordinary_N, self._newer_N)
            self._block_s, self._newest_N, self._newer_N = 0.0, 0.0, self._newest_N
        fall_N = (
            max(self._peak_N, alarm.force_N if alarm else -math.inf) - self._force_N
        )
        is_known = self._inside_s > _FIRST_S
        is_large = fall_N > max(
            (_LARGE if is_known else _FIRST_LARGE) * self._peak_N, _LARGE_N
        )
        is_likely = is_known and found.rupture_state is RuptureState.EXPECTED
        is_likely |= is_large and self._inside_s > _RUPTURE_S + _BLOCK_S
        is_likely &= is_steady and fall_N > max(_BEYOND * self._ordinary_N, _LEAST_N)
        self._fallen_s = self._fallen_s + dt_s if is_likely else 0.0
        is_alarm = alarm is not None and fall_N > max(self._ordinary_N, _LEAST_N)
        is_rupture = found.in_contact and (is_alarm or self._fallen_s > _LASTS_S)
        if (
            not is_rupture
            or (alarm.depth_m if alarm else depth_m) < self._last_m + _APART_M
        ):
            return False
        self.count = self.count + 1
        self._last_m = depth_m
        self._block_s = -_RUPTURE_S
        self._newest_N = 0.0
        self._newer_N = 0.0
        self._inside_s = 0.0
        return True


class Step(NamedTuple):
    """What to do in the coming cycle.

    Attributes:
        speed_m_s: Along the needle, inwards.
        event: To request of the manager.
    """

    speed_m_s: float
    event: str = ""


class InsertionProfile:
    """Runs a plan once; call `update` after every `Manager.update`.

    What is refused, released or stopped before the insertion ends the plan. What is
    commanded lies ahead of the tip of a soft arm, which would follow when the force
    falls. So a rupture takes the command back to where the tip is; then the tip is held
    there.
    """

    def __init__(self, plan: InsertionPlan) -> None:
        self._ruptures = RuptureCount()
        self._plan = plan
        self._program = ["approach", "tare", "insert"][0 if plan.approach_m else 1 :]
        self._from_m = self._last_s = self._asked_m = self._steady_s = self._step_s = (
            0.0
        )
        self._held_m: float | None = None  # where an insertion has ended
        # of the last call
        self._last = Step(0.0)
        self._state = ""
        self._is_slack = False

    def update(
        self,
        now: Situation,
        identification: Estimate | None = None,
        axial_N: float | None = None,
    ) -> Step:
        """Speed and event that follow from what is known now.

        Args:
            now: From the manager.
            identification: Of another force sensor; by default that of the session.
            axial_N: Axial force of that sensor.
        """
        dt_s = now.time_s - self._last_s
        self._last_s = now.time_s
        found = identification or now.estimate.identification
        force_N = now.estimate.wrench.axial_unsmoothed if axial_N is None else axial_N
        is_going = (
            now.is_moving and now.state.value != "dwell"
        )  # which goes on from an insertion
        if is_going and now.state_s < dt_s + 1e-6:  # entered since the last call
            self._from_m = self._asked_m = now.estimate.depth_m
        before = self._state
        state = now.state.value
        # Strike out what has begun; a program that does not go on as planned ends.
        has_begun = bool(self._program) and state.startswith(self._program[0])
        is_arrival = state == "idle" and self._last.event == "arrived"
        is_refused = before == "idle" and self._last.event != "" and not has_begun
        is_left = state != before and before in ("approach", "tare") and not is_arrival
        if is_refused or is_left or state in ("stopped", "faulted"):
            self._program = []
        elif has_begun:
            self._program = self._program[1:]
        self._last = self._step(now, dt_s, found, force_N)
        self._state = state
        self._asked_m += dt_s * self._last.speed_m_s
        return self._last

    def _step(
        self, now: Situation, dt_s: float, found: Estimate, axial_N: float
    ) -> Step:
        plan = self._plan
        depth_m = now.estimate.depth_m
        match now.state.value:
            case "idle" if self._program:
                return Step(0.0, self._program[0])
            case "approach":
                return self._stroke(now, (plan.approach_m,))
            case "tare":
                return self._stroke(now, (-plan.tare_stroke_m, plan.tare_stroke_m))
            case "insertion":
                return self._insert(found, axial_N, depth_m, dt_s)
            case "dwell":
                is_over = now.state_s >= plan.dwell_s
                return Step(0.0, "arrived") if is_over else Step(self._hold(depth_m))
            case "withdraw":
                return self._travel(-max(depth_m, 0.0), dt_s)
            case _:
                self._held_m = None
        return Step(0.0)

    def _insert(
        self, found: Estimate, axial_N: float, depth_m: float, dt_s: float
    ) -> Step:
        self._held_m = depth_m
        self._is_slack = False
        self._steady_s = (self._steady_s + dt_s) * (
            self._last.speed_m_s == self._plan.speed_m_s
        )
        if dt_s > max(_GAP_S, _GAP_STEPS * self._step_s):
            self._steady_s = min(self._steady_s, _SETTLED_S - _FADE_S)
        self._step_s += 0.02 * (dt_s - self._step_s)
        is_steady = self._steady_s > _SETTLED_S
        is_left = self._ruptures.update(
            found, axial_N, depth_m, dt_s, is_steady=is_steady
        )
        if is_left and self._ruptures.count == self._plan.layer:
            return Step(self._hold(depth_m), "rupture")
        step = self._travel(self._plan.depth_m - depth_m, dt_s)
        self._is_slack = bool(step.event)  # a planned end is reached at rest
        return step

    def _hold(self, depth_m: float) -> float:
        """Speed after an insertion: first back, if it has not come to rest by
        itself.
        """
        if self._held_m is None:
            return 0.0
        ahead_m = self._asked_m - depth_m
        self._is_slack = self._is_slack or ahead_m < _NEAR_M
        if self._is_slack:
            most = self._plan.speed_m_s
            return min(max(_HOLD_PER_S * (self._held_m - depth_m), -most), most)
        return -math.sqrt(2.0 * _BACK_m_s2 * ahead_m)

    def _travel(self, left_m: float, dt_s: float) -> Step:
        """Speed on a way that is left, to its end and no further."""
        if abs(left_m) < _NEAR_M:
            return Step(0.0, "arrived")
        most = self._plan.acceleration_m_s2
        way_m = abs(left_m)
        wish = min(
            self._plan.speed_m_s, math.sqrt(2.0 * most * way_m), _TRACK_PER_S * way_m
        )
        wish = math.copysign(wish, left_m)
        low = self._last.speed_m_s - most * dt_s
        high = self._last.speed_m_s + most * dt_s
        return Step(min(max(wish, low), high))

    def _stroke(self, now: Situation, legs_m: tuple[float, ...]) -> Step:
        """Speed on quintic strokes from rest to rest, one after another."""
        seconds = self._plan.stroke_s
        index = int(now.state_s / seconds)
        if index >= len(legs_m):
            return Step(0.0, "arrived")
        s = now.state_s / seconds - index
        length_m = legs_m[index]
        way_m = sum(legs_m[:index]) + length_m * s**3 * (10.0 + s * (6.0 * s - 15.0))
        rate_m_s = length_m * 30.0 * (s * (1.0 - s)) ** 2 / seconds
        off_m = self._from_m + way_m - now.estimate.depth_m
        most = 3.75 * abs(length_m) / seconds  # twice the fastest of the course
        return Step(min(max(rate_m_s + _TRACK_PER_S * off_m, -most), most))
