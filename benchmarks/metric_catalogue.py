"""Every metric a row may carry. A new metric is a line here and a function that measures it."""

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass
from types import MappingProxyType
from typing import NamedTuple

from benchmarks.errors import UnknownMetricError
from benchmarks.rows import Method, Row, Source

# What a metric means, and which change of it is a change for the worse.


UNITS = {
    "_Ns_per_m": "Ns/m",
    "_Nm": "Nm",
    "_N": "N",
    "_mm": "mm",
    "_ms": "ms",
    "_pct": "%",
}
"""By the end of a metric's name; a name that ends otherwise is that of a share or a number."""


@dataclass(frozen=True, slots=True)
class Metric:
    """One kind of number.

    Attributes:
        name: As in the results; ends with its unit where it has one, see `UNITS`.
        meaning: One line.
        best: The value wished for: 0 for an error, 1 for a recall, 0.95 for a coverage.
        tolerance: Absolute worsening that is not called a regression, in the metric's unit.
        relative_tolerance: The same as a share of the old distance from ``best``; the larger of
            the two counts.
    """

    name: str
    meaning: str
    _: KW_ONLY
    best: float = 0.0
    tolerance: float = 0.0
    relative_tolerance: float = 0.05

    @property
    def unit(self) -> str:
        """As in the results; ``1`` for none."""
        return next((unit for end, unit in UNITS.items() if self.name.endswith(end)), "1")

    def worsening(self, old: float, new: float) -> float:
        """How much farther from ``best`` the new value is; negative when it is nearer."""
        return abs(new - self.best) - abs(old - self.best)

    def is_regression(self, old: float, new: float) -> bool:
        """Whether the new value is worse beyond tolerance; a number that is not finite always."""
        if not (math.isfinite(old) and math.isfinite(new)):
            return not math.isfinite(new)
        allowed = max(self.tolerance, self.relative_tolerance * abs(old - self.best))
        return self.worsening(old, new) > allowed


def yardstick(name: str, meaning: str) -> Metric:
    """A number to lay beside others, by which nothing is judged: it may double unnoticed."""
    return Metric(name, meaning, relative_tolerance=1.0)


# The metrics of online identification; `metric_catalogue` lists them with the rest.


IDENTIFICATION = (
    Metric(
        "friction_error_worst_pct",
        "error of the shaft friction of a layer at its rupture, worst layer, as known at the end",
        tolerance=0.5,
    ),
    Metric("friction_error_mean_pct", "the same, mean over layers", tolerance=0.5),
    Metric(
        "friction_coverage_2sigma",
        "share of layers whose friction lies within twice the stated standard deviation",
        best=0.95,
        tolerance=0.05,
    ),
    Metric(
        "friction_error_online_worst_pct",
        "error of that friction as identified in the layer after it, worst layer",
        tolerance=0.5,
    ),
    Metric("friction_error_online_mean_pct", "the same, mean over layers", tolerance=0.5),
    Metric(
        "friction_coverage_online_2sigma",
        "share of layers within twice the standard deviation stated there",
        best=0.95,
        tolerance=0.05,
    ),
    Metric(
        "exit_residue_pct",
        "mean |enhanced force| after the last exit, of the uncompensated force there",
        tolerance=0.5,
    ),
    Metric(
        "enhanced_rmse_N",
        "rms error of the enhanced force from the first compensation to the deepest point",
        tolerance=2e-3,
    ),
    Metric("tip_rmse_N", "rms error of the tip force over the same time", tolerance=2e-3),
    Metric(
        "rupture_recall",
        "share of true ruptures that were reported",
        best=1.0,
        tolerance=1e-3,
        relative_tolerance=0.0,
    ),
    Metric(
        "rupture_precision",
        "share of reported ruptures that are true",
        best=1.0,
        tolerance=1e-3,
        relative_tolerance=0.0,
    ),
    Metric(
        "soft_transition_recall",
        "share reported of true transitions whose force drop is below five times the noise",
        best=1.0,
        tolerance=1e-3,
    ),
    Metric("rupture_delay_ms", "alarm after the onset of the release, median", tolerance=2.0),
    Metric(
        "rupture_dating_error_ms",
        "error of the estimated instant of rupture, median",
        tolerance=2.0,
    ),
    Metric(
        "rupture_overshoot_mm",
        "travel of the tip from the onset of the release to the alarm, median",
        tolerance=5e-3,
    ),
)
"""Of a simulated insertion; one column each in the table of identification."""

