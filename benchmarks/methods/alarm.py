"""Ruptures as an identifier reported them, on the run's own clock."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification import LayerEstimate, Replay


class Alarm(NamedTuple):
    """One reported rupture.

    Attributes:
        sample: Index of the sample that raised it.
        alarm_s: Time of that sample.
        dated_s: When the rupture happened, as estimated at last.
        layer: The layer it ended, as known at the end; None if it was never identified.
        online: The same layer as identified in the layer after it, before any later rupture told
            more: what was taken off the force then.
    """

    sample: int
    alarm_s: float
    dated_s: float
    layer: LayerEstimate | None
    online: LayerEstimate | None


def alarms_of(result: Replay, t_s: NDArray[np.float64]) -> list[Alarm]:
    """Every rupture reported, in order.

    Args:
        result: Estimates, one per sample.
        t_s: True instants of the samples, shape (n,).
    """
    by_alarm = {layer.rupture.alarm_s: layer for layer in result.layers}
    online = {
        estimate.compensated.rupture.alarm_s: estimate.compensated
        for estimate in result.estimates
        if estimate.compensated is not None
    }
    found = []
    for k, estimate in enumerate(result.estimates):
        event = estimate.rupture
        if event is None:
            continue
        layer = by_alarm.get(event.alarm_s)
        # The date may have become better since the alarm.
        last = event if layer is None else layer.rupture
        dated_s = float(t_s[k]) - (event.alarm_s - last.time_s)
        found.append(Alarm(k, float(t_s[k]), dated_s, layer, online.get(event.alarm_s)))
    return found


def first_compensation(result: Replay) -> int | None:
    """Index of the sample at which friction was first identified, if ever."""
    is_compensated = (estimate.compensated is not None for estimate in result.estimates)
    return next((k for k, found in enumerate(is_compensated) if found), None)


def cumulative_friction_Ns_per_m(alarms: Iterable[Alarm]) -> float:
    """Sum of B d over the layers left, each at the speed of its rupture, as known at the end."""
    layers = [alarm.layer for alarm in alarms if alarm.layer is not None]
    return sum(layer.friction_N / max(layer.rupture.speed_m_s, 1e-9) for layer in layers)
