"""What a sample must be before an identifier uses it; the estimators see checked numbers only."""

import math
from dataclasses import astuple
from typing import Any, NamedTuple

import numpy as np

from identification.config import CheckConfig
from identification.errors import InvalidSnapshotError
from identification.estimate import SampleStatus
from needleforce.jit import compiled

_NO_NUMBERS = (str, bytes, bool, np.bool_, complex, np.complexfloating, np.timedelta64)
"""What Python or numpy would make a float of, though nobody measures it."""
LEAST_DT_S, LARGEST_DT_S = 1e-12, 1e6
"""Intervals outside are wrong units or garbage: quotients by them, or their sum, overflow."""
LARGEST_MOTION = 1e3
"""No needle is as deep [m] or as fast [m/s]; powers of larger numbers overflow."""


STATUSES = tuple(SampleStatus)
"""In the order of their numbers, by which `check_sample` names them; those used come first."""
_OK, _TIME_GAP, _NOT_A_SCALAR, _NOT_FINITE, _TIME_NOT_FORWARD = range(5)
_DEPTH_JUMP, _SPEED_SIGN, _FORCE_RANGE, _TIME_RANGE, _MOTION_RANGE = range(5, 10)
LAST_USED = _TIME_GAP


class CheckState(NamedTuple):
    """Memory of the check: just enough to notice jumps and contradictions."""

    time_s: float = 0.0  # Since the start
    usual_dt_s: float = 0.0  # Smoothed interval
    raw_depth_m: float = 0.0  # Last depth that could be read, of a sample used or rejected
    depth_shift_m: float = 0.0  # Sum of all jumps removed
    depth_travel_m: float = 0.0  # Recent travel by depth
    speed_travel_m: float = 0.0  # The same by speed
    pending_s: float = 0.0  # Time since `raw_depth_m`
    has_depth: bool = False  # Whether there is one
    rejected_s: float = 0.0  # Time from the last sample used to `raw_depth_m`


CheckMemory = tuple[float, float, float, float, float, float, float, bool, float]
"""The fields of `CheckState`, plain: what compiled code takes and returns."""
Limits = tuple[float, float, float, float, float]
"""The fields of `CheckConfig`."""


def check_limits(config: CheckConfig) -> Limits:
    """The limits as `check_sample` takes them."""
    gap_s, jump_m, memory_s, travel_m, force_N = map(float, astuple(config))
    return gap_s, jump_m, memory_s, travel_m, force_N


def as_scalar(value: Any) -> float | None:
    """As a float, or None if it is not a single real number."""
    if isinstance(value, float):
        return float(value)
    try:
        if isinstance(value, np.ndarray) and value.ndim == 0:
            value = value[()]
        if isinstance(value, _NO_NUMBERS) or value is np.ma.masked:
            return None
        return None if np.ndim(value) > 0 else float(value)
    except OverflowError:
        return math.inf
    except Exception:  # foreign objects convert by code of their own, which may raise anything
        return None


@compiled
def _check_motion(
    depth: float,
    speed: float,
    interval: float,
    is_measured: bool,
    memory: CheckMemory,
    limits: Limits,
) -> tuple[int, float, float, CheckMemory]:
    """Compare depth with speed."""
    time, usual, raw_depth, shift, by_depth, by_speed, pending, has_depth, rejected = memory
    gap_s, jump_m, sign_memory_s, sign_travel_m, _ = limits
    # Of the time since the last depth, and since the last sample that was used.
    dt = interval + pending
    elapsed = dt + rejected
    gap = max(gap_s, 10.0 * usual)
    change = depth - raw_depth if has_depth else 0.0
    surprise = change - speed * dt
    keep = math.exp(-dt / sign_memory_s)
    is_jump = abs(surprise) > jump_m + abs(speed) * dt
    by_depth, by_speed = keep * by_depth, keep * by_speed
    if is_jump:
        shift += surprise
    elif has_depth and dt <= gap and is_measured:
        # One speed says nothing of the travel through a gap, nor of that before the first depth.
        by_depth, by_speed = by_depth + change, by_speed + speed * dt
    is_contrary = by_depth * by_speed < 0.0 and min(abs(by_depth), abs(by_speed)) > sign_travel_m
    status, rejected = _OK, 0.0
    if is_jump:
        status, rejected = _DEPTH_JUMP, elapsed
    elif is_contrary:
        status, rejected = _SPEED_SIGN, elapsed
    elif has_depth and elapsed > gap:
        status = _TIME_GAP
    if usual == 0.0:
        usual = interval
    usual += 0.05 * (interval - usual)
    time += interval
    memory = (time, usual, depth, shift, by_depth, by_speed, 0.0, True, rejected)
    return status, elapsed, depth - shift, memory


