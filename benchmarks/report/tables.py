"""The one printer of tables: in the terminal, in the report, on pages of results.

`tables.toml` says which tables a run has. A table has a line for each group of rows;
each of its columns selects rows of the group and sums them up in a cell.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks.insertion.perturbations import PERTURBED
from benchmarks.judging import METRICS, Comparison, evaluate, metric
from benchmarks.report.published_figures import PUBLISHED_RMSE_N, TABLE_ONE_Ns_per_m
from benchmarks.results import KEYS, NAMES, Row

NOTHING = "–"
"""In a cell: there is no such number."""
NOT_FINITE = "not finite"
"""In a cell: a number that should be one is none."""
COLORS = {"met": "green", "missed": "red", NOT_FINITE: "red"}
"""Of cells, by what they say."""
CUMULATIVE = "cumulative_friction_{}_Ns_per_m"
"""Metric of the cumulative friction of a gel, by how it was identified."""
FORCE_ERROR = "wrench_rmse_N"
Frame = Any
"""A pandas.DataFrame with the columns of `Row`; its annotations leave open what a
selection is."""


def new_console() -> Console:
    """Return a console as wide as the terminal, or as every table needs without one."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, 200)
    return console


def met_mark(is_met: bool) -> str:
    """Return the cell that says whether a target is met."""
    return "met" if is_met else "missed"


def show_value(value: float) -> str:
    """Return a number with four digits, a dash for none."""
    return NOTHING if math.isnan(value) else f"{value:.4g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultTable:
    """A table of texts.

    Attributes:
        title: Stands above it.
        heads: Of the columns; a line end breaks the line.
        align: One letter per column: ``r`` right, ``L`` left on one line, ``l`` left.
        lines: Cells of every line.
        caption: Stands below it.
        target_caption: Stands below it as well where targets are shown.
    """

    title: str
    heads: tuple[str, ...]
    align: str
    lines: tuple[tuple[str, ...], ...]
    caption: str = ""
    target_caption: str = ""

    def choose_targets(self, *, are_shown: bool) -> "ResultTable":
        """Return it with or without the columns that say what a number should be.

        Those are the columns headed ``target``.
        """
        if are_shown:
            caption = f"{self.caption} {self.target_caption}".strip()
            return replace(self, caption=caption, target_caption="")
        kept = [k for k, head in enumerate(self.heads) if head != "target"]
        return replace(
            self,
            heads=tuple(self.heads[k] for k in kept),
            align="".join(self.align[k] for k in kept),
            lines=tuple(tuple(line[k] for k in kept) for line in self.lines),
            target_caption="",
        )

    def rich(self) -> Table:
        """Return it for the terminal."""
        table = Table(title=self.title, caption=escape(self.caption) or None)
        for head, align in zip(self.heads, self.align, strict=True):
            side = "right" if align == "r" else "left"
            table.add_column(head, justify=side, no_wrap=align != "l")
        for line in self.lines:
            table.add_row(*(f"[{COLORS[c]}]{c}[/]" if c in COLORS else c for c in line))
        return table

    def markdown(self) -> list[str]:
        """Return it as lines of a page."""
        rule = ("---:" if align == "r" else "---" for align in self.align)
        rows = [[head.replace("\n", " ") for head in self.heads], rule, *self.lines]
        return [
            "| " + " | ".join(row).replace("| missed", "| **missed**") + " |"
            for row in rows
        ]


def frame_of(rows: Iterable[Row]) -> Frame:
    """Return rows as a frame, with the ratios that tables show as further metrics."""
    rows = list(rows)
    columns = {name: [getattr(row, name) for row in rows] for name in NAMES}
    frame = pd.DataFrame(columns, dtype=None if rows else object)
    ours = {"metric": FORCE_ERROR, "source": "virtual", "method": "ours"}
    published = ours | {"method": "published-one-setting"}
    best_gain = ours | {"method": "published-best-gain"}
    online = {"metric": CUMULATIVE.format("online")}
    offline = {"metric": CUMULATIVE.format("offline")}
    change = ratio_of(frame, "online_change", online, offline)
    return pd.concat(
        [
            frame,
            ratio_of(frame, "wrench_rmse_ratio", ours, published),
            ratio_of(frame, "wrench_best_K_ratio", ours, best_gain),
            change.assign(value=change["value"] - 1.0),
        ]
    )


