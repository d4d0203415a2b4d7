"""The tables of a run: in the terminal, in the report and on the page of results.

`tables.toml` says which tables there are. A table has a line for each group of rows;
each of its columns selects rows of the group and sums them up in a cell.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks.insertion.perturbations import PERTURBED
from benchmarks.report.frames import (
    FORCE_ERROR,
    NOT_FINITE,
    NOTHING,
    Format,
    Frame,
    frame_of,
    select,
    summarize,
)
from benchmarks.results import METRICS, NAMES, Row, metric
from benchmarks.targets import (
    PUBLISHED_RMSE_N,
    TARGETS,
    Comparison,
    TABLE_ONE_Ns_per_m,
    evaluate,
)

COLORS = {"met": "green", "missed": "red", NOT_FINITE: "red"}
"""Of cells, by what they say."""
TARGET_HEADS = ("target", "targets")
"""Heads of the columns that say what a number should be."""
MIN_WIDTH = 200
"""Of a table that goes into a file or a pipe."""


def new_console() -> Console:
    """Return a console as wide as the terminal, or as every table needs without one."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, MIN_WIDTH)
    return console


def met_mark(is_met: bool) -> str:
    """Return the cell that says whether a target is met."""
    return "met" if is_met else "missed"


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

        Those are the columns headed ``target`` and the mark, without a head, after
        them.
        """
        if are_shown:
            caption = f"{self.caption} {self.target_caption}".strip()
            return replace(self, caption=caption, target_caption="")
        kept = [
            number
            for number, head in enumerate(self.heads)
            if not _is_of_target(head, self.heads[number - 1] if number else "")
        ]
        return replace(
            self,
            heads=tuple(self.heads[number] for number in kept),
            align="".join(self.align[number] for number in kept),
            lines=tuple(tuple(line[number] for number in kept) for line in self.lines),
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


def _is_of_target(head: str, head_before: str) -> bool:
    """Return whether a column is one of targets, or the mark beside one."""
    return head in TARGET_HEADS or (not head and head_before in TARGET_HEADS)


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

    @property
    def format(self) -> Format:
        """How several runs are summed up."""
        return Format(self.form, self.scale, self.is_fraction, self.has_interval)


class TableSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table with one line per group of rows, as `tables.toml` has it.

    Attributes:
        title: Stands above it.
        by: Columns of `Row` that make a group.
        columns: What is shown of a group.
        shows: Name of the table in `metrics.csv`; groups without one of its metrics
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
            return (any_target_missed(group),)
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
        texts = [show_column(column, group) for column in spec.columns]
        if not spec.has_worst:
            texts = [text.partition(" (")[0] for text in texts]
        lines.append((*group_heads(by, key, group), *texts, *unit_cells(by, group)))
    has_metric = "metric" in by
    return ResultTable(
        title=spec.title,
        heads=(
            *(HEADS.get(name, name) for name in by),
            *(column.head for column in spec.columns),
            *(["unit"] if has_metric else []),
        ),
        align="".join(
            [
                *("l" if name == "metric" else "L" for name in by),
                *("L" if column.text in LEFT else "r" for column in spec.columns),
                *(["L"] if has_metric else []),
            ]
        ),
        lines=tuple(lines),
        caption=spec.caption,
        target_caption=spec.target_caption,
    )


HEADS = {"source": "force", "metric": "what"}
"""Above the columns that name a group, where they do not bear the field's name."""
LEFT = ("force target", "limits")
"""Texts of columns that are aligned left."""


def show_column(column: Column, group: Frame) -> str:
    """Return the cell of a column for a group of rows."""
    if column.text:
        return TEXTS[column.text](group)
    rows = select(
        group,
        metric=column.metric,
        method=column.method,
        source=column.source,
        plant=column.plant,
    )
    return summarize(rows, column.format)


def group_heads(by: Sequence[str], key: Sequence[object], group: Frame) -> list[str]:
    """Return the cells that name a group: a metric by its meaning."""
    meaning = metric(group["metric"].iloc[0]).meaning if "metric" in by else ""
    return [
        meaning if name == "metric" else str(value)
        for name, value in zip(by, key, strict=True)
    ]


def unit_cells(by: Sequence[str], group: Frame) -> list[str]:
    """Return the unit, where a group is of one metric."""
    return [metric(group["metric"].iloc[0]).unit] if "metric" in by else []


def force_mark(group: Frame) -> str:
    """Return whether the runs of a scenario keep the limits of their RMSE."""
    scenario = group["scenario"].iloc[0]
    plant = group["plant"].iloc[0]
    ours = select(group, source="virtual", method="ours")
    is_kept: list[bool] = []
    for target in TARGETS:
        is_own = (target.metric, target.plant) == (FORCE_ERROR, plant)
        if is_own and scenario in target.scenarios:
            name = "wrench_rmse_ratio" if target.of_published else FORCE_ERROR
            values = select(ours, metric=name)["value"]
            of_median = target.statistic == "median" and len(values) > 0
            judged = [values.median()] if of_median else values
            is_kept += [target.is_met_by(value) for value in judged]
    return met_mark(all(is_kept)) if is_kept else NOTHING


def show_limits(group: Frame) -> str:
    """Return the limits of a group's targets, and whether they are kept."""
    rows = [Row(**record) for record in group[list(NAMES)].to_dict("records")]
    evaluations = evaluate(rows)
    return ", ".join(
        f"{item.target.limits} {met_mark(item.is_met)}" for item in evaluations
    )


def any_target_missed(group: Frame) -> bool:
    """Return whether a group misses one of its targets."""
    if FORCE_ERROR in set(group["metric"]):
        return force_mark(group) == met_mark(False)
    return met_mark(False) in show_limits(group)


SHORT_OF = {
    "rupture_recall": 1.0,
    "rupture_precision": 1.0,
    "friction_coverage_online_2sigma": 0.95,
    "wrench_coverage_2sigma": 0.95,
}
"""What our fractions should be."""


def shortfall(group: Frame) -> tuple[float, float]:
    """Return how far our mean fractions fall short: the worst, and the sum."""
    ours = select(group, method="ours")
    differences = [
        best - select(ours, metric=name, source=source)["value"].mean()
        for name, best in SHORT_OF.items()
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


def real_arm_error(group: Frame) -> str:
    """Return the published error of a force on a real arm."""
    return str(PUBLISHED_RMSE_N.get(group["scenario"].iloc[0], NOTHING))


TEXTS: dict[str, Callable[[Frame], str]] = {
    "force target": force_mark,
    "limits": show_limits,
    "real arm": real_arm_error,
    "published change": published_change,
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
"""In order, by the name in `metrics.csv`; a new kind of number gets its table in
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


def comparison_table(comparisons: Iterable[Comparison]) -> ResultTable:
    """Return what changed between two runs, failures first."""
    return ResultTable(
        title="Changes",
        heads=(*NAMES[:6], "old", "new", "unit", ""),
        align="llllllrrlL",
        lines=tuple(
            (
                *map(str, item.key),
                show_value(item.old),
                show_value(item.new),
                item.unit,
                str(item.change),
            )
            for item in sorted(comparisons, key=lambda item: not item.is_failure)
        ),
    )


def show_value(value: float) -> str:
    """Return a number with four digits, a dash for none."""
    return NOTHING if math.isnan(value) else f"{value:.4g}"


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