BOUNDS = (
    yardstick(
        "friction_bound_pct",
        "least mean error of the friction of a layer that the noise allows (Cramér-Rao)",
    ),
    yardstick("friction_bound_white_pct", "the same, were noise of that size white"),
    yardstick(
        "rupture_delay_bound_ms",
        "least mean delay at one false alarm an hour (Lorden), median over ruptures",
    ),
)
"""What a simulated insertion and its noise would have allowed; no property of a method."""

TABLE_I = (
    yardstick("cumulative_friction_true_Ns_per_m", "B d of a single gel, true"),
    yardstick("cumulative_friction_offline_Ns_per_m", "B d of a single gel, identified offline"),
    yardstick("cumulative_friction_online_Ns_per_m", "B d of a single gel, identified online"),
)
"""Figures to lay beside the paper's Table I; how good they are, `friction_error_*` tells."""

OFFLINE = tuple(
    Metric(
        f"offline_rmse_{model}_N",
        f"rms of what the {text} model leaves of an insertion, fitted offline",
        tolerance=2e-3,
    )
    for model, text in (("ml", "multi-layer"), ("kv", "Kelvin-Voigt"))
)
"""The models themselves, as in Figures 2 and 3: nothing online enters."""

REAL_TISSUE = (
    *(
        Metric(
            f"pullout_error{where}_{name}_pct",
            f"friction told{text} against the pull-out force, {which}",
            tolerance=0.5,
        )
        for where, text in (
            ("", " at 42 and 78 mm"),
            ("_42mm", " at 42 mm"),
            ("_78mm", " at 78 mm"),
        )
        for name, which in (("median", "median"), ("p90", "90th percentile"))
    ),
    yardstick("ruptures_per_insertion", "ruptures reported per insertion"),
    yardstick(
        "falls_per_insertion",
        "falls of the force by 0.15 N within 2 mm, found offline, per insertion",
    ),
    Metric("fall_recall", "share of these falls with an alarm", best=1.0, tolerance=0.02),
    Metric(
        "ruptures_at_falls",
        "share of alarms where the force falls by five times its noise",
        best=1.0,
        tolerance=0.02,
    ),
    Metric(
        "enhanced_against_ft_rmse_N",
        "rms difference of the enhanced force from that told by the same method on F/T",
        tolerance=0.02,
    ),
    Metric("ruptures_missed", "annotated ruptures without an alarm"),
    Metric("ruptures_false", "alarms without an annotated rupture"),
    Metric("ruptures_without_fall", "alarms where the force does not fall by five times its noise"),
    Metric(
        "rupture_depth_error_mm",
        "worst distance of the alarm from the annotated depth",
        tolerance=0.05,
    ),
    Metric(
        "rupture_dated_depth_error_mm",
        "worst distance of the estimated depth of rupture from the annotated one",
        tolerance=0.05,
    ),
)
"""Of recordings of real tissue."""

LIVER_LIMIT = (
    *(
        yardstick(
            f"pullout_left_out_{name}_{share}_pct",
            f"pull-out force of an unseen insertion from {text}, {which}",
        )
        for name, text in (
            ("depth", "depth alone"),
            ("force", "depth and force"),
            ("told", "depth and friction told"),
            ("few", "the best features"),
            ("ridge", "all features, ridge"),
            ("gp_few", "the best features, Gaussian process"),
            ("gp", "all features, Gaussian process"),
        )
        for share, which in (("median", "median error"), ("p90", "90th percentile"))
    ),
    yardstick(
        "pullout_above_insertion_share",
        "share of insertions whose pull-out force at 20 mm exceeds all of the insertion's",
    ),
    yardstick(
        "pullout_over_insertion_most",
        "largest pull-out force at 20 mm as a share of the insertion force there",
    ),
    *(
        yardstick(f"pullout_{name}_{share}_pct", f"{text}, {which}")
        for name, text in (
            ("shallower_peak", "largest pull-out force at 60 to 78 mm above that at 78 mm"),
            ("neighbour", "difference of the pull-out force from the next insertion's"),
        )
        for share, which in (("median", "median"), ("p90", "90th percentile"))
    ),
)
"""Of real liver itself: what could be known, and how far its yardstick is to be trusted."""


