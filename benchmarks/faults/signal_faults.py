"""Faults of sensors, wires and clocks, injected into a stream of good samples."""

from functools import partial

import numpy as np

from benchmarks.faults.fault import Injection
from benchmarks.faults.fault_stream import FaultStream
from urdf import load_lwr

SHOULDER = 1
"""Joint whose torque carries most of a force along the needle."""


def not_finite(stream: FaultStream, at: int, *, samples: int, value: float) -> FaultStream:
    """One torque is no number for some samples."""
    bent = stream.bent(at, at + samples)
    bent.tau_Nm[at : at + samples, SHOULDER] = value
    return bent


def frozen(stream: FaultStream, at: int, *, samples: int, only_torque: bool) -> FaultStream:
    """The last sample again and again, or only the torque of one joint."""
    bent, part = stream.bent(at, at + samples), slice(at, at + samples)
    if only_torque:
        bent.tau_Nm[part, SHOULDER] = bent.tau_Nm[at - 1, SHOULDER]
        return bent
    for array in (bent.q_rad, bent.dq_rad_s, bent.tau_Nm):
        array[part] = array[at - 1]
    return bent


def lost(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """Samples that never came."""
    return stream.without(at, at + samples)


def jittering_clock(stream: FaultStream, at: int, *, samples: int, std_s: float) -> FaultStream:
    """Time stamps that are off at random."""
    bent = stream.bent(at, at + samples)
    error = np.zeros(len(bent.dt_s) + 1)
    noise = np.random.default_rng(0).normal(scale=std_s, size=samples)
    error[at : at + samples] = np.clip(noise, -0.45e-3, 0.45e-3)
    bent.dt_s[:] += np.diff(error, prepend=0.0)[: len(bent.dt_s)]
    return bent


def repeated_stamps(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """Every tenth time stamp comes twice, and the next one is right again."""
    bent = stream.bent(at, at + samples)
    twice = np.arange(at, at + samples, 10)
    bent.dt_s[twice] = 0.0
    bent.dt_s[twice + 1] += 1e-3
    return bent


def backward_stamp(stream: FaultStream, at: int, *, back_s: float, returns: bool) -> FaultStream:
    """The clock goes back once, and comes forward again or goes on from there."""
    bent = stream.bent(at, at + 1)
    bent.dt_s[at] = -back_s
    if returns:
        bent.dt_s[at + 1] += back_s + 1e-3
    return bent


def spike(
    stream: FaultStream, at: int, *, q_rad: float = 0.0, tau_Nm: float = 0.0, times: int = 1
) -> FaultStream:
    """Single samples that are far off, a tenth of a second apart."""
    where = at + 100 * np.arange(times)
    bent = stream.bent(at, int(where[-1]) + 1)
    bent.q_rad[where, SHOULDER] += q_rad
    bent.tau_Nm[where, SHOULDER] += tau_Nm
    return bent


def saturated(stream: FaultStream, at: int, *, samples: int) -> FaultStream:
    """One torque reads its joint's effort limit."""
    bent = stream.bent(at, at + samples)
    bent.tau_Nm[at : at + samples, SHOULDER] = -load_lwr().effort_limit_Nm[SHOULDER]
    return bent


SIGNAL_FAULTS: dict[str, Injection] = {
    "one torque NaN, 1 sample": partial(not_finite, samples=1, value=np.nan),
    "one torque infinite, 100 ms": partial(not_finite, samples=100, value=np.inf),
    "one torque NaN, 1 s": partial(not_finite, samples=1000, value=np.nan),
    "all signals frozen, 200 ms": partial(frozen, samples=200, only_torque=False),
    "all signals frozen, 2 s": partial(frozen, samples=2000, only_torque=False),
    "one torque frozen, 2 s": partial(frozen, samples=2000, only_torque=True),
    "1 ms lost": partial(lost, samples=1),
    "10 ms lost": partial(lost, samples=10),
    "100 ms lost": partial(lost, samples=100),
    "500 ms lost": partial(lost, samples=500),
    "clock jitter of 0.2 ms, 2 s": partial(jittering_clock, samples=2000, std_s=2e-4),
    "time stamps repeated, 1 s": partial(repeated_stamps, samples=1000),
    "clock 20 ms back and forth": partial(backward_stamp, back_s=0.02, returns=True),
    "clock set back by an hour": partial(backward_stamp, back_s=3600.0, returns=False),
    "position spike of 0.05 rad": partial(spike, q_rad=0.05),
    "torque spike of 30 Nm": partial(spike, tau_Nm=30.0),
    "ten torque spikes of 6 Nm, 1 s": partial(spike, tau_Nm=6.0, times=10),
    "one torque saturated, 500 ms": partial(saturated, samples=500),
}
"""By what was done."""
