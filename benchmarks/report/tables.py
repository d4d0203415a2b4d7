"""The tables of a run: in the terminal, in docs/results.md, in README.md and in the
report.
"""

import math
import re
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

from benchmarks import ResultsError
from benchmarks.campaign.intervals import INTERVAL_SEED, interval
from benchmarks.insertion.perturbations import PERTURBATIONS, PERTURBED
from benchmarks.results import METRICS, NAMES, Metric, Row, metric
from benchmarks.targets import (
    GROUPS,
    HEADLINES,
    PUBLISHED_RMSE_N,
    TARGETS,
    Comparison,
    Headline,
    TABLE_ONE_Ns_per_m,
    evaluate,
)

NOTHING = "–"
"""In a cell: there is no such number."""
BAD = "not finite"
COLORS = {"met": "green", "missed": "red", BAD: "red"}
"""Of cells, by what they say."""
LEAST_WIDTH = 200
"""Of a table that goes into a file or a pipe."""
_RMSE = "wrench_rmse_N"
CUMULATIVE = "cumulative_friction_{}_Ns_per_m"
Frame = Any
"""A pandas.DataFrame with the columns of `Row`; its annotations leave open what a
selection is."""


def new_console() -> Console:
    """A console as wide as the terminal, or wide enough for every table where there
    is none.
    """
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, LEAST_WIDTH)
    return console


def met_mark(is_met: bool) -> str:
    """The cell that says whether a target is met."""
    return "met" if is_met else "missed"


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultTable:
    """A table of texts.

    Attributes:
        heads: Of the columns; a line end breaks the line.
        align: One letter per column: ``r`` right, ``L`` left on one line, ``l`` left.
    """

    title: str
    heads: tuple[str, ...]
    align: str
    lines: tuple[tuple[str, ...], ...]
    caption: str = ""

    def rich(self) -> Table:
        """For the terminal."""
        table = Table(title=self.title, caption=escape(self.caption) or None)
        for head, align in zip(self.heads, self.align, strict=True):
            side = "right" if align == "r" else "left"
            table.add_column(head, justify=side, no_wrap=align != "l")
        for line in self.lines:
            table.add_row(*(f"[{COLORS[c]}]{c}[/]" if c in COLORS else c for c in line))
        return table

    def markdown(self) -> list[str]:
        """Lines of a page."""
        rule = ("---:" if align == "r" else "---" for align in self.align)
        rows = [[head.replace("\n", " ") for head in self.heads], rule, *self.lines]
        return [
            "| " + " | ".join(row).replace("| missed", "| **missed**") + " |"
            for row in rows
        ]


def frame_of(rows: Iterable[Row]) -> Frame:
    """Rows as a frame, with the ratios that tables show as rows of further metrics."""
    found = list(rows)
    columns = {name: [getattr(row, name) for row in found] for name in NAMES}
    frame = pd.DataFrame(columns, dtype=None if found else object)
    ours = {"metric": _RMSE, "source": "virtual", "method": "ours"}
    ratio = _ratio(frame, "wrench_rmse_ratio", ours, ours | {"method": "published"})
    best_gain = _ratio(
        frame, "wrench_best_K_ratio", ours, ours | {"method": "published-best-K"}
    )
    online, offline = (
        {"metric": CUMULATIVE.format(kind)} for kind in ("online", "offline")
    )
    change = _ratio(frame, "online_change", online, offline)
    return pd.concat(
        [frame, ratio, best_gain, change.assign(value=change["value"] - 1.0)]
    )


def _ratio(
    frame: Frame, name: str, top: dict[str, str], bottom: dict[str, str]
) -> Frame:
    """Rows of a new metric: one selection over another, run by run."""
    keys = [key for key in NAMES[:6] if key not in top]
    one, two = (
        select(frame, **each).set_index(keys)["value"] for each in (top, bottom)
    )
    both: Frame = pd.concat([one, two], axis=1, join="inner", keys=["top", "bottom"])
    both = both[both["bottom"] != 0.0].copy()
    both["value"] = both["top"] / both["bottom"]
    return both.reset_index().assign(**(top | {"metric": name}))[list(NAMES[:7])]


def select(frame: Frame, **wanted: str | None) -> Frame:
    """Rows whose columns have these values; None for any."""
    for name, value in wanted.items():
        if value is not None:
            frame = frame[frame[name] == value]
    return frame


