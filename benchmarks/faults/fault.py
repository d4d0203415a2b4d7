"""A fault, and what came of it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from benchmarks.faults.fault_stream import Array, FaultStream
from insertion import InsertionSession, SessionEstimate
from residual import DEFAULT, Caution, Status

CLOSE_N = 0.1
"""An estimate has recovered when it stays this close to that of an undisturbed run."""
HOLD_S = 1.0
"""For at least this long after the fault the caller is listened to."""


Injection = Callable[[FaultStream, int], FaultStream]
"""Bends a stream from an index on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultResult:
    """What came of one fault.

    Attributes:
        name: What was done, in a few words.
        worst_N: Largest error of the force while it lasted.
        worst_sigma: The same in its own standard deviations.
        recovery_s: Time after its end until the error stays within `CLOSE_N`; infinite if it does
            not.
        told: Statuses other than ok, and cautions, that the caller got from its start to `HOLD_S`
            after its end.
        is_finite: Whether every number handed out was.
        note: What else happened, in words.
    """

    name: str
    worst_N: float
    worst_sigma: float
    recovery_s: float
    told: tuple[str, ...]
    is_finite: bool
    note: str = ""


def feed(
    session: InsertionSession, stream: FaultStream, *, with_velocity: bool = True
) -> list[SessionEstimate]:
    """Estimates of every sample of a stream."""
    dq = stream.dq_rad_s if with_velocity else [None] * len(stream.dt_s)
    rows = zip(stream.q_rad, dq, stream.tau_Nm, stream.dt_s.tolist(), strict=True)
    return [session.update(*row) for row in rows]


def judge(
    name: str, stream: FaultStream, found: list[SessionEstimate], note: str = ""
) -> FaultResult:
    """Compare the estimates of a faulty stream with its reference."""
    error = np.abs(np.array([e.wrench.axial for e in found]) - stream.reference_N)
    std = np.array([e.wrench.axial_std for e in found])
    during = slice(stream.start, max(stream.stop, stream.start + 1))
    after = np.flatnonzero(error[stream.stop :] > CLOSE_N)
    elapsed = np.cumsum(np.nan_to_num(stream.dt_s[stream.stop :], posinf=0.0))
    if len(after) == 0:
        recovery = 0.0
    else:
        last = int(after[-1]) + 1
        recovery = float(elapsed[last]) if last < len(elapsed) else np.inf
    end = stream.stop + round(HOLD_S / 1e-3)
    worst = int(np.argmax(error[during])) + during.start
    return FaultResult(
        name=name,
        worst_N=float(error[worst]),
        worst_sigma=float(error[worst] / std[worst]),
        recovery_s=recovery,
        told=_told(found[stream.start : end]),
        is_finite=all(map(is_finite, found[stream.start : end])),
        note=note,
    )


def late(force_N: Array, *, with_velocity: bool = True) -> Array:
    """A force as late as an ideal arm would let the sensor read it, shape (n,), at 1 kHz.

    Args:
        force_N: The true force.
        with_velocity: Whether the arm sends velocities; without, position and torque are filtered.
    """
    assert isinstance(DEFAULT.gain_per_s, float)
    rates_per_s = [DEFAULT.gain_per_s]
    if not with_velocity:
        rates_per_s += [DEFAULT.velocity_bandwidth_per_s] * 2
    for rate in rates_per_s:
        decay = np.exp(-1e-3 * rate)
        force_N = np.asarray(lfilter([1.0 - decay], [1.0, -decay], force_N), dtype=np.float64)
    return force_N


def _told(found: list[SessionEstimate]) -> tuple[str, ...]:
    statuses = {e.status for e in found} - {Status.OK}
    cautions = Caution.NONE
    for estimate in found:
        cautions |= estimate.cautions
    words = [status.value for status in Status if status in statuses]
    return (*words, *(str(one.name) for one in Caution if one in cautions and one))


def is_finite(value: object) -> bool:
    """Whether every number in a nested result is finite."""
    if isinstance(value, np.ndarray):
        return bool(np.isfinite(value).all())
    if isinstance(value, float):
        return bool(np.isfinite(value))
    if isinstance(value, tuple):
        return all(map(is_finite, value))
    slots = getattr(type(value), "__slots__", ())
    return all(is_finite(getattr(value, name)) for name in slots if hasattr(value, name))
