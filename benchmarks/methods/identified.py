"""One signal through one method's online identification."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from benchmarks.methods.alarm import Alarm, alarms_of
from benchmarks.row import Method, Source
from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.signals.needle_signal import NeedleSignal
from identification import DEFAULT, PAPER, DefaultConfig, PaperConfig, Replay, replay

Array = NDArray[np.float64]

IDENTIFIERS: Mapping[Method, DefaultConfig | PaperConfig] = MappingProxyType(
    {"default": DEFAULT, "paper": PAPER}
)
"""By the name they are reported under; one configuration each for every run."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identified:
    """What a method made of a signal; sample k of it is sample ``start + k`` of the run.

    Attributes:
        source: Of the force.
        method: Of the identification (and, of a virtual force, of the sensor).
        start: The first sample it was given: the end of the tare.
        result: Its estimates.
        alarms: The ruptures it reported; their samples count from the run's first.
        force_N: The force it was given, shape (n - start,).
    """

    source: Source
    method: Method
    start: int
    result: Replay
    alarms: tuple[Alarm, ...]
    force_N: Array

    @property
    def enhanced_N(self) -> Array:
        """Its enhanced force, shape (n - start,)."""
        return np.array([estimate.enhanced_force_N for estimate in self.result.estimates])

    @property
    def tip_N(self) -> Array:
        """Its tip force, shape (n - start,)."""
        return np.array([estimate.tip_force_N for estimate in self.result.estimates])


def identify(
    signal: NeedleSignal,
    truth: InsertionTruth,
    method: Method,
    config: DefaultConfig | PaperConfig | None = None,
) -> Identified:
    """Feed a method from the end of the tare to the end of the run.

    `default` finds first contact by itself. `paper` assumes it known, and is told: the one thing
    of the truth that an identifier sees here.
    """
    start = int(np.searchsorted(truth.t_s, truth.tare_end_s))
    config = IDENTIFIERS[method] if config is None else config
    if isinstance(config, PaperConfig):
        touch = float(np.interp(truth.contact_s, truth.t_s, signal.depth_m))
        config = replace(config, contact_depth_m=touch)
    result = replay(
        signal.t_s[start:],
        signal.depth_m[start:],
        signal.force_N[start:],
        signal.speed_m_s[start:],
        config,
    )
    alarms = alarms_of(result, truth.t_s[start:])
    return Identified(
        source=signal.source,
        method=method,
        start=start,
        result=result,
        alarms=tuple(alarm._replace(sample=alarm.sample + start) for alarm in alarms),
        force_N=signal.force_N[start:],
    )