@compiled
def check_sample(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    dt_s: float,
    is_measured: bool,
    memory: CheckMemory,
    limits: Limits,
) -> tuple[int, float, float, CheckMemory]:
    """Check one raw sample: depth, speed, force and interval as `Identifier.update` takes them.

    Where nobody measured the speed, it is the last one estimated, which contradicts no depth.

    Time runs on over samples that are rejected, as long as their interval is valid: a dropped
    force does not shift the clock of what follows.

    Returns:
        The status by its place in `STATUSES`; of a sample to use the interval since the one
        used before [s] and the depth less the jumps removed [m]; and the new memory.
    """
    if not math.isfinite(dt_s):
        return _NOT_FINITE, 0.0, 0.0, memory
    if dt_s <= 0.0:
        return _TIME_NOT_FORWARD, 0.0, 0.0, memory
    if dt_s < LEAST_DT_S or dt_s > LARGEST_DT_S:
        return _TIME_RANGE, 0.0, 0.0, memory
    status = _OK
    if not math.isfinite(depth_m + speed_m_s + force_N):
        status = _NOT_FINITE
    elif max(abs(depth_m), abs(speed_m_s)) > LARGEST_MOTION:
        status = _MOTION_RANGE
    elif abs(force_N) > limits[4]:
        status = _FORCE_RANGE
    if status == _OK:
        return _check_motion(depth_m, speed_m_s, dt_s, is_measured, memory, limits)
    time, usual, raw_depth, shift, by_depth, by_speed, pending, has_depth, rejected = memory
    time, pending = time + dt_s, pending + dt_s
    memory = (time, usual, raw_depth, shift, by_depth, by_speed, pending, has_depth, rejected)
    return status, 0.0, 0.0, memory


# A state that is restored.

_ROUNDING = {"matrix": 1e-11, "covariance": 1e-3}
"""How far below zero an eigenvalue of a matrix of that name may lie, its diagonal scaled to ones:
normal equations are sums of squares, covariances their inverses."""


def check_state(state: Any, initial: Any, place: str = "state") -> None:
    """Refuse a damaged state, before compiled code reads beyond its arrays or a solver fails.

    `initial` is the state before the first sample, or None where it has no such part.

    Raises:
        InvalidSnapshotError: A part is of another type, an array of another kind or shape, or a
            matrix not symmetric and positive semi-definite, or a track with absurd rows.
    """
    if isinstance(state, np.ndarray) or isinstance(initial, np.ndarray):
        _check_array(state, initial, place)
    elif hasattr(initial, "_fields") and type(state) is not type(initial):
        raise InvalidSnapshotError(f"{place} is {state!r:.80}, expected {type(initial).__name__}")
    elif hasattr(state, "_fields"):
        _check_fields(state, initial, place)
    elif isinstance(state, tuple):
        for k, part in enumerate(state):
            check_state(part, None, f"{place}[{k}]")


def _check_fields(state: Any, initial: Any, place: str) -> None:
    if hasattr(state, "damage"):  # it checks itself
        if state.damage:
            raise InvalidSnapshotError(f"the snapshot is damaged: {place}: {state.damage}")
        return
    for name, part in zip(state._fields, state, strict=True):
        check_state(part, getattr(initial, name, None), f"{place}.{name}")
    if "var_stiffness" in state._fields:
        first, both, second = state.var_stiffness, state.covariance, state.var_friction
        _check_definite(np.array([[first, both], [both, second]]), 1e-3, place)


def _check_array(array: Any, initial: Any, place: str) -> None:
    is_array = isinstance(array, np.ndarray) and array.dtype == np.float64
    if not is_array or not (array.flags.c_contiguous):
        raise InvalidSnapshotError(f"{place} is {array!r:.80}, expected an array of floats")
    if initial is not None:
        rows = array.shape[0] if initial.shape[:1] == (0,) and array.ndim else None
        expected = initial.shape if rows is None else (rows, *initial.shape[1:])
        if array.shape != expected:
            raise InvalidSnapshotError(f"{place} has shape {array.shape}, expected {expected}")
    name = place.rpartition(".")[2]
    if name in _ROUNDING:
        _check_definite(array, _ROUNDING[name], place)
    if name in ("points", "rows"):
        # Depth, speed, force, bristle; blocks and travel.
        is_valid = (np.abs(array[:, :4]) <= LARGEST_MOTION).all() and (array[:, 4:] > 0.0).all()
        if not is_valid:
            raise InvalidSnapshotError(f"the snapshot is damaged: {place} has impossible rows")


def _check_definite(matrix: Any, rounding: float, place: str) -> None:
    """Refuse a matrix that is not symmetric and positive semi-definite."""
    is_square = matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1]
    if is_square and np.isfinite(matrix).all():
        diagonal = matrix.diagonal()
        scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
        scaled = scale[:, None] * matrix * scale
        is_symmetric = np.allclose(scaled, scaled.T, rtol=0.0, atol=rounding)
        if is_symmetric and np.linalg.eigvalsh(scaled).min() >= -rounding:
            return
    raise InvalidSnapshotError(
        f"the snapshot is damaged: {place} is not symmetric and positive semi-definite"
    )
