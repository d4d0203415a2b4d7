"""The tables of a run: in the terminal, in docs/results.md and in the report."""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from rich.console import Console
from rich.table import Table

from benchmarks.evaluation import Comparison, evaluate, judged_values
from benchmarks.metrics import METRICS, metric
from benchmarks.rows import NAMES, Row
from benchmarks.targets import GELS, PUBLISHED_RMSE_N, TARGETS, TABLE_ONE_Ns_per_m

NOTHING = "–"
"""In a cell: there is no such number."""
BAD = "not finite"
COLORS = {"met": "green", "missed": "red", BAD: "red"}
"""Of cells, by what they say."""
LEAST_WIDTH = 140
"""Of a table that goes into a file or a pipe."""


def new_console() -> Console:
    """A console as wide as the terminal, or wide enough for every table where there is none."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = max(console.width, LEAST_WIDTH)
    return console


def met_mark(is_met: bool) -> str:
    """The cell that says whether a target is met."""
    return "met" if is_met else "missed"


@dataclass(frozen=True, slots=True, kw_only=True)
class ResultTable:
    """A table of texts."""

    title: str  # one line
    heads: tuple[str, ...]  # of the columns; a line end breaks the line
    align: str  # one letter per column: ``r`` right, ``L`` left on one line, ``l`` left
    lines: tuple[tuple[str, ...], ...]  # cells of each line
    caption: str = ""  # what to know when reading it

    def rich(self) -> Table:
        """For the terminal."""
        table = Table(title=self.title, caption=self.caption or None)
        for head, align in zip(self.heads, self.align, strict=True):
            table.add_column(
                head, justify="right" if align == "r" else "left", no_wrap=align != "l"
            )
        for line in self.lines:
            table.add_row(*(f"[{COLORS[c]}]{c}[/]" if c in COLORS else c for c in line))
        return table

    def markdown(self) -> list[str]:
        """Lines of a page."""
        rule = ("---:" if align == "r" else "---" for align in self.align)
        rows = [[head.replace("\n", " ") for head in self.heads], rule, *self.lines]
        return ["| " + " | ".join(row).replace("missed", "**missed**") + " |" for row in rows]


class Column(NamedTuple):
    """A column of numbers: which rows of a group go into a cell, and how they are shown."""

    head: str  # of the column
    form: str  # format of a number, such as ``.3f``
    # a name of `metrics.csv`, or of a metric that the table derives; None for any
    metric: str | None = None
    method: str | None = None  # none for any
    source: str | None = None  # none for any
    scale: float = 1.0  # factor on the values
    # of several runs, mean and least are shown instead of median and worst
    is_fraction: bool = False

    def cell(self, group: pd.DataFrame) -> str:
        """What the group's rows give."""
        wanted = {name: getattr(self, name) for name in ("metric", "method", "source")}
        mine = _select(group, **{name: value for name, value in wanted.items() if value})
        known = METRICS.get(str(mine["metric"].iloc[0])) if len(mine) else None
        best, may_be_undefined = (known.best, known.may_be_undefined) if known else (0.0, False)
        values = mine["value"] * self.scale
        return summary(values.dropna() if may_be_undefined else values, self.form, best, self)


def summary(
    values: Sequence[float] | pd.Series, form: str, best: float = 0.0, column: Column | None = None
) -> str:
    """One value as it is; of more the median, and in brackets the one farthest from the best.

    Args:
        values: Of the runs.
        form: Format of a number, such as ``.3f``.
        best: The value wished for.
        column: If it says so, mean and least of fractions, whose best is large.
    """
    found = pd.Series(values, dtype=float)
    if found.empty:
        return NOTHING
    if not np.isfinite(found).all():
        return BAD
    if len(found) == 1:
        return format(found.iloc[0], form)
    if column is not None and column.is_fraction:
        return f"{found.mean():{form}} ({found.min():{form}})"
    worst = found.iloc[int((found - best).abs().to_numpy().argmax())]
    return f"{found.median():{form}} ({worst:{form}})"


def frame_of(rows: Iterable[Row]) -> pd.DataFrame:
    """Rows as a frame with the columns of `Row`."""
    return pd.DataFrame([[getattr(row, n) for n in NAMES] for row in rows], columns=list(NAMES))


def _select(frame: pd.DataFrame, **wanted: str) -> pd.DataFrame:
    for name, value in wanted.items():
        frame = frame[frame[name] == value]
    return frame


