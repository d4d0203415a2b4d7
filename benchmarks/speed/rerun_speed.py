"""What the dearest of the ticks costs that identify a layer anew, after short and long layers."""

from dataclasses import replace
from time import perf_counter_ns

import numpy as np
from numpy.typing import NDArray

from groundtruth import Scenario, insert_needle
from groundtruth.materials import TABLE_I_SPEED_M_S, gel
from groundtruth.motion import constant_motion
from identification import DefaultConfig, Identifier, PaperConfig

NS_PER_US = 1e3
SHORT_S, LONG_S = 10.0, 60.0
"""Time spent in the layer; at 1 kHz."""
REPEATS = 9
"""Insertions of each kind: the median is free of whatever else a busy machine did."""


def slab(seconds: float) -> Scenario:
    """One gel of such a thickness that the needle is in it for a time [s]."""
    thickness = TABLE_I_SPEED_M_S * seconds
    return Scenario(
        id=f"slab-{seconds:g}s",
        title=f"one 70 % gel, {1e3 * thickness:.0f} mm",
        layers=(replace(gel(70), thickness_m=thickness),),
        motion=constant_motion(
            speed_m_s=TABLE_I_SPEED_M_S, depth_m=thickness + 8e-3, standoff_m=5e-3
        ),
    )


def rerun_us(seconds: float, config: DefaultConfig | PaperConfig) -> float:
    """Time of the slowest tick from the first alarm until the last layer is identified [us].

    Of each tick the median of `REPEATS` equal insertions.

    Args:
        seconds: Time spent in the layer [s].
        config: Settings of the identifier.
    """
    run = insert_needle(slab(seconds), seed=0)
    inside = run.t_s > run.tare_end_s
    samples = list(
        zip(
            run.depth_m[inside].tolist(),
            run.speed_m_s[inside].tolist(),
            run.force_N[inside].tolist(),
            strict=True,
        )
    )
    ticks = [_event_ticks_us(samples, config) for _ in range(REPEATS)]
    # The same work every time: what is slow only once was interrupted.
    return float(np.max(np.median(ticks, axis=0)))


def _event_ticks_us(
    samples: list[tuple[float, float, float]], config: DefaultConfig | PaperConfig
) -> NDArray[np.float64]:
    """Times of the ticks from the first alarm to the last identification, zero elsewhere."""
    identifier, taken_us = Identifier(config), np.zeros(len(samples))
    alarm, last = len(samples), 0
    for k, sample in enumerate(samples):
        before = perf_counter_ns()
        found = identifier.update(*sample, 1e-3)
        taken_us[k] = (perf_counter_ns() - before) / NS_PER_US
        if found.rupture is not None:
            alarm = min(alarm, k)
        if found.compensated is not None:
            last = k
    tick = np.arange(len(samples))
    return np.where((tick >= alarm) & (tick <= last), taken_us, 0.0)
