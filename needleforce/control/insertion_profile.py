"""An insertion by itself: approach, tare stroke, insertion, dwell, withdrawal.

A program follows a plan: from what the manager knows it returns the speed along the
needle and the event that ends the present state. Planned ends are reached with gentle
braking; a stop asks for rest at once, and the controller brakes with all that the
limits of the arm allow.
"""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from numbers import Integral
from typing import NamedTuple

from identification.estimate import Estimate, RuptureState
from needleforce.control.errors import SettingError, require_positive
from needleforce.control.manager import Situation
from needleforce.control.state_machine import State
from needleforce.control.tare_stroke import find_stroke_speed

ARRIVED_m = 2e-5
"""Distance from its end at which a motion has arrived: far below the error of a
plan."""

SETTLED_s = 0.1
"""So long after its last change a command is steady: late forces fall until then."""


BLOCK_s = 0.2
"""Falls newer than this are not ordinary yet: they may be the rupture itself."""

RUPTURE_s = 0.3
"""So long after a counted rupture the force may still fall because of it."""

LARGE_FALL_N = 0.08
"""A smaller fall is not large, however small the force is: the force has such
errors."""

MIN_FALL_N = 0.03
"""Least fall of a likely rupture, and of an alarm: noise of the force stays below."""


class RuptureCounter:
    """Counts the layers that a needle has left.

    By itself the identification must wait whether a fall of the force is a needle that
    brakes. At a steady command it is none, but a beating heart, a jerky arm and slow
    noise make the force fall, too, again and again. So a fall counts if it is large, or
    likely a rupture, and several times the largest of the last seconds; with an alarm
    of the identification, a confirmed one, any larger one counts.

    Attributes:
        count: Ruptures so far.
    """

    def __init__(self) -> None:
        self.count = 0
        self._rupture_m = -math.inf  # depth of the last rupture
        self._force_N = 0.0
        self._peak_N = 0.0  # force before a fall
        self._in_tissue_s = 0.0
        self._fallen_s = 0.0  # time since a likely rupture
        self._ordinary_N = 0.0  # largest fall of the last seconds that was no rupture
        self._block_N = 0.0  # largest fall of the present block
        self._previous_N = 0.0  # largest fall of the block before it
        self._block_s = 0.0  # age of the block; below zero a rupture still falls

    def update(
        self,
        identification: Estimate,
        axial_N: float,
        depth_m: float,
        dt_s: float,
        *,
        is_steady: bool,
    ) -> bool:
        """Return whether one more layer has been left.

        Args:
            identification: Of the force sensor.
            axial_N: Its axial force; a sample that is not finite is skipped.
            depth_m: Of the tip.
            dt_s: Time since the last call.
            is_steady: Whether the commanded speed is.
        """
        if not math.isfinite(axial_N):
            return False
        in_contact = identification.in_contact
        step_s = dt_s if in_contact else -dt_s
        self._in_tissue_s = max(self._in_tissue_s + step_s, 0.0)
        self._filter_force(axial_N, dt_s, is_steady)
        fall_N = self._peak_N - self._force_N
        self._note_fall(fall_N if in_contact else min(fall_N, LARGE_FALL_N), dt_s)
        alarm = identification.rupture
        if alarm:
            fall_N = max(self._peak_N, alarm.force_N) - self._force_N
        is_likely = is_steady and self._is_likely(identification, fall_N)
        self._fallen_s = self._fallen_s + dt_s if is_likely else 0.0
        is_alarm = alarm is not None and fall_N > max(self._ordinary_N, MIN_FALL_N)
        # A fall that does not last for two samples of 1 kHz is a jerk of the arm.
        is_rupture = in_contact and (is_alarm or self._fallen_s > 1.5e-3)
        rupture_m = alarm.depth_m if alarm else depth_m
        # Two ruptures less than 3 mm apart are one.
        if not is_rupture or rupture_m < self._rupture_m + 3e-3:
            return False
        self.count += 1
        self._rupture_m = depth_m
        self._in_tissue_s = 0.0
        # Its own fall is left out.
        self._block_s = -RUPTURE_s
        self._block_N = 0.0
        self._previous_N = 0.0
        return True

    def _filter_force(self, axial_N: float, dt_s: float, is_steady: bool) -> None:
        """Smooth the force, and let the force before a fall follow it slowly.

        Time constants are 3 ms, which removes the noise of single samples, and 0.1 s:
        most ruptures are over sooner. A force that rises by more than 15 N/s is a jerk
        of the arm, no push of tissue.

        What falls after a counted rupture is that rupture, and what falls while the
        command changes is the motion: then nothing counts as a fall.
        """
        self._force_N -= math.expm1(-dt_s / 3e-3) * (axial_N - self._force_N)
        self._peak_N += dt_s / 0.1 * (self._force_N - self._peak_N)
        if self._block_s < 0.0 or not is_steady:
            self._peak_N = self._force_N
        self._peak_N += min(max(self._force_N - self._peak_N, 0.0), 15.0 * dt_s)

    def _note_fall(self, fall_N: float, dt_s: float) -> None:
        """Update the largest fall that was no rupture; newer ones than a block wait.

        It is forgotten over 5 s, a breath or two.
        """
        self._block_s += dt_s
        self._block_N = max(self._block_N, fall_N)
        self._ordinary_N *= math.exp(-dt_s / 5.0)
        if self._block_s > BLOCK_s:
            self._ordinary_N = max(self._ordinary_N, self._previous_N)
            self._previous_N = self._block_N
            self._block_N = 0.0
            self._block_s = 0.0

    def _is_likely(self, identification: Estimate, fall_N: float) -> bool:
        """Return whether a fall at a steady command is likely a rupture.

        After a second in tissue a heartbeat has been felt, and falls can be compared:
        then 3 % of the force is a large one, before 15 %. A rupture falls by twice the
        ordinary.
        """
        is_settled = self._in_tissue_s > 1.0
        is_expected = identification.rupture_state is RuptureState.EXPECTED
        large_N = (0.03 if is_settled else 0.15) * self._peak_N
        is_large = fall_N > max(large_N, LARGE_FALL_N)
        is_candidate = (is_settled and is_expected) or (
            is_large and self._in_tissue_s > RUPTURE_s + BLOCK_s
        )
        return is_candidate and fall_N > max(2.0 * self._ordinary_N, MIN_FALL_N)