class Column(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A column of numbers: which rows of a group go into a cell, and how they are
    shown.

    Attributes:
        form: Format of a number, such as ``.3f``.
        metric: None for any, as below.
        scale: Factor on the values.
        has_interval: Of several runs, show how well the middle is known too.
        text: Name in `TEXTS` of what is shown of the group instead of a number.
    """

    head: str
    form: str = ""
    metric: str | None = None
    method: str | None = None
    source: str | None = None
    scale: float = 1.0
    is_fraction: bool = (
        False  # of several runs, show mean and least, not median and worst
    )
    has_interval: bool = False
    text: str = ""

    def cell(self, group: Frame) -> str:
        """What the group's rows give."""
        if self.text:
            return TEXTS[self.text](group)
        mine = select(group, metric=self.metric, method=self.method, source=self.source)
        known = METRICS.get(mine["metric"].iloc[0]) if len(mine) else None
        if known is not None and known.may_be_undefined:
            mine = mine.dropna(subset="value")
        return self._summary(mine["value"] * self.scale, mine["seed"], known)

    def _summary(self, values: Frame, seeds: Frame, known: Metric | None) -> str:
        """One value as it is; of more the median, and in brackets the one farthest from
        the best.

        Of fractions the mean and the least instead.
        """
        if values.empty:
            return NOTHING
        if not np.isfinite(values).all():
            return BAD
        if len(values) == 1:
            return format(values.iloc[0], self.form)
        best = 0.0 if known is None else known.best
        middle = values.median()
        worst = values.iloc[int((values - best).abs().argmax())]
        if self.is_fraction:
            middle = values.mean()
            worst = values.min()
        found = f"{middle:{self.form}} "
        if self.has_interval and values.nunique() > 1:
            rng = np.random.default_rng(INTERVAL_SEED)
            low, high = interval(values, seeds, rng, is_mean=self.is_fraction)
            found += f"[{low:{self.form}}, {high:{self.form}}] "
        return f"{found}({worst:{self.form}})"


HEADS = {"source": "force", "metric": "what"}


class GroupTable(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table with one line per group of rows, as `tables.toml` has it.

    Attributes:
        by: Columns of `Row` that make a group.
        worst_first: Metrics whose worst run decides the order, worst first; ``target``:
            missed targets come first; ``shortfall``: of our fractions.
        has_worst: Whether a cell shows the worst of several runs too.
    """

    title: str
    by: tuple[str, ...]
    columns: tuple[Column, ...]
    shows: str = (
        ""  # groups without a metric of this table of `metrics.csv` are left out
    )
    caption: str = ""
    worst_first: tuple[str, ...] = ()
    has_worst: bool = True
    perturbed: bool = (
        False  # whether it is of the runs in perturbed worlds, or of the others
    )

    def _badness(self, group: Frame) -> tuple[float, ...]:
        """How far the worst run of a group is from the best value, metric by metric."""
        if self.worst_first == ("target",):
            return (_force_mark(group) == "missed",)
        if self.worst_first == ("shortfall",):
            return _shortfall(group)
        values = [
            (METRICS[n].best, select(group, metric=n)["value"])
            for n in self.worst_first
        ]
        errors = ((each - best).abs().max() for best, each in values)
        return tuple(0.0 if math.isnan(error) else error for error in errors)

    def __call__(self, rows: Iterable[Row]) -> ResultTable:
        """The table of some rows."""
        return self.of_frame(frame_of(rows))

    def of_frame(self, frame: Frame) -> ResultTable:
        """The table of the rows of a frame."""
        is_perturbed = frame["scenario"].str.startswith(PERTURBED)
        frame = frame[is_perturbed == self.perturbed]
        names = [
            n
            for n, kind in METRICS.items()
            if self.perturbed or kind.table == self.shows
        ]
        keys = frame[frame["metric"].isin(names)][list(self.by)].drop_duplicates()
        frame = keys.merge(frame, on=list(self.by))
        groups = list(frame.groupby(list(self.by), sort=False))
        groups.sort(key=lambda group: self._badness(group[1]), reverse=True)
        lines = []
        for key, group in groups:
            cells = [column.cell(group) for column in self.columns]
            if not self.has_worst:
                cells = [cell.partition(" (")[0] for cell in cells]
            line = [*map(str, key), *cells]
            if "metric" in self.by:
                kind = metric(group["metric"].iloc[0])
                line[self.by.index("metric")] = kind.meaning
                line.append(kind.unit)
            lines.append(tuple(line))
        heads = [HEADS.get(name, name) for name in self.by] + [
            c.head for c in self.columns
        ]
        align = ["l" if name == "metric" else "L" for name in self.by]
        align += ["L" if column.head == "target" else "r" for column in self.columns]
        if "metric" in self.by:
            heads = [*heads, "unit"]
            align = [*align, "L"]
        return ResultTable(
            title=self.title,
            heads=tuple(heads),
            align="".join(align),
            lines=tuple(lines),
            caption=self.caption,
        )


def _force_mark(group: Frame) -> str:
    """Whether the runs of a scenario on a plant keep the limits of their RMSE, or
    its median.
    """
    scenario = group["scenario"].iloc[0]
    plant = group["plant"].iloc[0]
    ours = select(group, source="virtual", method="ours")
    kept: list[bool] = []
    for target in TARGETS:
        is_own = (target.metric, target.plant) == ("wrench_rmse_N", plant)
        if is_own and scenario in target.scenarios:
            metric = "wrench_rmse_ratio" if target.of_published else "wrench_rmse_N"
            values = select(ours, metric=metric)["value"]
            of_median = target.statistic == "median" and len(values) > 0
            kept += map(target.is_met_by, [values.median()] if of_median else values)
    return met_mark(all(kept)) if kept else NOTHING


SHORT_OF = {
    "rupture_recall": 1.0,
    "rupture_precision": 1.0,
    "friction_coverage_online_2sigma": 0.95,
    "wrench_coverage_2sigma": 0.95,
}


def _shortfall(group: Frame) -> tuple[float, float]:
    """How much our fractions, means over runs, fall short of what they should be:
    worst, all.
    """
    ours = select(group, method="ours")
    found = [
        best - select(ours, metric=name, source=source)["value"].mean()
        for name, best in SHORT_OF.items()
        for source in ("ft", "virtual")
        if (source, name)
        != ("ft", "wrench_coverage_2sigma")  # not shown: the virtual sensor's
    ]
    short = [max(each, 0.0) for each in found if not math.isnan(each)]
    return max(short, default=0.0), sum(short)


def _runs(group: Frame) -> str:
    return str(len(group[["scenario", "seed"]].drop_duplicates()))


def _published_change(group: Frame) -> str:
    """From offline to online friction in the published Table I."""
    kind, *rest = group["scenario"].iloc[0].split("-")
    if kind != "gel":  # a drawn stack of one layer
        return NOTHING
    known = TABLE_ONE_Ns_per_m[int(rest[0])]
    return f"{100.0 * (known.online / known.offline - 1.0):.0f}"


TEXTS: dict[str, Callable[[Frame], str]] = {
    "force target": _force_mark,
    "real arm": lambda group: str(
        PUBLISHED_RMSE_N.get(group["scenario"].iloc[0], NOTHING)
    ),
    "published change": _published_change,
    "runs": _runs,
}
"""What a column shows that is not a number of its group."""


def _read() -> dict[str, GroupTable]:
    content = Path(__file__).with_name("tables.toml").read_bytes()
    found = msgspec.toml.decode(content, type=dict[str, GroupTable])
    return {
        name: msgspec.structs.replace(table, shows=name)
        for name, table in found.items()
    }


TABLES: Mapping[str, GroupTable] = _read()
"""In order, by the name in `metrics.csv`; a new kind of number gets its table in
`tables.toml`."""


def target_table(rows: Iterable[Row]) -> ResultTable:
    """Every target that could be judged, those missed first."""
    return ResultTable(
        title="Targets",
        heads=("what", "limits", "reached", "runs", "", "farthest out"),
        align="lrrrLl",
        lines=tuple(
            (
                found.target.what,
                found.target.limits,
                f"{found.value:.4g}" if math.isfinite(found.value) else BAD,
                str(found.runs),
                met_mark(found.is_met),
                f"{found.worst.scenario}, seed {found.worst.seed}",
            )
            for found in sorted(evaluate(rows), key=lambda found: found.is_met)
        ),
    )


def comparison_table(found: Iterable[Comparison]) -> ResultTable:
    """What changed between two runs, failures first."""
    return ResultTable(
        title="Changes",
        heads=(*NAMES[:6], "old", "new", "unit", ""),
        align="llllllrrlL",
        lines=tuple(
            (
                *map(str, item.key),
                *(
                    NOTHING if math.isnan(value) else f"{value:.4g}"
                    for value in item[2:4]
                ),
                item.unit,
                str(item.change),
            )
            for item in sorted(found, key=lambda item: not item.is_failure)
        ),
    )


def result_tables(rows: Sequence[Row]) -> list[ResultTable]:
    """The tables that these rows have something for."""
    frame = frame_of(rows)
    tables = (*(make.of_frame(frame) for make in TABLES.values()), target_table(rows))
    return [table for table in tables if table.lines]


WORST_ROWS = 8


def worst_rows(rows: Sequence[Row]) -> str:
    """The worst lines of the robustness table, for docs/limits.md."""
    table = TABLES["robustness"](rows)
    if not table.lines:
        raise ResultsError("no runs of robustness among the results")
    what = {name: each.what for name, each in PERTURBATIONS.items()}
    lines = [
        (what.get(line[0], line[0]), *line[1:]) for line in table.lines[:WORST_ROWS]
    ]
    worst = replace(table, lines=tuple(lines))
    return "\n".join([*worst.markdown(), "", table.caption]) + "\n"


BEGIN = "<!-- results:begin -->"
END = "<!-- results:end -->"
SUMMED = ("published", "published-best-K", "ours")


def summary_table(rows: Sequence[Row]) -> ResultTable:
    """The `HEADLINES` these rows have something for, the bad ones first.

    Bad is a line with a missed target, then one in which ours is no better than
    published.
    """
    frame = frame_of(rows)
    met: dict[tuple[str, str, str], bool] = {}
    for found in evaluate(rows):
        key = (found.target.metric, found.target.source, found.target.plant)
        met[key] = met.get(key, True) and found.is_met
    lines = []
    for line in HEADLINES:
        wanted = select(frame, metric=line.metric, source=line.source, plant=line.plant)
        wanted = wanted[
            wanted["scenario"].isin(GROUPS.get(line.scenarios, (line.scenarios,)))
        ]
        if wanted.empty:
            continue
        cells, is_better = _compared(line, wanted)
        is_met = met.get((line.metric, line.source, line.plant))
        runs = str((wanted["method"] == "ours").sum())
        where = f"{line.scenarios}, {line.plant}"
        mark = NOTHING if is_met is None else met_mark(is_met)
        lines.append(
            ((is_met is not False, is_better), (line.what, where, *cells, runs, mark))
        )
    lines.sort(key=lambda item: item[0])
    return ResultTable(
        title="Results",
        heads=(
            *(
                "what",
                "runs of",
                "published method",
                "as run, best K",
                "ours",
                "worst of ours",
            ),
            *("runs", "targets"),
        ),
        align="LLrrrrrL",
        lines=tuple(line for _, line in lines),
        caption="Virtual force sensor on a simulated arm, but for `liver-real`, a recording of "
        "real tissue. Several runs: median, of fractions mean [95 % bootstrap interval over seeds; "
        "of fewer than five, over runs]. As run, best K: the published method with commanded "
        "speed, its threshold and gain chosen for each run.",
    )


def _compared(line: Headline, wanted: Frame) -> tuple[list[str], bool]:
    """Cells of all methods, the worst run of ours, and whether ours is better than
    the others.
    """
    kind = metric(line.metric)
    column = Column("", line.form, is_fraction=kind.best == 1.0, has_interval=True)
    cells = []
    errors = []
    worst = ""
    for method in SUMMED:
        mine = select(wanted, method=method)
        text, _, worst = column.cell(mine).partition(" (")
        cells.append(text)
        # Of no number at all nothing can be worse.
        error = abs(float(mine["value"].median()) - kind.best)
        errors.append(error if math.isfinite(error) else math.inf)
    return [*cells, worst.rstrip(")")], errors[-1] < min(errors[:-1])


def results_page(rows: Sequence[Row], command: str) -> str:
    """All tables of runs as a page, with the command line that writes it."""
    parts = [
        "# Results",
        "",
        "Every number of the benchmark, the worst first. Simulated insertions have a ground truth; "
        "`recording` is real data. A dash: there is no such number. Written by",
        "",
        f"```sh\n{command}\n```",
        "",
    ]
    # What is missed must not stand at the bottom of a long page.
    for table in sorted(
        result_tables(rows), key=lambda table: table.title != "Targets"
    ):
        parts += [f"## {table.title}", ""]
        parts += [table.caption, ""] if table.caption else []
        parts += [*table.markdown(), ""]
    return "\n".join(parts)


def summary_block(rows: Sequence[Row], command: str) -> str:
    """The README's table, with the command that prints it."""
    table = summary_table(rows)
    lines = [*table.markdown(), "", table.caption, "", f"```sh\n{command}\n```"]
    return "\n".join(lines) + "\n"


def fill(text: str, block: str) -> str:
    """The page with the block between its marks.

    Raises:
        ResultsError: The page does not have each mark once, in order.
    """
    filled = f"{BEGIN}\n{block}{END}"
    text, found = re.subn(f"{BEGIN}\n.*?{END}", lambda _: filled, text, flags=re.DOTALL)
    if found != 1:
        raise ResultsError(f"expected one {BEGIN} and, after it, one {END} in the page")
    return text
