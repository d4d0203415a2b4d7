"""The tick that identifies a layer just left anew: what it costs after short and long layers."""

from dataclasses import replace
from time import perf_counter_ns

import numpy as np

from groundtruth import Scenario, insert_needle
from groundtruth.materials import TABLE_I_SPEED_M_S, gel
from groundtruth.motion import constant_motion
from identification import DefaultConfig, Identifier, PaperConfig

NS_PER_US = 1e3
SHORT_S, LONG_S = 10.0, 60.0
"""Time spent in the layer; at 1 kHz."""
REPEATS = 5
"""Insertions of each kind: the median is free of whatever else the machine did."""


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
    """Time of the slowest tick from the alarm until the layer is identified [us].

    Of `REPEATS` insertions the median.

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
    return float(np.median([_slowest_us(samples, config) for _ in range(REPEATS)]))


def _slowest_us(
    samples: list[tuple[float, float, float]], config: DefaultConfig | PaperConfig
) -> float:
    identifier, slowest, since_alarm = Identifier(config), 0.0, 0.0
    for sample in samples:
        before = perf_counter_ns()
        found = identifier.update(*sample, 1e-3)
        taken = (perf_counter_ns() - before) / NS_PER_US
        # Work done between the alarm and the identification is part of it.
        since_alarm = taken if found.rupture is not None else max(since_alarm, taken)
        if found.compensated is not None:
            slowest, since_alarm = max(slowest, since_alarm), 0.0
    return slowest
