"""What the numbers should be, and what has become worse; all of it is data.

`judged.toml` says what is measured and how it is judged, in the fields of `Metric`,
`Target` and `KeptFigure`.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np
import pandas as pd

from groundtruth import SCENARIOS
from groundtruth.scenarios import RANDOM_STACK

COLUMNS = (
    "scenario",
    "plant",
    "seed",
    "source",
    "method",
    "metric",
    "value",
    "unit",
)
"""Of a file, and of every frame of results."""
KEYS = list(COLUMNS[:6])
"""All but value and unit: what makes rows of two runs comparable."""
TISSUE = tuple(name for name, item in SCENARIOS.items() if item.layers)
JUDGED_TOGETHER: Mapping[str, tuple[str, ...]] = {
    "tissue": TISSUE,
    "gels": tuple(name for name in TISSUE if name.startswith("gel-")),
    "stacks": tuple(name for name in TISSUE if name.startswith("stack-")),
    "random": (RANDOM_STACK,),
}
"""Scenarios that are judged together, by name."""
UNITS = {
    "_Ns_per_m": "Ns/m",
    "_mm_per_rad": "mm/rad",
    "_N": "N",
    "_Nm": "Nm",
    "_mJ": "mJ",
    "_mm": "mm",
    "_us": "us",
    "_ms": "ms",
    "_s": "s",
    "_pct": "%",
    "_voxel": "voxel",
}
"""By the end of a metric's name; one that ends otherwise is a fraction or a count."""
Statistic = Literal["worst", "mean", "median", "p90", "max", "sum", "deviation"]
"""What is said of all runs; ``p90`` is the worst of the best 90 %, ``deviation`` the
standard deviation."""
ANY = "any"
"""As the source of a target: every source."""
UNDEFINED = "rupture_precision"
"""The one metric of which nan is a result: without an alarm there is no precision."""
FAILURES = ("worse", "missing", "not finite")
"""Changes for which a comparison fails."""


