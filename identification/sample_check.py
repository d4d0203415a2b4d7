"""Decides whether a raw sample may be absorbed; nothing else in this room sees raw input."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from identification.sample import Sample
from identification.settings_check import check_positive

_NO_NUMBERS = (str, bytes, bool, np.bool_, complex, np.complexfloating)
"""What Python or numpy would make a float of, though nobody measures it."""


class SampleStatus(Enum):
    """What became of a sample. Only `OK` and `TIME_GAP` samples are absorbed."""

    OK = "ok"
    NOT_A_SCALAR = "not a scalar: depth, speed, force and dt must be single numbers"
    NOT_FINITE = "not finite"
    TIME_NOT_FORWARD = "dt must be positive"
    TIME_GAP = "gap in time: local predictions restart"
    DEPTH_JUMP = "depth jumped against its speed: the jump is removed"
    SPEED_SIGN = "speed has the sign opposite to the change of depth"
    FORCE_RANGE = "force beyond any needle's: check the unit"

    @property
    def is_absorbed(self) -> bool:
        """Whether the sample went into the estimate."""
        return self is SampleStatus.OK or self is SampleStatus.TIME_GAP


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckConfig:
    """Limits of a believable sample.

    Attributes:
        gap_s: An interval longer than this, and than ten usual ones, is a gap.
        jump_m: Change of depth beyond what speed explains that counts as a jump; a needle at
            a surgical 100 mm/s moves a tenth of this between samples at 1 kHz.
        sign_memory_s: Time constant over which travel from depth and from speed are compared.
        sign_travel_m: Both must exceed this, with opposite signs, to be called contradictory.
        force_limit_N: Largest believable axial force; needles buckle far below.
    """

    gap_s: float = 0.25
    jump_m: float = 1e-3
    sign_memory_s: float = 0.2
    sign_travel_m: float = 5e-5
    force_limit_N: float = 200.0

    def __post_init__(self) -> None:
        """Raise `InvalidConfigError` unless every limit is positive and finite."""
        for name in self.__slots__:
            check_positive(name, getattr(self, name))


class CheckState(NamedTuple):
    """Memory of the check: just enough to notice jumps and contradictions.

    Attributes:
        time_s: Since the start.
        usual_dt_s: Smoothed interval.
        raw_depth_m: Last depth that could be read, of a sample absorbed or refused.
        depth_shift_m: Sum of all jumps removed.
        depth_travel_m: Recent travel by depth.
        speed_travel_m: The same by speed.
        pending_s: Time since `raw_depth_m`.
        has_depth: Whether there is one.
        refused_s: Time from the last sample absorbed to `raw_depth_m`.
    """

    time_s: float = 0.0
    usual_dt_s: float = 0.0
    raw_depth_m: float = 0.0
    depth_shift_m: float = 0.0
    depth_travel_m: float = 0.0
    speed_travel_m: float = 0.0
    pending_s: float = 0.0
    has_depth: bool = False
    refused_s: float = 0.0


def _to_scalar(value: object) -> float | None:
    """As a float, or None if it is not a single real number."""
    if isinstance(value, float):
        return float(value)
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, _NO_NUMBERS) or value is np.ma.masked:
        return None
    try:
        return None if np.ndim(value) > 0 else float(value)  # type: ignore
    except OverflowError:
        return math.inf
    except (TypeError, ValueError):
        return None


def _skipped(state: CheckState, dt_s: float) -> CheckState:
    return state._replace(time_s=state.time_s + dt_s, pending_s=state.pending_s + dt_s)


def _motion_check(
    state: CheckState, values: tuple[float, ...], config: CheckConfig
) -> tuple[CheckState, float, SampleStatus]:
    """The new memory, the time since the last sample that was absorbed, and the status."""
    depth, speed, _, interval = values
    time, usual, raw_depth, shift, by_depth, by_speed, pending, has_depth, refused = state
    # Of the time since the last depth, and since the last sample that was absorbed.
    dt = interval + pending
    elapsed = dt + refused
    gap = config.gap_s
    if gap < 10.0 * usual:
        gap = 10.0 * usual
    change = depth - raw_depth if has_depth else 0.0
    surprise = change - speed * dt
    keep = math.exp(-dt / config.sign_memory_s)
    is_jump = abs(surprise) > config.jump_m + abs(speed) * dt
    by_depth, by_speed = keep * by_depth, keep * by_speed
    if is_jump:
        shift += surprise
    elif has_depth and dt <= gap:
        # One speed says nothing of the way through a gap, nor of that before the first depth.
        by_depth, by_speed = by_depth + change, by_speed + speed * dt
    is_contrary = by_depth * by_speed < 0.0 and (
        min(abs(by_depth), abs(by_speed)) > config.sign_travel_m
    )
    if is_jump:
        refused, status = elapsed, SampleStatus.DEPTH_JUMP
    elif is_contrary:
        refused, status = elapsed, SampleStatus.SPEED_SIGN
    else:
        refused, is_gap = 0.0, has_depth and elapsed > gap
        status = SampleStatus.TIME_GAP if is_gap else SampleStatus.OK
    usual = usual or interval
    usual += 0.05 * (interval - usual)
    time += interval
    new = CheckState(time, usual, depth, shift, by_depth, by_speed, 0.0, True, refused)
    return new, elapsed, status


def raw_check_step(
    state: CheckState, values: tuple[object, ...], config: CheckConfig
) -> tuple[CheckState, Sample | None, SampleStatus]:
    """As `check_step`, for values of any type."""
    depth, speed, force, dt = (_to_scalar(value) for value in values)
    if depth is not None and speed is not None and force is not None and dt is not None:
        return check_step(state, (depth, speed, force, dt), config)
    if dt is not None and math.isfinite(dt) and dt > 0.0:
        state = _skipped(state, dt)
    return state, None, SampleStatus.NOT_A_SCALAR


def check_step(
    state: CheckState, values: tuple[float, ...], config: CheckConfig
) -> tuple[CheckState, Sample | None, SampleStatus]:
    """Judge one raw sample.

    Time runs on over samples that are refused, as long as their interval is valid: a dropped
    force does not shift the clock of what follows.

    Args:
        state: Memory of the check.
        values: (depth, speed, force, dt).
        config: Limits.

    Returns:
        The new memory, the sample to absorb (None if refused) and its status.
    """
    depth, speed, force, dt = values
    if not math.isfinite(dt):
        return state, None, SampleStatus.NOT_FINITE
    if dt <= 0.0:
        return state, None, SampleStatus.TIME_NOT_FORWARD
    if not math.isfinite(depth + speed + force):
        return _skipped(state, dt), None, SampleStatus.NOT_FINITE
    if abs(force) > config.force_limit_N:
        return _skipped(state, dt), None, SampleStatus.FORCE_RANGE
    new, elapsed, status = _motion_check(state, values, config)
    if not status.is_absorbed:
        return new, None, status
    return new, Sample(new.time_s, elapsed, depth - new.depth_shift_m, speed, force), status