def _ratio(
    frame: pd.DataFrame, name: str, top: dict[str, str], bottom: dict[str, str]
) -> pd.DataFrame:
    """The frame with rows of a new metric: one selection over another, run by run."""
    keys = [key for key in NAMES[:6] if key not in top]
    one, two = (_select(frame, **each).set_index(keys)["value"] for each in (top, bottom))
    both = pd.concat([one, two], axis=1, join="inner", keys=["top", "bottom"])
    both = both[both["bottom"] != 0.0]
    ratio = (both["top"] / both["bottom"]).rename("value").reset_index()
    return pd.concat([frame, ratio.assign(**(top | {"metric": name}))])


Lines = list[tuple[str, ...]]


def _lines(
    frame: pd.DataFrame,
    by: Sequence[str],
    columns: Sequence[Column],
    badness: Callable[[pd.DataFrame], tuple[float, ...]] = lambda group: (),
) -> Lines:
    """One line per group: its keys, then its cells; the worst groups first."""
    groups = [(key, group) for key, group in frame.groupby(list(by), sort=False)]
    groups.sort(key=lambda item: badness(item[1]), reverse=True)
    return [
        (*map(str, key), *(column.cell(group) for column in columns))
        for key, group in groups
        if isinstance(key, tuple)
    ]


def _worst_of(*names: str) -> Callable[[pd.DataFrame], tuple[float, ...]]:
    """How far the worst of a group's runs is from the best value, metric by metric."""

    def badness(group: pd.DataFrame) -> tuple[float, ...]:
        values = [_select(group, metric=name)["value"].dropna() for name in names]
        return tuple(
            float((found - METRICS[name].best).abs().max()) if len(found) else 0.0
            for name, found in zip(names, values, strict=True)
        )

    return badness


def _shown_in(frame: pd.DataFrame, *tables: str) -> pd.DataFrame:
    is_shown = [metric(name).table in tables for name in frame["metric"]]
    return frame[np.array(is_shown, dtype=bool)]


FORCE_CAPTION = (
    "From first contact to the end of withdrawal; several seeds: median (worst). 'real arm': RMSE "
    "of the published method on its LWR 4+, Figure 5; scenario and tissue are alike, not the same."
)
_OURS = {"source": "virtual", "method": "default"}
FORCES = (
    Column("F/T\nRMSE, N", ".3f", "wrench_rmse_N", "default", "ft"),
    Column("published\nRMSE, N", ".3f", "wrench_rmse_N", "published", "virtual"),
    Column("default\nRMSE, N", ".3f", "wrench_rmse_N", **_OURS),
    Column("default\n/ published", ".2f", "wrench_rmse_ratio", **_OURS),
    Column("bias\nmN", ".0f", "wrench_bias_N", **_OURS, scale=1e3),
    Column("lag\nms", ".0f", "wrench_lag_ms", **_OURS),
    Column("within\n2 sigma", ".2f", "wrench_coverage_2sigma", **_OURS),
)


def force_table(rows: Sequence[Row]) -> ResultTable:
    """Axial force: F/T sensor, published method, ours, and the published figure."""
    frame = _shown_in(frame_of(rows), "force")
    rmse = {"metric": "wrench_rmse_N", "source": "virtual"}
    ours, theirs = rmse | {"method": "default"}, rmse | {"method": "published"}
    by_key = {row.key: row for row in rows}
    met: dict[tuple[str, str], bool] = {}
    for target in TARGETS:
        if target.metric == "wrench_rmse_N":
            for key, value in judged_values(target, by_key).items():
                place = (key.scenario, key.plant)  # type: ignore[attr-defined]
                met[place] = met.get(place, True) and target.is_met_by(value)
    lines = []
    for line in _lines(
        _ratio(frame, "wrench_rmse_ratio", ours, theirs), ("scenario", "plant"), FORCES
    ):
        published = PUBLISHED_RMSE_N.get(line[0])
        real = NOTHING if published is None else f"{published:g}"
        mark = met_mark(met[line[:2]]) if line[:2] in met else NOTHING
        lines.append((*line[:6], real, *line[6:], mark))
    heads = [column.head for column in FORCES]
    return ResultTable(
        title="Axial force against the true one",
        heads=("scenario", "plant", *heads[:4], "real arm\nN", *heads[4:], "target"),
        align="LL" + 8 * "r" + "L",
        lines=tuple(sorted(lines, key=lambda line: line[-1] != "missed")),
        caption=FORCE_CAPTION,
    )