class Metric(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One kind of number.

    Attributes:
        meaning: One line.
        best: The value wished for: 0 for an error, 1 for a recall, 0.95 for a coverage.
        tolerance: Absolute worsening that is not called a regression, in the metric's
            unit.
        relative_tolerance: The same as a fraction of the old distance from ``best``;
            the larger of the two counts. 1 marks a number shown for reference, by
            which nothing is judged.
    """

    meaning: str
    best: float = 0.0
    tolerance: float = 0.0
    relative_tolerance: float = 0.0


class Target(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits for one metric over the runs it applies to; all are for ours.

    Attributes:
        what: One line for people.
        metric: Its name.
        plant: The plant model it applies to.
        scenarios: Names, patterns of names or groups of scenarios; none for all.
        source: See `benchmarks.jobs.Source`; ``any`` for all.
        at_least: Lower limit, in the metric's unit.
        at_most: Upper limit.
        statistic: What of all runs must keep the limits.
        of_published: Whether the limits are for the ratio to ``published-one-setting``
            in the same run.
        where_reported: Whether runs in which that has no such number are left out.
    """

    what: str
    metric: str
    plant: str
    scenarios: tuple[str, ...] = ()
    source: str = "virtual"
    at_least: float = -math.inf
    at_most: float = math.inf
    statistic: Statistic = "worst"
    of_published: bool = False
    where_reported: bool = False

    def is_met_by(self, value: float) -> bool:
        """Whether a value keeps the limits; one that is not finite does not."""
        return math.isfinite(value) and self.at_least <= value <= self.at_most


class KeptFigure(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A figure that `benchmarks.headline` keeps.

    Attributes:
        metric: Its name; the best value says which way is worse.
        sources: The forces it is measured on.
        statistic: What of the insertions makes one figure.
        what: For people.
        tolerance: What rounding and other versions of libraries may change on the same
            seeds, in the metric's unit.
        relative_tolerance: The same as a fraction of the distance from the best value.
    """

    metric: str
    sources: tuple[str, ...]
    statistic: Statistic
    what: str
    tolerance: float = 0.0
    relative_tolerance: float = 0.0


class _Judged(msgspec.Struct, forbid_unknown_fields=True):
    """What `judged.toml` holds."""

    headline: tuple[KeptFigure, ...]
    metrics: dict[str, dict[str, Metric]]
    targets: dict[str, list[Target]]


_JUDGED = msgspec.toml.decode(
    Path(__file__).with_name("judged.toml").read_bytes(), type=_Judged
)
TABLES = _JUDGED.metrics
"""Metrics by name, in the tables that show them."""
METRICS = {name: item for table in TABLES.values() for name, item in table.items()}
TARGETS = tuple(target for family in _JUDGED.targets.values() for target in family)
KEPT_FIGURES = _JUDGED.headline


def unit_of(metric: str) -> str:
    """Return the unit of a metric; ``1`` for none."""
    ends = [end for end in UNITS if metric.endswith(end)]
    return UNITS[max(ends, key=len)] if ends else "1"


def expand_groups(names: Iterable[str]) -> tuple[str, ...]:
    """Return scenarios and patterns of scenarios, groups written out."""
    return tuple(item for name in names for item in JUDGED_TOGETHER.get(name, (name,)))


def select(
    frame: pd.DataFrame, scenarios: Sequence[str] = (), **wanted: str
) -> pd.DataFrame:
    """Return the rows whose columns have these values, of some scenarios or of all."""
    is_chosen = pd.Series(True, index=frame.index)
    for column, value in wanted.items():
        is_chosen &= frame[column] == value
    if scenarios:
        patterns = expand_groups(scenarios)
        is_chosen &= frame["scenario"].map(
            lambda name: any(fnmatchcase(str(name), pattern) for pattern in patterns)
        )
    return frame[is_chosen]


def sum_up(values: pd.Series, statistic: Statistic, badness: pd.Series) -> float:
    """Return a statistic of values; nan if one is not finite.

    Args:
        values: One per run.
        statistic: Which.
        badness: Is larger for a worse value, one per run.
    """
    if values.empty or not np.isfinite(values).all():
        return math.nan
    if statistic in ("worst", "p90"):
        ordered = values.iloc[np.argsort(badness.to_numpy(), kind="stable")]
        # Of ten runs the ninth: rounding must not make it the tenth.
        fraction = 0.9 if statistic == "p90" else 1.0
        return float(ordered.iloc[math.ceil(fraction * len(values) - 1e-9) - 1])
    return float(values.agg("std" if statistic == "deviation" else statistic))


def evaluate(frame: pd.DataFrame, targets: Sequence[Target] = TARGETS) -> pd.DataFrame:
    """Judge every target that any of the results belongs to.

    Returns:
        A row for each, those missed first: ``what``, ``at_least``, ``at_most``, the
        ``value`` that is judged, how many ``runs``, whether it is ``met``, and the
        ``worst`` run.
    """
    evaluations = []
    for target in targets:
        judged = judge_runs(frame, target)
        if judged.empty:
            continue
        beyond = np.fmax(
            judged["value"] - target.at_most, target.at_least - judged["value"]
        )
        beyond = beyond.where(np.isfinite(judged["value"]), math.inf)
        value = sum_up(judged["value"], target.statistic, beyond)
        worst = judged.loc[beyond.idxmax()]
        evaluations.append(
            {
                "what": target.what,
                "at_least": target.at_least,
                "at_most": target.at_most,
                "value": value,
                "runs": len(judged),
                "met": target.is_met_by(value),
                "worst": f"{worst['scenario']}, seed {worst['seed']}",
            }
        )
    table = pd.DataFrame(
        evaluations,
        columns=["what", "at_least", "at_most", "value", "runs", "met", "worst"],
    )
    return table.sort_values("met", kind="stable", ignore_index=True)


def judge_runs(frame: pd.DataFrame, target: Target) -> pd.DataFrame:
    """Return the rows that a target looks at, with what it judges as their value.

    That is the number, or its ratio to the published method's. A value that is
    undefined by its metric's definition does not count unless all are.
    """
    same = select(frame, target.scenarios, metric=target.metric, plant=target.plant)
    if target.source != ANY:
        same = same[same["source"] == target.source]
    judged = same[same["method"] == "ours"]
    if target.of_published:
        run = ["scenario", "plant", "seed", "source"]
        published = same[same["method"] == "published-one-setting"]
        how = "inner" if target.where_reported else "left"
        judged = judged.merge(published, on=run, how=how, suffixes=("", "_published"))
        theirs = judged["value_published"].replace(0.0, math.nan)
        judged = judged.assign(value=judged["value"] / theirs)
    defined = judged.dropna(subset="value")
    return defined if target.metric == UNDEFINED and len(defined) else judged


def compare(old: pd.Series, new: pd.Series, kinds: pd.DataFrame) -> pd.DataFrame:
    """Compare two measurements, number by number; the old ones first.

    What is missing or not finite later is a failure, whatever it was before; only a
    number that its metric leaves undefined may stay so.

    Args:
        old: Earlier values, by what they are of.
        new: Later values.
        kinds: `best`, `tolerance` and `relative_tolerance` of the numbers, and whether
            they are `undefined`; a number that has none must not change at all.

    Returns:
        Old and new value, by how much it may be worse (``allowed``), and what became
        of it (``change``): same, better, new, or one of `FAILURES`.
    """
    every = old.index.append(new.index.difference(old.index, sort=False))
    before = old.reindex(every)
    after = new.reindex(every)
    kinds = kinds.reindex(every)
    best = kinds["best"].fillna(before)
    allowed = np.fmax(
        kinds["tolerance"].fillna(0.0),
        kinds["relative_tolerance"].fillna(0.0) * (before - best).abs(),
    )
    worsening = (after - best).abs() - (before - best).abs()
    # 0.95 - 0.90 is larger than 0.05 by a rounding.
    rounding = 1e-9 * (before.abs() + after.abs() + best.abs())
    stays_undefined = kinds["undefined"].eq(True) & before.isna() & after.isna()
    change = np.select(
        [
            ~every.isin(new.index),
            ~np.isfinite(after) & ~stays_undefined,
            ~every.isin(old.index),
            stays_undefined,
            ~np.isfinite(before),
            worsening.abs() <= allowed + rounding,
            worsening > 0.0,
        ],
        ["missing", "not finite", "new", "same", "better", "same", "worse"],
        "better",
    )
    columns = {"old": before, "new": after, "allowed": allowed, "change": change}
    return pd.DataFrame(columns, index=every)


def compare_results(old: pd.DataFrame, new: pd.DataFrame) -> pd.DataFrame:
    """Compare two frames of results; rows are matched by all but value and unit."""
    before = old.set_index(KEYS)["value"]
    after = new.set_index(KEYS)["value"]
    every = before.index.union(after.index)
    metrics = pd.DataFrame.from_dict(
        {name: msgspec.structs.asdict(item) for name, item in METRICS.items()}, "index"
    )
    metrics["undefined"] = metrics.index == UNDEFINED
    kinds = metrics.reindex(every.get_level_values("metric")).set_index(every)
    return compare(before, after, kinds)
