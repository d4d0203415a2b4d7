"""The summary of runs, and the page of all their tables."""

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from benchmarks.report.frames import (
    FORCE_ERROR,
    NOTHING,
    Format,
    Frame,
    frame_of,
    select,
    summarize,
)
from benchmarks.report.tables import (
    ResultTable,
    met_mark,
    result_tables,
)
from benchmarks.results import Row, metric
from benchmarks.targets import GROUPS, HEADLINES, Headline, evaluate

SUMMED_METHODS = ("published-one-setting", "published-best-gain", "ours")


class AnswerPart(NamedTuple):
    """A number that the page begins with.

    Attributes:
        metric: Its metric.
        words: What it is.
        form: Sums up the values of all runs.
    """

    metric: str
    words: str
    form: Callable[[Any], str]


def answer(rows: Iterable[Row]) -> str:
    """Return how far the force is off and which ruptures were found, in sentences.

    An error is the median over the runs, a fraction their mean. The runs of the virtual
    force sensor count or, without any, those of a force sensor at the needle. The text
    is empty where there are neither.
    """
    frame = frame_of(rows)
    is_virtual = not select(frame, source="virtual", method="ours").empty
    chosen = select(frame, source="virtual" if is_virtual else "ft")
    sentences: list[str] = []
    for name, words, form in ANSWERS:
        if name == FORCE_ERROR and not is_virtual:
            continue
        values = {
            method: select(chosen, metric=name, method=method)["value"].dropna()
            for method in ("ours", *PUBLISHED_METHODS)
        }
        if values["ours"].empty:
            continue
        text = f"{words}: {form(values['ours'])}"
        for method, description in PUBLISHED_METHODS.items():
            if not values[method].empty:
                text += f", by the published method{description} {form(values[method])}"
                break
        sentences.append(f"{text}.")
    return " ".join(sentences)


PUBLISHED_METHODS = {
    "published-best-gain": " with the gain that suits each run best",
    "published-as-authors-ran": " as its authors ran it",
    "published-one-setting": " with one setting",
}
"""With which of its settings the published method stands beside ours: the kindest that
the runs have."""


def _median_N(values: Any) -> str:
    return f"{values.median():.3f} N"


def _mean_percent(values: Any) -> str:
    return f"{100.0 * values.mean():.0f} %"


ANSWERS: tuple[AnswerPart, ...] = (
    AnswerPart(
        FORCE_ERROR, "Error of the axial force from joint torques, rms", _median_N
    ),
    AnswerPart("rupture_recall", "Ruptures found", _mean_percent),
    AnswerPart("rupture_precision", "Alarms that are right", _mean_percent),
)
"""What the page begins with, where the runs have it."""


class SummaryLine(NamedTuple):
    """A line of the summary, and where it stands.

    Attributes:
        is_met: Whether no target of it is missed.
        is_better: Whether ours is better than the published method.
        cells: Its texts.
    """

    is_met: bool
    is_better: bool
    cells: tuple[str, ...]


def summary_table(rows: Sequence[Row]) -> ResultTable:
    """Return the `HEADLINES` these rows have something for, the bad ones first.

    Bad is a line with a missed target, then one in which ours is no better than
    published.
    """
    frame = frame_of(rows)
    targets_met: dict[tuple[str, ...], bool] = {}
    for evaluation in evaluate(rows):
        target = evaluation.target
        key = (target.metric, target.source, target.plant)
        targets_met[key] = targets_met.get(key, True) and evaluation.is_met
    lines = []
    for headline in HEADLINES:
        runs = select_headline(frame, headline)
        if not runs.empty:
            key = (headline.metric, headline.source, headline.plant)
            lines.append(summarize_headline(headline, runs, targets_met.get(key)))
    lines.sort(key=lambda line: (line.is_met, line.is_better))
    return ResultTable(
        title="Results",
        heads=(
            "what",
            "runs of",
            "published,\none setting",
            "published,\nbest gain",
            "ours",
            "worst of ours",
            "runs",
            "targets",
        ),
        align="LLrrrrrL",
        lines=tuple(line.cells for line in lines),
        caption="Virtual force sensor on a simulated arm, but for `liver-real`, a "
        "recording of real tissue. Several runs: the median, of fractions the mean "
        "[95 % interval, by bootstrap]. Best gain: the published method with "
        "commanded speed, its threshold and gain chosen for each run.",
    )


def select_headline(frame: Frame, headline: Headline) -> Frame:
    """Return the rows that a headline sums up."""
    rows = select(
        frame, metric=headline.metric, source=headline.source, plant=headline.plant
    )
    scenarios = GROUPS.get(headline.scenarios, (headline.scenarios,))
    return rows[rows["scenario"].isin(scenarios)]


def summarize_headline(
    headline: Headline, runs: Frame, is_met: bool | None
) -> SummaryLine:
    """Return all methods side by side, and the worst run of ours."""
    best = metric(headline.metric).best
    shown = Format(headline.form, is_fraction=best == 1.0, has_interval=True)
    cells = []
    errors = []
    worst = ""
    for method in SUMMED_METHODS:
        of_method = select(runs, method=method)
        middle, _, worst = summarize(of_method, shown).partition(" (")
        cells.append(middle)
        # Of no number at all nothing can be worse.
        error = abs(float(of_method["value"].median()) - best)
        errors.append(error if math.isfinite(error) else math.inf)
    return SummaryLine(
        is_met=is_met is not False,
        is_better=errors[-1] < min(errors[:-1]),
        cells=(
            headline.what,
            f"{headline.scenarios}, {headline.plant}",
            *cells,
            worst.rstrip(")"),
            str((runs["method"] == "ours").sum()),
            NOTHING if is_met is None else met_mark(is_met),
        ),
    )


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