FRICTION_CAPTION = (
    "Several seeds: median (worst), of fractions mean (least). Remaining force: |enhanced force| "
    "beyond the last layer over the force there. RMSE: from the first compensation to the deepest "
    "point. Largest error of the friction first."
)
FRICTIONS = (
    Column("friction, %\nworst layer", ".1f", "friction_error_online_worst_pct"),
    Column("within\n2 sigma", ".2f", "friction_coverage_online_2sigma", is_fraction=True),
    Column("at the end\n%", ".1f", "friction_error_worst_pct"),
    Column("remaining\nforce, %", ".1f", "exit_residue_pct"),
    Column("enhanced\nRMSE, N", ".3f", "enhanced_rmse_N"),
    Column("tip\nRMSE, N", ".3f", "tip_rmse_N"),
)
RUPTURE_CAPTION = (
    "Several seeds: median (worst), of fractions mean (least). Ruptures drop the force by more "
    "than five times the source's noise in free air; an alarm belongs to one within 0.2 s before "
    "to 1.5 s after its onset; without an alarm there is no precision. Fewest ruptures found first."
)
RUPTURES = (
    Column("recall", ".2f", "rupture_recall", is_fraction=True),
    Column("precision", ".2f", "rupture_precision", is_fraction=True),
    Column("recall,\nsoft ones", ".2f", "soft_transition_recall", is_fraction=True),
    Column("delay\nms", ".0f", "rupture_delay_ms"),
    Column("timing error\nms", ".0f", "rupture_dating_error_ms"),
    Column("depth error\nmm", ".2f", "rupture_overshoot_mm"),
)
_BY_METHOD = ("scenario", "plant", "source", "method")


def _method_lines(lines: Lines) -> Lines:
    """Source and method in one cell."""
    return [(*line[:2], f"{line[2]} {line[3]}", *line[4:]) for line in lines]


def rupture_table(rows: Iterable[Row]) -> ResultTable:
    """Ruptures, one line per scenario, plant, source and method."""
    frame = _shown_in(frame_of(rows), "ruptures")
    badness = _worst_of("rupture_recall", "rupture_precision")
    return ResultTable(
        title="Online identification: ruptures",
        heads=("scenario", "plant", "force, method", *(column.head for column in RUPTURES)),
        align="LLL" + len(RUPTURES) * "r",
        lines=tuple(_method_lines(_lines(frame, _BY_METHOD, RUPTURES, badness))),
        caption=RUPTURE_CAPTION,
    )


def friction_table(rows: Iterable[Row]) -> ResultTable:
    """Friction and forces, one line per scenario, plant, source and method."""
    frame = _shown_in(frame_of(rows), "friction")
    badness = _worst_of("friction_error_online_worst_pct")
    return ResultTable(
        title="Online identification: friction and forces",
        heads=("scenario", "plant", "force, method", *(column.head for column in FRICTIONS)),
        align="LLL" + len(FRICTIONS) * "r",
        lines=tuple(_method_lines(_lines(frame, _BY_METHOD, FRICTIONS, badness))),
        caption=FRICTION_CAPTION,
    )


BOUNDS = (
    Column("friction, %\nwhite noise", ".2f", "friction_bound_white_pct", "default"),
    Column("least\n(bound)", ".2f", "friction_bound_pct", "default"),
    Column("ours", ".2f", "friction_error_mean_pct", "default"),
    Column("delay, ms\nleast (bound)", ".1f", "rupture_delay_bound_ms", "default"),
    Column("ours", ".1f", "rupture_delay_ms", "default"),
    Column("published", ".1f", "rupture_delay_ms", "published"),
)


def bound_table(rows: Iterable[Row]) -> ResultTable:
    """What the noise of a force allows, beside what was reached with it."""
    frame, by = frame_of(rows), ["scenario", "plant", "source"]
    bounded = frame.merge(_shown_in(frame, "bounds")[by].drop_duplicates(), on=by)
    return ResultTable(
        title="Bounds of identification",
        heads=("scenario", "plant", "force", *(column.head for column in BOUNDS)),
        align="LLL" + len(BOUNDS) * "r",
        lines=tuple(_lines(bounded, by, BOUNDS)),
        caption="Several seeds: median (worst). Bounds know the law, position and size of every "
        "rupture, and the noise of the run; see docs/limits.md.",
    )


_CUMULATIVE = "cumulative_friction_{}_Ns_per_m"
TABLE_ONE = (
    *(Column(kind, ".0f", _CUMULATIVE.format(kind)) for kind in ("true", "offline", "online")),
    Column("online to\noffline, %", "+.0f", "online_change_pct"),
)


