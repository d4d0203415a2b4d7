"""Every figure this toolkit has set itself, in one place."""

import math
from dataclasses import dataclass
from typing import Literal

from benchmarks.row import Row
from benchmarks.verdict.scenario_groups import TISSUE

Statistic = Literal["worst", "mean", "median"]
"""What of all runs must keep the limits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Target:
    """Limits for one metric over the runs it applies to.

    Attributes:
        what: One line for people.
        metric: A name of `benchmarks.metrics.metric_catalogue`.
        plant: The plant it applies to.
        scenarios: The benchmarks it applies to; None for all.
        source: See `Source`.
        method: See `Method`.
        at_least: Lower limit, in the metric's unit.
        at_most: Upper limit.
        statistic: See `Statistic`.
        of_paper: The limits are for the ratio to ``paper`` in the same run.
        where_paper_tells: Runs in which ``paper`` has no such number are left out.
    """

    what: str
    metric: str
    plant: str
    scenarios: tuple[str, ...] | None = None
    source: str = "virtual"
    method: str = "default"
    at_least: float = -math.inf
    at_most: float = math.inf
    statistic: Statistic = "worst"
    of_paper: bool = False
    where_paper_tells: bool = False

    def applies_to(self, row: Row) -> bool:
        """Whether the row is one of those judged."""
        named = self.scenarios is None or row.scenario in self.scenarios
        wanted = (self.metric, self.plant, self.source, self.method)
        return named and (row.metric, row.plant, row.source, row.method) == wanted

    def is_met_by(self, value: float) -> bool:
        """Whether a value keeps the limits; one that is not finite does not."""
        return math.isfinite(value) and self.at_least <= value <= self.at_most


PANDA_RESIDUAL_Nm = (0.37, 0.76, 0.37, 0.39, 0.14, 0.10, 0.06)
"""Known-good rms residuals of the recorded Panda, given with two decimals, which seem cut rather
than rounded: the same observer's read 0.380, 0.762, 0.376, 0.391, 0.145, 0.102, 0.064 Nm."""
LAST_DIGIT_Nm = 0.01

TARGETS: tuple[Target, ...] = (
    Target(
        what="textbook arm: residual against the ideal filter",
        metric="residual_rms_Nm",
        plant="textbook",
        at_most=1e-4,
    ),
    Target(
        what="realistic arm: axial force, each tissue",
        metric="wrench_rmse_N",
        plant="realistic",
        scenarios=TISSUE,
        at_most=0.05,
    ),
    Target(
        what="realistic arm: standard deviation to be believed, all runs together",
        metric="wrench_coverage_2sigma",
        plant="realistic",
        scenarios=TISSUE,
        at_least=0.90,
        at_most=0.99,
        # One run has one offset error: nearly all of its samples are inside, or nearly none.
        statistic="mean",
    ),
    Target(
        what="hard arm: axial force, each tissue",
        metric="wrench_rmse_N",
        plant="hard",
        scenarios=TISSUE,
        at_most=0.12,
    ),
    Target(
        what="hard arm: axial force as a share of the paper's method, each tissue",
        metric="wrench_rmse_N",
        plant="hard",
        scenarios=TISSUE,
        at_most=0.5,
        of_paper=True,
    ),
    *(
        Target(
            what=f"real Panda: rms residual of joint {joint}",
            metric=f"residual_rms_J{joint}_Nm",
            plant="recording",
            scenarios=("panda-real",),
            at_most=known + LAST_DIGIT_Nm,
        )
        for joint, known in enumerate(PANDA_RESIDUAL_Nm, 1)
    ),
    Target(
        what="real UR10e: weight with one fitted torque scale",
        metric="weight_error_pct",
        plant="recording",
        scenarios=("ur10e-payload",),
        at_least=-10.0,
        at_most=10.0,
    ),
)

OBSERVER_COST_RATIO = 2.0
"""Most an observer tick may cost, in times of the bare Pinocchio calls it needs."""
SENSOR_COST_RATIO = 3.0
"""The same of a full sensor tick."""
CHAIN_COST_RATIO = 5.0
"""The same of a tick of the whole chain, in times of what the sensor needs."""
RERUN_COST_RATIO = 60.0
"""The same of the tick that identifies a layer anew, after 60 s in the layer."""
SOAK_COST_SHARE = 1.1
"""Most a tick may cost after a million, in times of one at the start."""
SOAK_GROWTH_KB = 100.0
"""Most that Python may hold more after a million ticks: a tenth of a byte a tick. What is left of
layers found meanwhile and of caches that fill late is below it."""
