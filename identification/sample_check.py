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
from typing import Any

import numpy as np

from foundation.jit import compiled_inside
from identification.config import CheckConfig
from identification.estimate import SampleStatus

MIN_DT_S = 1e-12
"""A shorter time step is garbage: quotients would overflow."""
MAX_DT_S = 1e6
"""A longer time step is in a wrong unit: sums would overflow."""

STATUSES = tuple(SampleStatus)
"""In the order of the numbers that compiled code gives them."""
(
    OK,
    TIME_GAP,
    NOT_A_SCALAR,
    NOT_FINITE,
    TIME_NOT_FORWARD,
    DEPTH_JUMP,
    SPEED_SIGN,
    FORCE_RANGE,
    TIME_RANGE,
    MOTION_RANGE,
    NEEDLE_PULLED,
) = range(len(STATUSES))


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
        # These would be converted to a float although they are no measurements.
        no_numbers = str | bytes | bool | np.bool_ | complex | np.complexfloating
        if isinstance(value, no_numbers | np.timedelta64) or value is np.ma.masked:
            return None
        return None if np.ndim(value) > 0 else float(value)
    except OverflowError:
        return math.inf
    except Exception:  # foreign objects convert by code of their own, which may raise
        return None


@compiled_inside
def check_numbers(
    depth_m: float, speed_m_s: float, force_N: float, dt_s: float, limit_N: float
) -> int:
    """Return the status of a raw sample whose motion is not checked yet."""
    if not math.isfinite(dt_s):
        return NOT_FINITE
    if dt_s <= 0.0:
        return TIME_NOT_FORWARD
    if dt_s < MIN_DT_S or dt_s > MAX_DT_S:
        return TIME_RANGE
    if not math.isfinite(depth_m + speed_m_s + force_N):
        return NOT_FINITE
    # No needle is as deep [m] or as fast [m/s]; powers of larger numbers overflow.
    if max(abs(depth_m), abs(speed_m_s)) > 1e3:
        return MOTION_RANGE
    return FORCE_RANGE if abs(force_N) > limit_N else OK


@compiled_inside
def shortest_gap(state: CheckState, limits: CheckConfig) -> float:
    """Return the time from which on a step is a gap: ten usual ones, at least."""
    return max(limits.gap_s, 10.0 * state.usual_dt_s)


@compiled_inside
def compare_depth_with_speed(
    depth_m: float,
    speed_m_s: float,
    dt_s: float,
    is_speed_measured: bool,
    state: CheckState,
    estimated_speed_m_s: float,
    limits: CheckConfig,
) -> tuple[int, float]:
    """Check the motion of a sample whose numbers are good; remove a jump of depth.

    A needle that stands still after a gap may have moved during it. The arguments and
    what is returned are as in `check_sample`.
    """
    dt_s = dt_s + state.since_depth_s
    elapsed_s = dt_s + state.rejected_s
    gap_s = shortest_gap(state, limits)
    has_depth = state.has_depth
    change_m = depth_m - state.depth_m if has_depth else 0.0
    unexplained_m = change_m - speed_m_s * dt_s
    fastest_m_s = max(abs(speed_m_s), abs(estimated_speed_m_s))
    if dt_s > gap_s:
        fastest_m_s = max(fastest_m_s, 0.1)  # the needle is not seen
    is_jump = abs(unexplained_m) > limits.jump_m + fastest_m_s * dt_s

    memory = math.exp(-dt_s / limits.sign_memory_s)
    state.travel_by_depth_m *= memory
    state.travel_by_speed_m *= memory
    if is_jump:
        state.removed_m += unexplained_m
    elif has_depth and dt_s <= gap_s and is_speed_measured:
        # The speed now says nothing about travel during a gap, or before the first
        # depth.
        state.travel_by_depth_m += change_m
        state.travel_by_speed_m += speed_m_s * dt_s

    by_depth_m = state.travel_by_depth_m
    by_speed_m = state.travel_by_speed_m
    contradicted_m = min(abs(by_depth_m), abs(by_speed_m))
    status = OK
    if is_jump:
        status = DEPTH_JUMP
    elif by_depth_m * by_speed_m < 0.0 and contradicted_m > limits.sign_travel_m:
        status = SPEED_SIGN
    elif has_depth and elapsed_s > gap_s:
        status = TIME_GAP
    state.depth_m = depth_m
    state.has_depth = True
    state.since_depth_s = 0.0
    state.rejected_s = 0.0 if status in (OK, TIME_GAP) else elapsed_s
    return status, elapsed_s


@compiled_inside
def check_sample(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    dt_s: float,
    is_speed_measured: bool,
    state: CheckState,
    estimated_speed_m_s: float,
    limits: CheckConfig,
) -> tuple[int, float]:
    """Check one raw sample.

    Time runs on over a rejected sample as long as its time step is valid: a dropped
    force does not shift the clock.

    Args:
        depth_m: Travel of the tip along the insertion axis.
        speed_m_s: Rate of depth; where none is measured the estimated one.
        force_N: Axial force.
        dt_s: Time since the previous sample, used or not.
        is_speed_measured: Whether the speed is a measurement.
        state: What the check remembers.
        estimated_speed_m_s: Speed as filtered so far.
        limits: Of a plausible sample.

    Returns:
        The status, an index in `STATUSES`, and the time since the last sample that was
        used, 0 for a sample whose numbers are bad.
    """
    status = check_numbers(depth_m, speed_m_s, force_N, dt_s, limits.force_limit_N)
    if status == OK:
        status, elapsed_s = compare_depth_with_speed(
            depth_m,
            speed_m_s,
            dt_s,
            is_speed_measured,
            state,
            estimated_speed_m_s,
            limits,
        )
        usual_dt_s = state.usual_dt_s if state.usual_dt_s != 0.0 else dt_s
        if dt_s <= shortest_gap(state, limits):  # a gap makes no gap usual
            state.usual_dt_s = usual_dt_s + 0.05 * (dt_s - usual_dt_s)
        state.time_s += dt_s
        return status, elapsed_s
    if MIN_DT_S <= dt_s <= MAX_DT_S:
        state.time_s += dt_s
        state.since_depth_s += dt_s
    return status, 0.0
