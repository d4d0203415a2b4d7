"""Decides whether a raw sample may be absorbed; nothing else in this room sees raw input."""

import math
import numbers
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from identification.errors import InvalidConfigError
from needleforce.jit import COMPILER, Vector, compiled

# What a configuration may be set to: the one place where figures are refused.


def check_finite(name: str, value: object) -> None:
    """Refuse a figure that is not a finite number.

    Raises:
        InvalidConfigError: With the name and what came.
    """
    if not _is_finite(value):
        raise InvalidConfigError(f"{name} must be a finite number, got {value!r}")


def check_positive(name: str, value: object) -> None:
    """Refuse a figure that is not a finite number above zero.

    Raises:
        InvalidConfigError: With the name and what came.
    """
    if not (_is_finite(value) and value > 0):  # type: ignore[operator]
        raise InvalidConfigError(f"{name} must be positive and finite, got {value!r}")


def check_kind(name: str, value: object, kind: type) -> None:
    """Refuse a part of a configuration that is something else.

    Raises:
        InvalidConfigError: With the name, what came and what was expected.
    """
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidConfigError(f"{name} must be of type {kind.__name__}, got {value!r}")


def _is_finite(value: object) -> bool:
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


# Many numbers for a compiled function, in the form that it reads fastest.


def packed(numbers: Sequence[float]) -> Any:
    """Numbers that seldom change: an array for compiled code, a tuple for plain Python.

    Args:
        numbers: Any number of them; whoever reads them names their places.
    """
    if not COMPILER:
        return tuple(map(float, numbers))
    array = np.array(numbers, dtype=np.float64)
    array.setflags(write=False)
    return array


_NO_NUMBERS = (str, bytes, bool, np.bool_, complex, np.complexfloating)
"""What Python or numpy would make a float of, though nobody measures it."""


class SampleStatus(Enum):
    """What became of a sample. Only `OK` and `TIME_GAP` samples are absorbed."""

    OK = "ok"
    TIME_GAP = "gap in time: local predictions restart"
    NOT_A_SCALAR = "not a scalar: depth, speed, force and dt must be single numbers"
    NOT_FINITE = "not finite"
    TIME_NOT_FORWARD = "dt must be positive"
    DEPTH_JUMP = "depth jumped against its speed: the jump is removed"
    SPEED_SIGN = "speed has the sign opposite to the change of depth"
    FORCE_RANGE = "force beyond any needle's: check the unit"

    @property
    def is_absorbed(self) -> bool:
        """Whether the sample went into the estimate."""
        return self is SampleStatus.OK or self is SampleStatus.TIME_GAP


STATUSES = tuple(SampleStatus)
"""In the order of their numbers, by which `check_step` names them; those absorbed come first."""
_NUMBERS = {status: number for number, status in enumerate(STATUSES)}
_OK, _TIME_GAP = _NUMBERS[SampleStatus.OK], _NUMBERS[SampleStatus.TIME_GAP]
LAST_ABSORBED = _TIME_GAP
_NOT_FINITE = _NUMBERS[SampleStatus.NOT_FINITE]
_TIME_NOT_FORWARD = _NUMBERS[SampleStatus.TIME_NOT_FORWARD]
_DEPTH_JUMP, _SPEED_SIGN = _NUMBERS[SampleStatus.DEPTH_JUMP], _NUMBERS[SampleStatus.SPEED_SIGN]
_FORCE_RANGE = _NUMBERS[SampleStatus.FORCE_RANGE]
_GAP, _JUMP, _MEMORY, _TRAVEL, _FORCE = range(5)
"""Places of the limits, in the order of `CheckConfig`."""


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

    @property
    def plain(self) -> "CheckMemory":
        """As `check_step` takes it."""
        return self[:]


CheckMemory = tuple[float, float, float, float, float, float, float, bool, float]
"""The fields of `CheckState`, plain: what compiled code takes and gives."""


def as_scalar(value: object) -> float | None:
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