@dataclass(frozen=True, slots=True, kw_only=True)
class InsertionPlan:
    """What to do, along the needle, inwards positive.

    Attributes:
        speed_m_s: Of insertion and withdrawal.
        depth_m: Where the insertion ends at the latest, from the place of the tare.
        layer: After whose rupture it ends; None for the depth.
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
    acceleration_m_s2: float = 0.1

    def __post_init__(self) -> None:
        if not isinstance(self.layer, Integral | None):
            raise SettingError(
                f"layer is {self.layer!r}, expected a whole number or None"
            )
        numbers = asdict(self) | {"layer": 1 if self.layer is None else self.layer}
        require_positive(numbers, or_zero=("approach_m", "dwell_s"))


class Step(NamedTuple):
    """What to do in the coming cycle.

    Attributes:
        speed_m_s: Along the needle, inwards.
        event: To request of the manager; empty for none.
    """

    speed_m_s: float
    event: str = ""


class InsertionProfile:
    """Runs a plan once; call `update` after every `Manager.update`.

    A request that is refused, or a release or stop before the insertion, ends the plan.
    The command is ahead of the tip of a soft arm, which would follow when the force
    falls. So after a rupture the command goes back to where the tip is; then the tip is
    held there.

    Args:
        plan: What to do.
    """

    def __init__(self, plan: InsertionPlan) -> None:
        self._ruptures = RuptureCounter()
        self._plan = plan
        # Events that remain to be requested at idle.
        self._program = ["approach", "tare", "insert"][0 if plan.approach_m else 1 :]
        self._time_s = 0.0
        self._usual_step_s = 0.0
        self._steady_s = 0.0  # time since the last change of the command
        self._start_m = 0.0  # depth at the begin of the motion
        self._commanded_m = 0.0
        self._end_m: float | None = None  # depth at which an insertion has ended
        self._is_at_tip = False  # whether the command is back at the tip
        # of the last call
        self._last = Step(0.0)
        self._state = ""

    def update(
        self,
        situation: Situation,
        identification: Estimate | None = None,
        axial_N: float | None = None,
    ) -> Step:
        """Return speed and event for the coming cycle.

        Args:
            situation: From the manager.
            identification: Of another force sensor; by default that of the session.
            axial_N: Axial force of that sensor.
        """
        estimate = situation.estimate
        dt_s = situation.time_s - self._time_s
        self._time_s = situation.time_s
        # A dwell goes on from an insertion.
        has_motion = situation.is_moving and situation.state != State.DWELL
        if has_motion and situation.state_s < dt_s + 1e-6:  # times are rounded
            self._start_m = estimate.depth_m
            self._commanded_m = estimate.depth_m
        self._update_program(situation.state)
        self._last = self._next_step(
            situation,
            dt_s,
            identification or estimate.identification,
            estimate.wrench.axial_unsmoothed if axial_N is None else axial_N,
        )
        self._commanded_m += dt_s * self._last.speed_m_s
        return self._last

    def _update_program(self, state: State) -> None:
        """Strike out what has begun; end a program that does not go on as planned."""
        last_state = self._state
        self._state = state
        has_begun = bool(self._program) and state.startswith(self._program[0])
        if has_begun:
            self._program = self._program[1:]
        is_refused = last_state == "idle" and self._last.event != "" and not has_begun
        is_left = state != last_state and last_state in ("approach", "tare")
        is_arrival = state == State.IDLE and self._last.event == "arrived"
        is_stopped = state in (State.STOPPED, State.FAULTED)
        if is_refused or is_stopped or (is_left and not is_arrival):
            self._program = []

    def _next_step(
        self,
        situation: Situation,
        dt_s: float,
        identification: Estimate,
        axial_N: float,
    ) -> Step:
        """Return what to do in the present state."""
        depth_m = situation.estimate.depth_m
        match situation.state:
            case State.IDLE if self._program:
                return Step(0.0, self._program[0])
            case State.APPROACH:
                return self._stroke(situation, [self._plan.approach_m])
            case State.TARE:
                return self._stroke(
                    situation, [-self._plan.tare_stroke_m, self._plan.tare_stroke_m]
                )
            case State.INSERTION:
                return self._insert(identification, axial_N, depth_m, dt_s)
            case State.DWELL if situation.state_s >= self._plan.dwell_s:
                return Step(0.0, "arrived")
            case State.DWELL:
                return Step(self._hold_tip(depth_m))
            case State.WITHDRAW:
                return self._move_by(-max(depth_m, 0.0), dt_s)
            case _:
                self._end_m = None
        return Step(0.0)

    def _insert(
        self, identification: Estimate, axial_N: float, depth_m: float, dt_s: float
    ) -> Step:
        """Insert to the planned depth, or until the planned layer ruptures."""
        self._end_m = depth_m
        # Time at the planned speed; after a gap the force settles anew.
        is_planned_speed = self._last.speed_m_s == self._plan.speed_m_s
        self._steady_s = (self._steady_s + dt_s) * is_planned_speed
        # An arm stops and starts in a step of so many usual ones, over some 50 samples;
        # one cycle of 1 kHz may be late. The force is off for 50 ms.
        if dt_s > max(2.5e-3, 2.5 * self._usual_step_s):
            self._steady_s = min(self._steady_s, SETTLED_s - 0.05)
        self._usual_step_s += 0.02 * (dt_s - self._usual_step_s)
        has_ruptured = self._ruptures.update(
            identification,
            axial_N,
            depth_m,
            dt_s,
            is_steady=self._steady_s > SETTLED_s,
        )
        if has_ruptured and self._ruptures.count == self._plan.layer:
            self._is_at_tip = False
            return Step(self._hold_tip(depth_m), "rupture")
        step = self._move_by(self._plan.depth_m - depth_m, dt_s)
        self._is_at_tip = bool(step.event)  # a planned end is reached at rest
        return step

    def _hold_tip(self, depth_m: float) -> float:
        """Return the speed after an insertion.

        The command first goes back to the tip, if it has not come to rest by itself;
        then it holds the tip where the insertion ended.
        """
        if self._end_m is None:
            return 0.0
        ahead_m = self._commanded_m - depth_m
        self._is_at_tip = self._is_at_tip or ahead_m < ARRIVED_m
        if not self._is_at_tip:
            # Decelerating by 0.3 m/s2: quicker, it would tug at the tissue.
            return -math.sqrt(2.0 * 0.3 * ahead_m)
        # With a time constant of 0.2 s; a soft arm follows in 0.1 s.
        holding_m_s = 5.0 * (self._end_m - depth_m)
        return min(max(holding_m_s, -self._plan.speed_m_s), self._plan.speed_m_s)

    def _move_by(self, distance_m: float, dt_s: float) -> Step:
        """Move by a distance that remains, to its end and no further."""
        remaining_m = abs(distance_m)
        acceleration_m_s2 = self._plan.acceleration_m_s2
        if remaining_m < ARRIVED_m:
            return Step(0.0, "arrived")
        wanted_m_s = min(
            self._plan.speed_m_s,
            math.sqrt(2.0 * acceleration_m_s2 * remaining_m),
            10.0 * remaining_m,  # per second
        )
        wanted_m_s = math.copysign(wanted_m_s, distance_m)
        change_m_s = acceleration_m_s2 * dt_s
        last_m_s = self._last.speed_m_s
        return Step(min(max(wanted_m_s, last_m_s - change_m_s), last_m_s + change_m_s))

    def _stroke(self, situation: Situation, legs_m: Sequence[float]) -> Step:
        """Move along strokes from rest to rest, one after another."""
        leg_s = self._plan.stroke_s
        time_s = situation.state_s
        if time_s >= leg_s * len(legs_m):
            return Step(0.0, "arrived")
        depth_m = situation.estimate.depth_m
        return Step(find_stroke_speed(legs_m, leg_s, time_s, self._start_m, depth_m))