# Axial force against the true one, from first contact to the end of withdrawal.
_WRENCH = (
    Metric("wrench_rmse_N", "rms error of the axial force", tolerance=1e-3),
    Metric("wrench_bias_N", "mean error", tolerance=5e-3),
    Metric(
        "wrench_lag_ms", "time shift that best aligns the estimate with the truth", tolerance=2.0
    ),
    Metric(
        "wrench_coverage_2sigma",
        "share of samples whose error lies within twice the stated standard deviation",
        best=0.95,
        tolerance=0.02,
    ),
)

_RESIDUAL = (
    Metric(
        "residual_rms_Nm",
        "residual against the ideal filter of the true torque, worst joint",
        tolerance=1e-6,
    ),
    *(
        Metric(
            f"residual_rms_J{joint}_Nm",
            f"rms residual of joint {joint} without contact",
            tolerance=5e-3,
        )
        for joint in range(1, 8)
    ),
)

_OBSERVERS = tuple(
    Metric(
        f"observer_{name}_rmse_N",
        f"noise and lag of the {meaning}, at its best setting",
        tolerance=1e-3,
    )
    for name, meaning in (
        ("momentum", "momentum observer"),
        ("smoothed", "momentum observer with smoothed momentum"),
        ("kalman", "Kalman observer"),
    )
)

_WEIGHT = (
    Metric("force_up_unloaded_N", "mean vertical force without payload, truth 0", tolerance=0.1),
    Metric("force_up_unloaded_std_N", "scatter of that force over the recording", tolerance=0.1),
    Metric("force_up_loaded_N", "mean vertical force with the payload", best=-27.5, tolerance=0.1),
    Metric("force_up_loaded_std_N", "scatter of that force over the recording", tolerance=0.1),
    Metric(
        "torque_scale",
        "common factor on all joint torques, fitted on the first half",
        best=1.0,
        tolerance=0.01,
    ),
    Metric(
        "weight_error_pct",
        "error of the weight over the second half with that factor",
        tolerance=0.2,
    ),
)

METRICS: Mapping[str, Metric] = MappingProxyType(
    {
        metric.name: metric
        for metric in (
            *_WRENCH,
            *_RESIDUAL,
            *_OBSERVERS,
            *_WEIGHT,
            *IDENTIFICATION,
            *BOUNDS,
            *TABLE_I,
            *OFFLINE,
            *REAL_TISSUE,
            *LIVER_LIMIT,
        )
    }
)
"""By name."""


def metric(name: str) -> Metric:
    """The metric of that name.

    Raises:
        UnknownMetricError: There is none.
    """
    try:
        return METRICS[name]
    except KeyError:
        raise UnknownMetricError(f"no metric {name!r}; known: {', '.join(METRICS)}") from None


# A number before it is known which job it belongs to.


class Measurement(NamedTuple):
    """One measured number.

    Attributes:
        source: See `Source`.
        method: See `Method`.
        metric: A name of `benchmarks.metric_catalogue`.
        value: The number.
    """

    source: Source
    method: Method
    metric: str
    value: float

    def row(self, scenario: str, plant: str, seed: int) -> Row:
        """The row of a job's results.

        Raises:
            UnknownMetricError: The catalogue does not list the metric.
        """
        return Row(
            scenario=scenario,
            plant=plant,
            seed=seed,
            source=self.source,
            method=self.method,
            metric=self.metric,
            value=float(self.value),
            unit=metric(self.metric).unit,
        )