def packed_limits(config: CheckConfig) -> Any:
    """The limits as `check_step` takes them."""
    return packed([getattr(config, name) for name in config.__slots__])


@compiled
def _skipped(memory: CheckMemory, dt_s: float) -> CheckMemory:
    """The time of a sample that cannot be read passes."""
    time, usual, raw_depth, shift, by_depth, by_speed, pending, has_depth, refused = memory
    time, pending = time + dt_s, pending + dt_s
    return time, usual, raw_depth, shift, by_depth, by_speed, pending, has_depth, refused


@compiled
def _motion_check(
    depth: float, speed: float, interval: float, memory: CheckMemory, limits: Vector
) -> tuple[int, float, float, CheckMemory]:
    """Judge depth against speed."""
    time, usual, raw_depth, shift, by_depth, by_speed, pending, has_depth, refused = memory
    # Of the time since the last depth, and since the last sample that was absorbed.
    dt = interval + pending
    elapsed = dt + refused
    gap = max(limits[_GAP], 10.0 * usual)
    change = depth - raw_depth if has_depth else 0.0
    surprise = change - speed * dt
    keep = math.exp(-dt / limits[_MEMORY])
    is_jump = abs(surprise) > limits[_JUMP] + abs(speed) * dt
    by_depth, by_speed = keep * by_depth, keep * by_speed
    if is_jump:
        shift += surprise
    elif has_depth and dt <= gap:
        # One speed says nothing of the way through a gap, nor of that before the first depth.
        by_depth, by_speed = by_depth + change, by_speed + speed * dt
    is_contrary = by_depth * by_speed < 0.0 and (
        min(abs(by_depth), abs(by_speed)) > limits[_TRAVEL]
    )
    status, refused = _OK, 0.0
    if is_jump:
        status, refused = _DEPTH_JUMP, elapsed
    elif is_contrary:
        status, refused = _SPEED_SIGN, elapsed
    elif has_depth and elapsed > gap:
        status = _TIME_GAP
    if usual == 0.0:
        usual = interval
    usual += 0.05 * (interval - usual)
    time += interval
    memory = (time, usual, depth, shift, by_depth, by_speed, 0.0, True, refused)
    return status, elapsed, depth - shift, memory


@compiled
def check_step(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    dt_s: float,
    memory: CheckMemory,
    limits: Vector,
) -> tuple[int, float, float, CheckMemory]:
    """Judge one raw sample.

    Time runs on over samples that are refused, as long as their interval is valid: a dropped
    force does not shift the clock of what follows.

    Args:
        depth_m: Travel of the tip along the insertion axis [m].
        speed_m_s: Rate of depth [m/s].
        force_N: Axial force [N].
        dt_s: Time since the previous sample [s].
        memory: Of the check, see `CheckState`.
        limits: See `packed_limits`.

    Returns:
        The status by its place in `STATUSES`; of a sample to absorb the interval since the one
        absorbed before [s] and the depth less the jumps removed [m]; and the new memory.
    """
    if not math.isfinite(dt_s):
        return _NOT_FINITE, 0.0, 0.0, memory
    if dt_s <= 0.0:
        return _TIME_NOT_FORWARD, 0.0, 0.0, memory
    if not math.isfinite(depth_m + speed_m_s + force_N):
        return _NOT_FINITE, 0.0, 0.0, _skipped(memory, dt_s)
    if abs(force_N) > limits[_FORCE]:
        return _FORCE_RANGE, 0.0, 0.0, _skipped(memory, dt_s)
    return _motion_check(depth_m, speed_m_s, dt_s, memory, limits)


# One sample of an insertion.


class Sample(NamedTuple):
    """Checked scalars handed to the step functions.

    Attributes:
        time_s: Time since the identifier was reset, the sum of all intervals.
        dt_s: Interval since the previous sample, positive.
        depth_m: Tip travel along the insertion axis, jumps removed.
        speed_m_s: Rate of depth.
        force_N: Axial force, positive when tissue pushes back.
    """

    time_s: float
    dt_s: float
    depth_m: float
    speed_m_s: float
    force_N: float