def table_one_table(rows: Iterable[Row]) -> ResultTable:
    """Table I side by side: single gels."""
    frame = _shown_in(frame_of(rows), "table I")
    frame = frame[frame["scenario"].isin(GELS)]
    online, offline = ({"metric": _CUMULATIVE.format(kind)} for kind in ("online", "offline"))
    frame = _ratio(frame, "online_change_pct", online, offline)
    is_change = frame["metric"] == "online_change_pct"
    frame.loc[is_change, "value"] = 100.0 * (frame.loc[is_change, "value"] - 1.0)
    lines = []
    for line in _method_lines(_lines(frame, _BY_METHOD, TABLE_ONE)):
        known = TABLE_ONE_Ns_per_m[int(line[0].split("-")[1])]
        lines.append((*line, f"{100.0 * (known.online / known.offline - 1.0):.0f}"))
    heads = (column.head for column in TABLE_ONE)
    return ResultTable(
        title="Table I: cumulative friction of single gels, Ns/m",
        heads=("scenario", "plant", "force, method", *heads, "published\n%"),
        align="LLL" + "rrrrr",
        lines=tuple(lines),
        caption="Several seeds: median (worst). 'published': online to offline in the paper.",
    )


OFFLINE = tuple(
    Column(head, ".3f", f"offline_rmse_{model}_N")
    for model, head in (("ml", "multi-layer"), ("kv", "Kelvin-Voigt"))
)


def offline_table(rows: Iterable[Row]) -> ResultTable:
    """Offline reconstruction as in Figures 2 and 3: multi-layer model against Kelvin-Voigt."""
    return ResultTable(
        title="Offline reconstruction: RMSE, N",
        heads=("scenario", "plant", *(column.head for column in OFFLINE)),
        align="LLrr",
        lines=tuple(_lines(_shown_in(frame_of(rows), "offline"), ("scenario", "plant"), OFFLINE)),
        caption="Equation (6) on the F/T reading, true layers and ruptures given; RMSE from first "
        "contact to the deepest point. Several seeds: median (worst).",
    )


def _named_lines(lines: Lines, name: int) -> Lines:
    """Lines in whose cell `name` a metric's name becomes its meaning, and its unit comes last."""
    return [
        (*line[:name], metric(line[name]).meaning, *line[name + 1 :], metric(line[name]).unit)
        for line in lines
    ]


def tissue_table(rows: Iterable[Row]) -> ResultTable:
    """Identification on recordings of real tissue, a column per method."""
    methods = ("guess", "published", "default")
    frame = _shown_in(frame_of(rows), "real tissue")
    columns = [Column(method, ".3g", method=method) for method in methods]
    return ResultTable(
        title="Real tissue",
        heads=("recording", "force", "what", *methods, "unit"),
        align="LLlrrrL",
        lines=tuple(_named_lines(_lines(frame, ("scenario", "source", "metric"), columns), 2)),
        caption="Several insertions: median (worst).",
    )


def number_table(rows: Iterable[Row]) -> ResultTable:
    """Numbers without a table of their own: residuals, weights, scales."""
    frame = _shown_in(frame_of(rows), "numbers")
    by = ("scenario", "plant", "method", "metric")
    return ResultTable(
        title="Other numbers",
        heads=("scenario", "plant", "method", "what", "value", "unit"),
        align="LLLlrL",
        lines=tuple(_named_lines(_lines(frame, by, [Column("value", ".3g")]), 3)),
    )


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
    found = sorted(found, key=lambda item: not item.is_failure)
    return ResultTable(
        title="Changes",
        heads=(*NAMES[:6], "old", "new", "unit", ""),
        align="llllllrrlL",
        lines=tuple(
            (
                *map(str, item.key),
                *(NOTHING if math.isnan(value) else f"{value:.4g}" for value in item[2:4]),
                item.unit,
                str(item.change),
            )
            for item in found
        ),
    )


TABLES = (
    force_table,
    rupture_table,
    friction_table,
    bound_table,
    table_one_table,
    offline_table,
    tissue_table,
    number_table,
    target_table,
)
"""In order; a new kind of number gets its table here."""


def result_tables(rows: Sequence[Row]) -> list[ResultTable]:
    """The tables that these rows have something for."""
    return [table for table in (make(rows) for make in TABLES) if table.lines]


def run_tables(rows: Sequence[Row]) -> list[Table]:
    """The same for the terminal."""
    return [table.rich() for table in result_tables(rows)]
