"""Every limit this toolkit has set itself, from `targets.csv`, and the published numbers.

Columns of the file: `metric`, `plant` and `source` as in the results; `scenarios` are names or
groups (`GROUPS`), none for all; `at_least` and `at_most` are limits in the metric's unit;
`statistic` of all runs must keep them; `relative_to` says that they hold for the ratio to the
published method in the same run (``published where reported``: a run in which that method has no
such number is left out); `what` is one line for people. All targets are for the method ``default``.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal, NamedTuple

from benchmarks.metrics import metric, table_lines
from benchmarks.rows import Row
from groundtruth import SCENARIOS
from groundtruth.scenarios import RANDOM_STACK

TISSUE = tuple(item.id for item in SCENARIOS.values() if item.layers)
GELS = tuple(name for name in TISSUE if name.startswith("gel-"))
"""Single gels, those of Table I."""
STACKS = tuple(name for name in TISSUE if name.startswith("stack-"))
GROUPS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"tissue": TISSUE, "gels": GELS, "stacks": STACKS, "random": (RANDOM_STACK,)}
)
"""Scenarios that are judged together, by name."""

Statistic = Literal["worst", "mean", "median"]
"""What of all runs must keep the limits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Limits for one metric over the runs it applies to."""

    what: str  # one line for people
    metric: str  # a name of `metrics.csv`
    plant: str  # the plant model it applies to
    scenarios: tuple[str, ...] = ()  # the benchmarks it applies to; none for all
    source: str = "virtual"  # see `Source`
    method: str = "default"  # see `Method`
    at_least: float = -math.inf  # lower limit, in the metric's unit
    at_most: float = math.inf  # upper limit
    statistic: Statistic = "worst"  # see `Statistic`
    of_published: bool = False  # the limits are for the ratio to ``published`` in the same run
    where_reported: bool = False  # runs in which ``published`` has no such number are left out

    def applies_to(self, row: Row) -> bool:
        """Whether the row is one of those judged."""
        wanted = (self.metric, self.plant, self.source, self.method)
        named = not self.scenarios or row.scenario in self.scenarios
        return named and (row.metric, row.plant, row.source, row.method) == wanted

    def is_met_by(self, value: float) -> bool:
        """Whether a value keeps the limits; one that is not finite does not."""
        return math.isfinite(value) and self.at_least <= value <= self.at_most

    def excess(self, value: float) -> float:
        """How far a value is beyond the nearer limit, negative inside."""
        if not math.isfinite(value):
            return math.inf
        return max(value - self.at_most, self.at_least - value)

    @property
    def limits(self) -> str:
        """The limits for people, with unit and statistic."""
        unit = "x published" if self.of_published else metric(self.metric).unit
        unit = "" if unit == "1" else f" {unit}"
        statistic = "" if self.statistic == "worst" else f" ({self.statistic})"
        if not math.isfinite(self.at_least):
            return f"≤ {self.at_most:g}{unit}{statistic}"
        if not math.isfinite(self.at_most):
            return f"≥ {self.at_least:g}{unit}{statistic}"
        return f"{self.at_least:g} … {self.at_most:g}{unit}{statistic}"


def _target(line: Mapping[str, str]) -> Target:
    """A line of `targets.csv`."""
    statistic = line["statistic"]
    assert statistic in ("worst", "mean", "median"), line
    names = line["scenarios"].split()
    return Target(
        what=line["what"],
        metric=line["metric"],
        plant=line["plant"],
        scenarios=tuple(each for name in names for each in GROUPS.get(name, (name,))),
        source=line["source"],
        at_least=float(line["at_least"] or -math.inf),
        at_most=float(line["at_most"] or math.inf),
        statistic=statistic,
        of_published=bool(line["relative_to"]),
        where_reported=line["relative_to"] == "published where reported",
    )


TARGETS = tuple(map(_target, table_lines(Path(__file__).with_name("targets.csv"))))

OBSERVER_COST_RATIOS, SENSOR_COST_RATIOS, CHAIN_COST_RATIOS = (2.0, 2.3), (3.0, 4.6), (4.5, 8.0)
"""Most that an update may cost, relative to the bare Pinocchio calls it needs: where the arithmetic
is compiled, and in plain Python."""
ESTIMATED_VELOCITY_COST_RATIO = 5.0
"""The same of a chain that must estimate the velocities, compiled."""
LAYER_COST_RATIO = 60.0
"""Of the update that identifies a layer, after 60 s in the layer."""
SOAK_COST_RATIO = 1.1
"""Most an update may cost after a million, relative to one at the start."""
SOAK_GROWTH_KB = 100.0
"""Most that Python may hold more after a million updates: a tenth of a byte each. What layers found
meanwhile and caches that fill late need is below it."""

PUBLISHED_RMSE_N: Mapping[str, float] = MappingProxyType(
    {"gel-70-constant": 0.2444, "stack-glove-constant": 0.285}
)
"""Ferro et al., Figure 5: virtual against real F/T sensor on a real LWR 4+, by scenario [N]."""


class PublishedFriction(NamedTuple):
    """A line of Table I: mean and spread over both speeds [Ns/m]."""

    offline: int
    offline_spread: int
    online: int
    online_spread: int


TABLE_ONE_Ns_per_m: Mapping[int, PublishedFriction] = MappingProxyType(
    {
        25: PublishedFriction(113, 14, 84, 10),
        50: PublishedFriction(283, 21, 232, 16),
        70: PublishedFriction(534, 56, 481, 37),
    }
)
"""Cumulative friction of single gels, by per cent of isinglass."""
