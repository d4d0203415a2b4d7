"""Numbers of runs as Markdown: docs/results.md with every table, and the README's summary."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from benchmarks import ResultsError
from benchmarks.rows import Row, metric
from benchmarks.tables import (
    NOTHING,
    Column,
    ResultTable,
    frame_of,
    met_mark,
    result_tables,
    select,
)
from benchmarks.targets import GROUPS, evaluate

BEGIN = "<!-- results:begin -->"
END = "<!-- results:end -->"


class Headline(NamedTuple):
    """A line of the summary: one metric over a group of runs."""

    metric: str
    form: str  # format of a number
    what: str  # for people, with the unit
    source: str = "virtual"
    plant: str = "clean"
    scenarios: str = "tissue"  # a group of `benchmarks.targets`, or a scenario


_FORCE = Headline("wrench_rmse_N", ".3f", "axial force, rms error, N")
_RECALL = Headline("rupture_recall", ".2f", "ruptures found, fraction")
_PULL_OUT = "friction against pull-out force, median error, %"
HEADLINES = (
    _FORCE,
    _FORCE._replace(plant="degraded"),
    _RECALL,
    _RECALL._replace(plant="degraded"),
    Headline("rupture_precision", ".2f", "alarms that are true, fraction"),
    Headline("rupture_delay_ms", ".0f", "delay of the alarm, ms"),
    Headline("friction_error_online_worst_pct", ".1f", "friction of a layer, worst error, %"),
    Headline("pullout_error_median_pct", ".0f", _PULL_OUT, "ft", "recording", "liver-real"),
)
"""At most eight: the README shows them."""


def summary_table(rows: Sequence[Row]) -> ResultTable:
    """The `HEADLINES` these rows have something for, the bad ones first.

    Bad is a line with a missed target, then one in which ours is no better than published.
    """
    frame = frame_of(rows)
    met: dict[tuple[str, str, str], bool] = {}
    for found in evaluate(rows):
        key = (found.target.metric, found.target.source, found.target.plant)
        met[key] = met.get(key, True) and found.is_met
    lines = []
    for line in HEADLINES:
        wanted = select(frame, metric=line.metric, source=line.source, plant=line.plant)
        wanted = wanted[wanted["scenario"].isin(GROUPS.get(line.scenarios, (line.scenarios,)))]
        if wanted.empty:
            continue
        kind = metric(line.metric)
        cells, errors = [], []
        for method in ("published", "default"):
            mine = select(wanted, method=method)
            cells.append(Column("", line.form, is_fraction=kind.best == 1.0).cell(mine))
            # Of no number at all nothing can be worse.
            error = abs(float(mine["value"].median()) - kind.best)
            errors.append(error if math.isfinite(error) else math.inf)
        is_met = met.get((line.metric, line.source, line.plant))
        runs = str((wanted["method"] == "default").sum())
        where = f"{line.scenarios}, {line.plant}"
        mark = NOTHING if is_met is None else met_mark(is_met)
        badness = (is_met is not False, errors[1] < errors[0])
        lines.append((badness, (line.what, where, *cells, runs, mark)))
    lines.sort(key=lambda item: item[0])
    return ResultTable(
        title="Results",
        heads=("what", "runs of", "published method", "ours", "runs", "targets"),
        align="LLrrrL",
        lines=tuple(line for _, line in lines),
        caption="Virtual force sensor on a simulated arm, but for `liver-real`, a recording of "
        "real tissue. Several runs: median (worst), of fractions mean (least).",
    )


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
    for table in sorted(result_tables(rows), key=lambda table: table.title != "Targets"):
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
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in after or END in after or END in before:
        raise ResultsError(f"expected one {BEGIN} and, after it, one {END} in the page")
    return f"{before}{BEGIN}\n{block}{END}{after}"


def printed_by(paths: Iterable[object]) -> str:
    """The command that prints the summary of these files."""
    return " ".join(["python -m benchmarks results", *map(str, paths)])
