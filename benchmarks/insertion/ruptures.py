"""Ruptures, and friction of each layer, as reported, against the truth."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.insertion.methods import Alarm
from groundtruth import Rupture
from groundtruth.rupture_match import EARLY_s, LATE_s, nearest_pairs
from identification import LayerEstimate

VISIBLE_N = 0.15
"""A true transition counts as a rupture when the true force drops by more than this,
whatever the noise of who looks for it; below it is a soft transition. The least drop of
ruptures in real liver (0.15 to 1.4 N); half that of the 25 % gel, the softest of the
published tissues."""


def is_visible(rupture: Rupture) -> bool:
    """Whether a true transition counts as a rupture."""
    return rupture.visible_drop_N > VISIBLE_N


Matching = tuple[list[tuple[Rupture, Alarm]], list[Rupture], list[Alarm]]
"""Pairs of a true rupture and its alarm, in the order of the ruptures; ruptures without
an alarm; alarms without a rupture."""


def match(ruptures: Sequence[Rupture], alarms: Sequence[Alarm]) -> Matching:
    """Give each alarm to at most one true rupture, nearest first.

    The other way round likewise. An alarm may belong to a rupture when it lies within
    `rupture_match.EARLY_s` before and `LATE_s` after its onset.
    """
    onsets_s = [rupture.onset_s for rupture in ruptures]
    pairs = nearest_pairs(onsets_s, [alarm.alarm_s for alarm in alarms])
    used = set(pairs.values())
    return (
        [(ruptures[i], alarms[pairs[i]]) for i in sorted(pairs)],
        [rupture for i, rupture in enumerate(ruptures) if i not in pairs],
        [alarm for j, alarm in enumerate(alarms) if j not in used],
    )


class LayerFriction(NamedTuple):
    """Friction of one layer at its rupture.

    Attributes:
        true_N: On the shaft.
        estimated_N: estimated; 0 when its rupture was missed.
        std_N: Stated standard deviation; nan when none is stated.
    """

    true_N: float
    estimated_N: float
    std_N: float

    @property
    def error(self) -> float:
        """Relative error."""
        return abs(self.estimated_N - self.true_N) / self.true_N


def layer_frictions(
    ruptures: Sequence[Rupture], alarms: Sequence[Alarm], *, online: bool = False
) -> list[LayerFriction]:
    """Pair every layer with what was identified of it.

    It counts as identified at the end or, `online`, in the next layer. A layer ends at
    its rupture. What is identified by alarms since the layer before it (a surface
    membrane's, a false one's) counts for it: that much friction was taken off the
    force. A layer that ends softly counts together with the one after it, since the
    force does not separate them; one whose rupture was missed counts as estimated at
    zero.
    """
    frictions: list[LayerFriction] = []
    true_N = 0.0
    begin_s = -math.inf
    for k, rupture in enumerate(ruptures):
        true_N += rupture.layer_friction_N
        if rupture.layer == 0 or not is_visible(rupture):
            continue
        following = (
            ruptures[k + 1].onset_s - EARLY_s if k + 1 < len(ruptures) else math.inf
        )
        until_s = max(min(rupture.onset_s + LATE_s, following), rupture.end_s)
        mine = [alarm for alarm in alarms if begin_s < alarm.alarm_s <= until_s]
        was_seen = any(alarm.alarm_s >= rupture.onset_s - EARLY_s for alarm in mine)
        known = [alarm.online if online else alarm.layer for alarm in mine]
        frictions.append(_layer_friction(true_N, known if was_seen else []))
        if was_seen:
            begin_s = until_s
        true_N = 0.0
    return frictions


def _layer_friction(
    true_N: float, identified: Sequence[LayerEstimate | None]
) -> LayerFriction:
    """Return the sum of what was identified of a layer, and its deviation."""
    layers = [layer for layer in identified if layer is not None]
    known = [
        layer.friction_std_N for layer in layers if layer.friction_std_N is not None
    ]
    is_stated = bool(layers) and len(known) == len(layers)
    std_N = math.hypot(*known) if is_stated else math.nan
    return LayerFriction(true_N, sum(layer.friction_N for layer in layers), std_N)


def friction_metrics(
    frictions: Sequence[LayerFriction], when: str = ""
) -> dict[str, float]:
    """Return worst and mean relative error, and how often stated deviations hold.

    `when` is part of the names: ``_online`` for what was known in the layer after. The
    coverage is the fraction of layers within twice the stated standard deviation;
    layers that were not identified state none and do not count there.
    """
    if not frictions:
        return {}
    errors = [100.0 * layer.error for layer in frictions]
    values = {
        f"friction_error{when}_worst_pct": max(errors),
        f"friction_error{when}_mean_pct": float(np.mean(errors)),
    }
    stated = [layer for layer in frictions if not math.isnan(layer.std_N)]
    if stated:
        inside = [
            abs(layer.estimated_N - layer.true_N) <= 2.0 * layer.std_N
            for layer in stated
        ]
        values[f"friction_coverage{when}_2sigma"] = float(np.mean(inside))
    return values
