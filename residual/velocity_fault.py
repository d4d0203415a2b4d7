"""Says in words what is wrong with a velocity that is not the rate of its position."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.velocity_match import (
    BEYOND,
    CHANGE_SAID,
    CHANGE_SQUARE,
    CHANGE_TRAVEL,
    LEAST_BEYOND,
    LEAST_SECONDS,
    LEAST_TRAVEL_RAD,
    SAID_SQUARE,
    SECONDS,
    SQUARES,
    differs,
)

FACTORS = {
    math.degrees(1.0): "is it in deg/s?",
    math.radians(1.0): "is q in degrees?",
    30.0 / math.pi: "is it in revolutions per minute?",
    0.5 / math.pi: "is it in revolutions per second?",
    1.0: "is its sign the other one?",
}
"""Factors with a likely reason; each may come with the other sign."""
OTHER_FACTOR = "is it in other units, or of the motor before its gear, or are time stamps wrong?"
OTHER_JOINT = "is the order of the joints another?"
NEAR = 0.05
"""So near to one of these a factor is that one, to another joint's travel dq's is that one's."""
MOST_OFF = 0.4
"""Root mean square difference of dq's travel from q's, in times of it, that noise does not make."""
LEAST_OFF = 0.12
"""The same where another joint or a lag is just what makes it."""
UNEXPLAINED = 0.1
"""Share of dq's mean square travel that a factor may leave over, or a lag of the difference."""
LONGEST_LAG_S, LAG_SECONDS = 0.1, 2.0
"""A filtered velocity is late by 20 ms; what is late by more, over that much motion, is told."""
STILL = 1e-3
"""What moves by less than this share of the other stands still."""


class _Sums(NamedTuple):
    """What a match knows of one joint; squares and products as in `residual.velocity_match`."""

    seconds: float
    beyond: float
    said: float
    change: float
    change_own: float
    change_said: float
    own: float
    product: float

    @property
    def difference(self) -> float:
        return self.said - 2.0 * self.product + self.own


def velocity_fault(match: NDArray[np.float64]) -> str:
    """What is wrong, joint by joint, with the likely reasons; empty if nothing surely is.

    Args:
        match: See `residual.velocity_match`.
    """
    if not differs(match):
        return ""
    joints: dict[str, list[int]] = {}
    is_sure = False
    sums = [_sums_of(match, i) for i in range(match.shape[1])]
    off = [s.seconds >= LEAST_SECONDS and s.difference > LEAST_OFF**2 * s.own for s in sums]
    for i in np.flatnonzero(off).tolist():
        one = sums[i]
        fault, is_plain = _other(match, i, off) or _late(one), True
        if not fault and one.difference > MOST_OFF**2 * one.own:
            fault, is_plain = _factor(one), False
        if fault:
            joints.setdefault(fault, []).append(i)
            is_sure |= one.beyond > (LEAST_BEYOND if is_plain else MOST_OFF) ** 2 * one.own
    if not is_sure:
        return ""
    return "; ".join(f"dq at joint index {found} {fault}" for fault, found in joints.items())


def _sums_of(match: NDArray[np.float64], i: int) -> _Sums:
    rows = (SECONDS, BEYOND, SAID_SQUARE, CHANGE_SQUARE, CHANGE_TRAVEL, CHANGE_SAID)
    rows += (SQUARES + i, SQUARES + match.shape[1] + i)
    return _Sums(*match[list(rows), i].tolist())


def _other(match: NDArray[np.float64], i: int, off: list[bool]) -> str:
    """The joint whose rate a velocity is, if there is one: its own velocity is not sound either."""
    n = len(off)
    squares, products = match[SQUARES : SQUARES + n, i], match[SQUARES + n :, i]
    said, seconds = match[SAID_SQUARE, i], match[SECONDS]
    is_sound = (seconds >= LEAST_SECONDS) & ~np.array(off)
    moves = squares > seconds[i] * (0.2 * LEAST_TRAVEL_RAD) ** 2
    left = np.where(moves & ~is_sound, said - 2.0 * products + squares, np.inf)
    left[i] = np.inf
    other = int(np.argmin(left))
    if left[other] > NEAR**2 * said:
        return ""
    return f"is the rate of q at joint index {other}: {OTHER_JOINT}"


def _late(one: _Sums) -> str:
    """By how much a velocity is late, if that is all that is wrong.

    Least squares of dq's travel over q's and over the change of q's.
    """
    scale = one.own * one.change - one.change_own**2
    if scale <= 0.0 or one.seconds < LAG_SECONDS:
        return ""
    factor = (one.product * one.change - one.change_said * one.change_own) / scale
    late_s = (one.product * one.change_own - one.change_said * one.own) / scale
    left = one.said - factor * one.product + late_s * one.change_said
    explained = late_s**2 * one.change
    is_all = left < UNEXPLAINED * one.difference < 2.0 * UNEXPLAINED * explained
    if abs(late_s) < LONGEST_LAG_S or not is_all:
        return ""
    where = "behind" if late_s > 0.0 else "ahead of"
    return f"is {abs(late_s):.1f} s {where} q: is one of them late?"


def _factor(one: _Sums) -> str:
    """What a constant factor between velocity and rate stands for, or that there is none."""
    if one.said < STILL**2 * one.own:
        return "stands still while q moves: is it sent at all?"
    if one.own < STILL**2 * one.said:
        return "moves while q stands still: is q sent at all?"
    if one.product**2 < (1.0 - UNEXPLAINED) * one.said * one.own:
        return "does not follow q: is it late, stale, or another joint's?"
    factor, reason = float(f"{one.product / one.own:.2g}"), OTHER_FACTOR
    for known, text in FACTORS.items():
        if abs(abs(one.product) / one.own / known - 1.0) < NEAR:
            factor, reason = math.copysign(known, one.product), text
    if factor < 0.0 and factor != -1.0:
        reason = f"is its sign the other one, and {reason}"
    return f"is {factor:.3g} times the rate of q: {reason}"