def ratio_of(
    frame: Frame,
    name: str,
    numerator: Mapping[str, str],
    denominator: Mapping[str, str],
) -> Frame:
    """Return rows of a new metric: one selection over another, run by run."""
    keys = [key for key in KEYS if key not in numerator]
    values = {
        place: select(frame, **selection).set_index(keys)["value"]
        for place, selection in (("top", numerator), ("bottom", denominator))
    }
    pairs: Frame = pd.concat(values, axis=1, join="inner")
    pairs = pairs[pairs["bottom"] != 0.0].copy()
    pairs["value"] = pairs["top"] / pairs["bottom"]
    fixed = dict(numerator) | {"metric": name}
    return pairs.reset_index().assign(**fixed)[[*KEYS, "value"]]


def select(frame: Frame, **wanted: str | None) -> Frame:
    """Return the rows whose columns have these values; None for any."""
    for name, value in wanted.items():
        if value is not None:
            frame = frame[frame[name] == value]
    return frame


def interval(
    values: Any, seeds: Any, rng: np.random.Generator, *, is_mean: bool
) -> tuple[float, float]:
    """Return the 95 % bootstrap interval of the mean or the median of runs.

    Percentile bootstrap (Efron 1979). Seeds are drawn, each with all its runs: what a
    seed draws, they have in common. Of fewer than five too few different samples can be
    drawn: then single runs are drawn.

    Args:
        values: One per run, finite, shape (n,).
        seeds: Of the same runs.
        rng: Draws the samples.
        is_mean: Whether it is that of the mean.
    """
    labels = np.asarray(seeds)
    if len(np.unique(labels)) < 5:
        labels = np.arange(len(labels))
    units = pd.Series(values).groupby(labels)
    place = units.cumcount().to_numpy()
    runs = np.full((units.ngroups, place.max() + 1), np.nan)
    runs[units.ngroup(), place] = values
    # Seeds may have different numbers of runs: what is missing is nan.
    average = np.nanmean if is_mean else np.nanmedian

    resamples = 2000
    rows = min(max(10**6 // runs.size, 1), resamples)
    averages = []
    while len(averages) < resamples:
        drawn = runs[rng.integers(len(runs), size=(rows, len(runs)))]
        averages.extend(average(drawn.reshape(rows, -1), axis=1))
    low, high = np.percentile(averages[:resamples], (2.5, 97.5))
    return float(low), float(high)


class Column(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A column as `tables.toml` has it: rows of a group, and how they are shown.

    Attributes:
        head: Stands above it.
        form: Format of a number, such as ``.3f``.
        metric: Which rows; None for any, as below.
        method: Which rows.
        source: Which rows.
        plant: Which rows.
        scale: Factor on the values.
        is_fraction: Of several runs, show mean and least, not median and worst.
        has_interval: Of several runs, show how well the middle is known too.
        text: Name in `TEXTS` of what is shown of the group instead of a number.
    """

    head: str
    form: str = ""
    metric: str | None = None
    method: str | None = None
    source: str | None = None
    plant: str | None = None
    scale: float = 1.0
    is_fraction: bool = False
    has_interval: bool = False
    text: str = ""

    def show(self, group: Frame) -> str:
        """Return the cell for a group of rows.

        One value as it is; of several the middle, and in brackets the worst. The middle
        is the median and the worst the farthest from the best value; of fractions it is
        the mean, and the worst the least.
        """
        if self.text:
            return TEXTS[self.text](group)
        wanted = ("metric", "method", "source", "plant")
        rows = select(group, **{name: getattr(self, name) for name in wanted})
        known = METRICS.get(rows["metric"].iloc[0]) if len(rows) else None
        if known is not None and known.may_be_undefined:
            rows = rows.dropna(subset="value")
        values = rows["value"] * self.scale
        if values.empty:
            return NOTHING
        if not np.isfinite(values).all():
            return NOT_FINITE
        if len(values) == 1:
            return format(values.iloc[0], self.form)
        if self.is_fraction:
            middle = values.mean()
            worst = values.min()
        else:
            best = 0.0 if known is None else known.best
            middle = values.median()
            worst = values.iloc[int((values - best).abs().argmax())]
        bounds = ""
        if self.has_interval and values.nunique() > 1:
            # Drawn anew from one seed: it depends on nothing but its own runs.
            rng = np.random.default_rng(0)
            ends = interval(values, rows["seed"], rng, is_mean=self.is_fraction)
            low, high = (format(end, self.form) for end in ends)
            bounds = f"[{low}, {high}] "
        return f"{middle:{self.form}} {bounds}({worst:{self.form}})"


class TableSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table with one line per group of rows, as `tables.toml` has it.

    Attributes:
        title: Stands above it.
        by: Columns of `Row` that make a group.
        columns: What is shown of a group.
        heads: Above the columns that name a group, where they do not bear the field's
            name.
        shows: Name of the table in `judged.toml`; groups without one of its metrics
            are left out.
        caption: Stands below it.
        target_caption: Stands below it as well where targets are shown.
        worst_first: Metrics whose worst run decides the order, worst first;
            ``target``: missed targets come first; ``shortfall``: of our fractions.
        has_worst: Whether a cell shows the worst of several runs too.
        perturbed: Whether it is of the runs in perturbed worlds, or of the others.
    """

    title: str
    by: tuple[str, ...]
    columns: tuple[Column, ...]
    heads: dict[str, str] = {}
    shows: str = ""
    caption: str = ""
    target_caption: str = ""
    worst_first: tuple[str, ...] = ()
    has_worst: bool = True
    perturbed: bool = False

    def select_rows(self, frame: Frame) -> Frame:
        """Return all rows of the groups that have something to show."""
        is_perturbed = frame["scenario"].str.startswith(PERTURBED)
        frame = frame[is_perturbed == self.perturbed]
        names = [
            name
            for name, kind in METRICS.items()
            if self.perturbed or kind.table == self.shows
        ]
        by = list(self.by)
        groups = frame[frame["metric"].isin(names)][by].drop_duplicates()
        return groups.merge(frame, on=by)

    def badness(self, group: Frame) -> tuple[float, ...]:
        """Return how far the worst run of a group is from the best value."""
        if self.worst_first == ("target",):
            texts = (column.show(group) for column in self.columns if column.text)
            return (any("missed" in text for text in texts),)
        if self.worst_first == ("shortfall",):
            return shortfall(group)
        values = [
            (METRICS[name].best, select(group, metric=name)["value"])
            for name in self.worst_first
        ]
        errors = ((column - best).abs().max() for best, column in values)
        return tuple(0.0 if math.isnan(error) else error for error in errors)


def build_table(spec: TableSpec, frame: Frame) -> ResultTable:
    """Return the table of the rows of a frame."""
    by = list(spec.by)
    groups = list(spec.select_rows(frame).groupby(by, sort=False))
    groups.sort(key=lambda item: spec.badness(item[1]), reverse=True)
    lines = []
    for key, group in groups:
        texts = [column.show(group) for column in spec.columns]
        if not spec.has_worst:
            texts = [text.partition(" (")[0] for text in texts]
        names = dict(zip(by, map(str, key), strict=True))
        if "metric" in by:
            kind = metric(names["metric"])
            names["metric"] = kind.meaning  # a metric is named by it
            texts.append(kind.unit)
        lines.append((*names.values(), *texts))
    has_metric = "metric" in by
    heads = {"source": "force", "metric": "what"} | spec.heads
    return ResultTable(
        title=spec.title,
        heads=(
            *(heads.get(name, name) for name in by),
            *(column.head for column in spec.columns),
            *(["unit"] if has_metric else []),
        ),
        align="".join(
            [
                *("l" if name == "metric" else "L" for name in by),
                *("L" if column.head == "target" else "r" for column in spec.columns),
                *(["L"] if has_metric else []),
            ]
        ),
        lines=tuple(lines),
        caption=spec.caption,
        target_caption=spec.target_caption,
    )


def show_limits(group: Frame) -> str:
    """Return the limits of a group's targets, and whether they are kept."""
    known = group[group["metric"].isin(METRICS)]
    rows = [Row(**record) for record in known[list(NAMES)].to_dict("records")]
    return ", ".join(
        f"{item.target.limits} {met_mark(item.is_met)}" for item in evaluate(rows)
    )


def force_mark(group: Frame) -> str:
    """Return whether the runs of a scenario keep the limits of their RMSE."""
    limits = show_limits(select(group, metric=FORCE_ERROR))
    return met_mark("missed" not in limits) if limits else NOTHING


def shortfall(group: Frame) -> tuple[float, float]:
    """Return how far our mean fractions fall short: the worst, and the sum."""
    ours = select(group, method="ours")
    fractions = {
        "rupture_recall": 1.0,
        "rupture_precision": 1.0,
        "friction_coverage_online_2sigma": 0.95,
        "wrench_coverage_2sigma": 0.95,
    }
    differences = [
        best - select(ours, metric=name, source=source)["value"].mean()
        for name, best in fractions.items()
        for source in ("ft", "virtual")
        # Not shown: coverage is that of the virtual sensor.
        if (source, name) != ("ft", "wrench_coverage_2sigma")
    ]
    short = [max(item, 0.0) for item in differences if not math.isnan(item)]
    return max(short, default=0.0), sum(short)


def count_runs(group: Frame) -> str:
    """Return how many runs a group is of."""
    return str(len(group[["scenario", "seed"]].drop_duplicates()))


def published_change(group: Frame) -> str:
    """Return the change from offline to online friction in the published Table I."""
    kind, *words = group["scenario"].iloc[0].split("-")
    if kind != "gel":  # a drawn stack of one layer
        return NOTHING
    known = TABLE_ONE_Ns_per_m[int(words[0])]
    return f"{100.0 * (known.online / known.offline - 1.0):.0f}"


def published_friction(group: Frame, how: str) -> str:
    """Return the friction of the published Table I, with its spread.

    The published spread is called a variance; its size and unit are those of a standard
    deviation.
    """
    kind, *words = group["scenario"].iloc[0].split("-")
    if kind != "gel":  # a drawn stack of one layer
        return NOTHING
    known = TABLE_ONE_Ns_per_m[int(words[0])]
    return f"{getattr(known, how)} ± {getattr(known, f'{how}_spread')}"


def real_arm_error(group: Frame) -> str:
    """Return the published error of a force on a real arm."""
    return str(PUBLISHED_RMSE_N.get(group["scenario"].iloc[0], NOTHING))


TEXTS: dict[str, Callable[[Frame], str]] = {
    "force target": force_mark,
    "limits": show_limits,
    "real arm": real_arm_error,
    "published change": published_change,
    "published offline": lambda group: published_friction(group, "offline"),
    "published online": lambda group: published_friction(group, "online"),
    "runs": count_runs,
}
"""What a column shows that is not a number of its group."""


def read_tables() -> dict[str, TableSpec]:
    """Return the tables of `tables.toml`, by name."""
    content = Path(__file__).with_name("tables.toml").read_bytes()
    specs = msgspec.toml.decode(content, type=dict[str, TableSpec])
    return {
        name: msgspec.structs.replace(spec, shows=name) for name, spec in specs.items()
    }


TABLES: Mapping[str, TableSpec] = read_tables()
"""In order, by the name in `judged.toml`; a new kind of number gets its table in
`tables.toml`."""


def target_table(rows: Iterable[Row]) -> ResultTable:
    """Return every target that could be judged, those missed first."""
    evaluations = sorted(evaluate(rows), key=lambda item: item.is_met)
    return ResultTable(
        title="Targets",
        heads=("what", "limits", "reached", "runs", "", "farthest out"),
        align="lrrrLl",
        lines=tuple(
            (
                item.target.what,
                item.target.limits,
                f"{item.value:.4g}" if math.isfinite(item.value) else NOT_FINITE,
                str(item.runs),
                met_mark(item.is_met),
                f"{item.worst.scenario}, seed {item.worst.seed}",
            )
            for item in evaluations
        ),
    )


def comparison_table(
    comparisons: Iterable[Comparison], title: str = "Changes", caption: str = ""
) -> ResultTable:
    """Return numbers of two measurements, failures first."""
    return ResultTable(
        title=title,
        heads=("what", "old", "new", "unit", "may be worse by", ""),
        align="LrrLrL",
        lines=tuple(
            (
                item.name,
                show_value(item.old),
                show_value(item.new),
                item.unit,
                f"{item.allowed:.2g}",
                str(item.change),
            )
            for item in sorted(comparisons, key=lambda item: not item.is_failure)
        ),
        caption=caption,
    )


def result_tables(
    rows: Sequence[Row], *, with_targets: bool = True
) -> list[ResultTable]:
    """Return the tables that these rows have something for.

    Args:
        rows: The rows.
        with_targets: Whether what the numbers should be is shown too, beside them and
            in a table of its own.
    """
    frame = frame_of(rows)
    tables = [build_table(spec, frame) for spec in TABLES.values()]
    tables = [table.choose_targets(are_shown=with_targets) for table in tables]
    if with_targets:
        tables.append(target_table(rows))
    return [table for table in tables if table.lines]


def answer(rows: Iterable[Row]) -> str:
    """Return how far the force is off and which ruptures were found, in sentences.

    An error is the median over the runs, a fraction their mean. The runs of the virtual
    force sensor count or, without any, those of a force sensor at the needle. The text
    is empty where there are neither.
    """
    frame = frame_of(rows)
    is_virtual = not select(frame, source="virtual", method="ours").empty
    chosen = select(frame, source="virtual" if is_virtual else "ft")
    # With the kindest settings of the published method that the runs have.
    settings = {
        "published-best-gain": " with the gain that suits each run best",
        "published-as-authors-ran": " as its authors ran it",
        "published-one-setting": " with one setting",
    }
    sentences: list[str] = []
    for name, words in (
        (FORCE_ERROR, "Error of the axial force from joint torques, rms"),
        ("rupture_recall", "Ruptures found"),
        ("rupture_precision", "Alarms that are right"),
    ):
        if name == FORCE_ERROR and not is_virtual:
            continue
        shown = {}
        for method in ("ours", *settings):
            values = select(chosen, metric=name, method=method)["value"].dropna()
            if not values.empty:
                is_error = name == FORCE_ERROR
                shown[method] = (
                    f"{values.median():.3f} N"
                    if is_error
                    else f"{100.0 * values.mean():.0f} %"
                )
        if "ours" not in shown:
            continue
        text = f"{words}: {shown['ours']}"
        kindest = next((method for method in settings if method in shown), None)
        if kindest is not None:
            text += f", by the published method{settings[kindest]} {shown[kindest]}"
        sentences.append(f"{text}.")
    return " ".join(sentences)


def results_page(
    rows: Sequence[Row], command: str, *, with_targets: bool = True
) -> str:
    """Return all tables of runs as a page.

    Args:
        rows: The runs.
        command: The command line that writes the page.
        with_targets: Whether what the numbers should be is shown too.
    """
    parts = [
        "# Results",
        "",
        "Every number of the benchmark, the worst first. Simulated insertions have a "
        "ground truth; `recording` is real data. A dash: there is no such number. "
        "Written by",
        "",
        f"```sh\n{command}\n```",
        "",
    ]
    # What is missed must not stand at the bottom of a long page.
    for table in sorted(
        result_tables(rows, with_targets=with_targets),
        key=lambda table: table.title != "Targets",
    ):
        parts += [f"## {table.title}", ""]
        parts += [table.caption, ""] if table.caption else []
        parts += [*table.markdown(), ""]
    return "\n".join(parts)
