"""Is this sample usable? Numbers, ranges, and whether depth and speed agree.

A sample that is not finite, out of range, or whose time does not advance is rejected:
it changes nothing but the clock, and the interval of the next one holds the time that
has passed.

Depth is compared with speed twice: a step of depth that the speed does not explain is a
jump, which is removed from the depth for good; travel by depth and travel by speed of
opposite signs mean a wrong sign of either. Where no speed is measured it is the one
that `travel_filter` estimates, which contradicts no depth.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from foundation.jit import compiled, compiled_inside
from identification.config import CheckConfig
from identification.estimate import SampleStatus

NO_NUMBERS = (str, bytes, bool, np.bool_, complex, np.complexfloating, np.timedelta64)
"""Types that Python or numpy would convert to a float although they are no
measurements."""
MIN_DT_S = 1e-12
"""A shorter time step is garbage: quotients would overflow."""
MAX_DT_S = 1e6
"""A longer time step is in a wrong unit: sums would overflow."""
MAX_MOTION = 1e3
"""No needle is as deep [m] or as fast [m/s]; powers of larger numbers overflow."""
MAX_SPEED_IN_GAP_M_S = 0.1
"""Assumed speed of a needle in a gap, where its motion is not seen."""
STEPS_OF_A_GAP = 10.0
"""A gap is also longer than so many usual time steps."""
USUAL_STEP_WEIGHT = 0.05
"""Weight of a new time step in the usual one."""

STATUSES = tuple(SampleStatus)
"""In the order of the numbers that compiled code gives them."""
OK = STATUSES.index(SampleStatus.OK)
TIME_GAP = STATUSES.index(SampleStatus.TIME_GAP)
NOT_FINITE = STATUSES.index(SampleStatus.NOT_FINITE)
TIME_NOT_FORWARD = STATUSES.index(SampleStatus.TIME_NOT_FORWARD)
DEPTH_JUMP = STATUSES.index(SampleStatus.DEPTH_JUMP)
SPEED_SIGN = STATUSES.index(SampleStatus.SPEED_SIGN)
FORCE_RANGE = STATUSES.index(SampleStatus.FORCE_RANGE)
TIME_RANGE = STATUSES.index(SampleStatus.TIME_RANGE)
MOTION_RANGE = STATUSES.index(SampleStatus.MOTION_RANGE)


class RawSample(NamedTuple):
    """A sample as `Identifier.update` takes it; every value is a float.

    Attributes:
        depth_m: Travel of the tip along the insertion axis.
        speed_m_s: Rate of depth; where none is measured the estimated one.
        force_N: Axial force.
        dt_s: Time since the previous sample, used or not.
        is_speed_measured: Whether the speed is a measurement.
    """

    depth_m: float
    speed_m_s: float
    force_N: float
    dt_s: float
    is_speed_measured: bool


class CheckResult(NamedTuple):
    """What became of a raw sample.

    Attributes:
        status: Index in `STATUSES`.
        elapsed_s: Time since the last sample that was used, 0 for a sample whose
            numbers are bad.
    """

    status: int
    elapsed_s: float


@dataclass(slots=True)
class CheckState:
    """What the check remembers of earlier samples.

    Attributes:
        time_s: Time since the reset, over used and rejected samples.
        usual_dt_s: Smoothed time step, 0 before the first.
        depth_m: Last finite depth, of a sample used or rejected.
        has_depth: Whether there is one.
        removed_m: Sum of all jumps removed from the depth.
        travel_by_depth_m: Recent travel, from the depths.
        travel_by_speed_m: Recent travel, from the speeds.
        since_depth_s: Time since that last depth.
        rejected_s: Time from the last sample that was used to that last depth.
    """

    time_s: float = 0.0
    usual_dt_s: float = 0.0
    depth_m: float = 0.0
    has_depth: bool = False
    removed_m: float = 0.0
    travel_by_depth_m: float = 0.0
    travel_by_speed_m: float = 0.0
    since_depth_s: float = 0.0
    rejected_s: float = 0.0


def as_scalar(value: Any) -> float | None:
    """Return a value as a float, or None if it is not a single real number."""
    if isinstance(value, float):
        return float(value)
    try:
        if isinstance(value, np.ndarray) and value.ndim == 0:
            value = value[()]
        if isinstance(value, NO_NUMBERS) or value is np.ma.masked:
            return None
        return None if np.ndim(value) > 0 else float(value)
    except OverflowError:
        return math.inf
    except Exception:  # foreign objects convert by code of their own, which may raise
        return None


@compiled
def is_used(status: int) -> bool:
    """Return whether samples of a status are used."""
    return status in (OK, TIME_GAP)


@compiled_inside
def check_numbers(sample: RawSample, force_limit_N: float) -> int:
    """Return the status of a raw sample whose motion is not checked yet."""
    dt_s = sample.dt_s
    if not math.isfinite(dt_s):
        return NOT_FINITE
    if dt_s <= 0.0:
        return TIME_NOT_FORWARD
    if dt_s < MIN_DT_S or dt_s > MAX_DT_S:
        return TIME_RANGE
    if not math.isfinite(sample.depth_m + sample.speed_m_s + sample.force_N):
        return NOT_FINITE
    if max(abs(sample.depth_m), abs(sample.speed_m_s)) > MAX_MOTION:
        return MOTION_RANGE
    return FORCE_RANGE if abs(sample.force_N) > force_limit_N else OK


@compiled_inside
def shortest_gap(state: CheckState, limits: CheckConfig) -> float:
    """Return the time from which on a step is a gap at present."""
    return max(limits.gap_s, STEPS_OF_A_GAP * state.usual_dt_s)


@compiled_inside
def advance_clock(state: CheckState, dt_s: float, limits: CheckConfig) -> None:
    """Let a time step pass, and learn from it what is usual unless it is a gap."""
    usual_dt_s = state.usual_dt_s if state.usual_dt_s != 0.0 else dt_s
    if dt_s <= shortest_gap(state, limits):
        state.usual_dt_s = usual_dt_s + USUAL_STEP_WEIGHT * (dt_s - usual_dt_s)
    state.time_s += dt_s


@compiled_inside
def is_depth_jump(
    unexplained_m: float, fastest_m_s: float, dt_s: float, is_gap: bool, jump_m: float
) -> bool:
    """Return whether a change of depth that the speed does not explain is a jump.

    A needle that stands still after a gap may have moved during it.
    """
    unseen_m_s = MAX_SPEED_IN_GAP_M_S if is_gap else 0.0
    return abs(unexplained_m) > jump_m + max(fastest_m_s, unseen_m_s) * dt_s


@compiled_inside
def has_wrong_sign(state: CheckState, sign_travel_m: float) -> bool:
    """Return whether the travels by depth and by speed contradict each other."""
    by_depth_m = state.travel_by_depth_m
    by_speed_m = state.travel_by_speed_m
    smaller_m = min(abs(by_depth_m), abs(by_speed_m))
    return by_depth_m * by_speed_m < 0.0 and smaller_m > sign_travel_m


@compiled_inside
def compare_depth_with_speed(
    sample: RawSample,
    state: CheckState,
    estimated_speed_m_s: float,
    limits: CheckConfig,
) -> CheckResult:
    """Check the motion of a sample whose numbers are good; remove a jump of depth."""
    dt_s = sample.dt_s + state.since_depth_s
    elapsed_s = dt_s + state.rejected_s
    gap_s = shortest_gap(state, limits)
    has_depth = state.has_depth
    change_m = sample.depth_m - state.depth_m if has_depth else 0.0
    unexplained_m = change_m - sample.speed_m_s * dt_s
    fastest_m_s = max(abs(sample.speed_m_s), abs(estimated_speed_m_s))
    is_jump = is_depth_jump(
        unexplained_m, fastest_m_s, dt_s, dt_s > gap_s, limits.jump_m
    )

    memory = math.exp(-dt_s / limits.sign_memory_s)
    state.travel_by_depth_m *= memory
    state.travel_by_speed_m *= memory
    if is_jump:
        state.removed_m += unexplained_m
    elif has_depth and dt_s <= gap_s and sample.is_speed_measured:
        # The speed now says nothing about travel during a gap, or before the first
        # depth.
        state.travel_by_depth_m += change_m
        state.travel_by_speed_m += sample.speed_m_s * dt_s

    status = OK
    if is_jump:
        status = DEPTH_JUMP
    elif has_wrong_sign(state, limits.sign_travel_m):
        status = SPEED_SIGN
    elif has_depth and elapsed_s > gap_s:
        status = TIME_GAP
    state.depth_m = sample.depth_m
    state.has_depth = True
    state.since_depth_s = 0.0
    state.rejected_s = 0.0 if is_used(status) else elapsed_s
    return CheckResult(status, elapsed_s)


@compiled_inside
def check_sample(
    sample: RawSample,
    state: CheckState,
    estimated_speed_m_s: float,
    limits: CheckConfig,
) -> CheckResult:
    """Check one raw sample.

    Time runs on over a rejected sample as long as its time step is valid: a dropped
    force does not shift the clock.
    """
    status = check_numbers(sample, limits.force_limit_N)
    if status == OK:
        result = compare_depth_with_speed(sample, state, estimated_speed_m_s, limits)
        advance_clock(state, sample.dt_s, limits)
        return result
    if MIN_DT_S <= sample.dt_s <= MAX_DT_S:
        state.time_s += sample.dt_s
        state.since_depth_s += sample.dt_s
    return CheckResult(status, 0.0)
