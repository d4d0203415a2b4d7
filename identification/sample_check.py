"""Decides whether a raw sample may be absorbed; nothing else in this room sees raw input."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np

from identification.errors import InvalidConfigError
from identification.sample import Sample


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
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidConfigError(f"{name} must be positive and finite, got {value}")


class CheckState(NamedTuple):
    """Memory of the check: just enough to notice jumps and contradictions."""

    time_s: float = 0.0
    usual_dt_s: float = 0.0
    raw_depth_m: float = 0.0
    depth_shift_m: float = 0.0
    depth_travel_m: float = 0.0
    speed_travel_m: float = 0.0
    pending_s: float = 0.0
    has_depth: bool = False


def to_scalars(*values: object) -> tuple[float, ...] | None:
    """Floats, or None if any value is not a single real number."""
    try:
        if any(isinstance(v, (str, bytes)) or np.ndim(v) > 0 for v in values):  # type: ignore
            return None
        return tuple(float(v) for v in values)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return None


def _skipped(state: CheckState, dt_s: float) -> CheckState:
    return state._replace(time_s=state.time_s + dt_s, pending_s=state.pending_s + dt_s)


def _motion_check(
    state: CheckState, values: tuple[float, float, float, float], config: CheckConfig
) -> tuple[CheckState, SampleStatus]:
    depth, speed, _, interval = values
    time, usual, raw_depth, shift, by_depth, by_speed, pending, has_depth = state
    dt = interval + pending
    change = depth - raw_depth if has_depth else 0.0
    surprise = change - speed * dt
    keep = math.exp(-dt / config.sign_memory_s)
    is_jump = abs(surprise) > config.jump_m + abs(speed) * dt
    is_gap = has_depth and dt > max(config.gap_s, 10.0 * usual)
    by_depth, by_speed = keep * by_depth, keep * by_speed
    if is_jump:
        shift += surprise
    elif state.has_depth and not is_gap:
        # One speed says nothing of the way through a gap, nor of that before the first depth.
        by_depth, by_speed = by_depth + change, by_speed + speed * dt
    usual = usual or interval
    usual += 0.05 * (interval - usual)
    new = CheckState(time + interval, usual, depth, shift, by_depth, by_speed, 0.0, True)
    is_contrary = by_depth * by_speed < 0.0 and (
        min(abs(by_depth), abs(by_speed)) > config.sign_travel_m
    )
    if is_jump:
        return new, SampleStatus.DEPTH_JUMP
    if is_contrary:
        return new, SampleStatus.SPEED_SIGN
    return new, SampleStatus.TIME_GAP if is_gap else SampleStatus.OK


def check_step(
    state: CheckState, values: tuple[float, ...] | None, config: CheckConfig
) -> tuple[CheckState, Sample | None, SampleStatus]:
    """Judge one raw sample.

    Time runs on over samples that are refused, as long as their interval is valid: a dropped
    force does not shift the clock of what follows.

    Args:
        state: Memory of the check.
        values: (depth, speed, force, dt), or None if they were not scalars.
        config: Limits.

    Returns:
        The new memory, the sample to absorb (None if refused) and its status.
    """
    if values is None:
        return state, None, SampleStatus.NOT_A_SCALAR
    depth, speed, force, dt = values
    if not math.isfinite(dt):
        return state, None, SampleStatus.NOT_FINITE
    if dt <= 0.0:
        return state, None, SampleStatus.TIME_NOT_FORWARD
    if not math.isfinite(depth + speed + force):
        return _skipped(state, dt), None, SampleStatus.NOT_FINITE
    if abs(force) > config.force_limit_N:
        return _skipped(state, dt), None, SampleStatus.FORCE_RANGE
    new, status = _motion_check(state, (depth, speed, force, dt), config)
    if not status.is_absorbed:
        return new, None, status
    elapsed = dt + state.pending_s
    return new, Sample(new.time_s, elapsed, depth - new.depth_shift_m, speed, force), status
