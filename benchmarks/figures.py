"""The figures of README.md and docs/reference/results.md: one campaign fills both.

`figures.toml` says which tables there are. A table has a line for each row and a column
for each method; a cell joins the row's parts, each a statistic of one metric over all
runs. Limits come from `judged.toml`. What the campaign gave stands in `figures.json`,
with its commit, and between the marks of each page:

    <!-- figures: NAME -->
    ...
    <!-- end of figures -->
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd

from benchmarks import ResultsError
from benchmarks.judging import (
    ANY,
    METRICS,
    TARGETS,
    UNDEFINED,
    Statistic,
    Target,
    expand_groups,
    select,
    sum_up,
)

ROOT = Path(__file__).resolve().parents[1]
SPECS = Path(__file__).with_suffix(".toml")
STORED = Path(__file__).with_suffix(".json")
NO_FIGURE = "–"
NOT_MEASURED = "not measured"
END = "<!-- end of figures -->"
METHOD_NAMES = {
    "published-one-setting": "published, one setting",
    "published-as-authors-ran": "published, as its authors ran it",
    "published-best-gain": "published, best gain",
    "rule-of-thumb": "rule of thumb (0.7 of the force)",
    "ours": "needleforce",
}
"""Methods as people read them."""


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One number of a cell.

    Attributes:
        metric: A name of `judged.toml`.
        statistic: What of all runs is shown.
        form: Format of the number.
        unit: Follows it.
        scale: Factor on the value.
    """

    metric: str
    statistic: Statistic
    form: str
    unit: str = ""
    scale: float = 1.0

    def show(self, value: float) -> str:
        """Return a value as people read it."""
        return f"{self.scale * value:z{self.form}}{self.unit}"


class RowSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One line of a table.

    Attributes:
        what: Its first cell.
        plant: Plant model of the runs.
        parts: The numbers of its cells.
        source: Whose force; see `benchmarks.jobs.Source`.
        scenarios: Names, patterns of names, or groups.
        joint: Stands between the numbers of a cell.
    """

    what: str
    plant: str
    parts: tuple[Part, ...]
    joint: str = "; "
    source: str = "virtual"
    scenarios: tuple[str, ...] = ("tissue",)


class TableSpec(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One table.

    Attributes:
        name: In the marks of the pages.
        pages: Where it stands, from the project's folder.
        methods: Its columns.
        row: Its lines.
    """

    name: str
    pages: tuple[str, ...]
    methods: tuple[str, ...]
    row: tuple[RowSpec, ...]


def read_specs() -> tuple[TableSpec, ...]:
    """Return the tables of `figures.toml`."""
    specs = msgspec.toml.decode(SPECS.read_bytes(), type=dict[str, list[TableSpec]])
    return tuple(specs["table"])


def select_values(
    results: pd.DataFrame, spec: RowSpec, part: Part, method: str
) -> pd.Series:
    """Return the values of a part, one for each run that has it."""
    chosen = select(
        results,
        spec.scenarios,
        metric=part.metric,
        method=method,
        plant=spec.plant,
        source=spec.source,
    )
    return chosen["value"].dropna() if part.metric == UNDEFINED else chosen["value"]


def summarize_part(values: pd.Series, part: Part) -> float:
    """Return the statistic of a part; nan if one value is not finite."""
    return sum_up(values, part.statistic, (values - METRICS[part.metric].best).abs())


def find_target(spec: RowSpec, part: Part) -> Target | None:
    """Return the target of a part.

    A metric of a closed loop has its target on the plant `clean`: that of every plant
    in the table is judged by it.
    """
    plants = (spec.plant, "clean") if spec.scenarios != ("tissue",) else (spec.plant,)
    shown = set(expand_groups(spec.scenarios))
    for plant in plants:
        for target in TARGETS:
            is_same = (target.metric, target.plant) == (part.metric, plant)
            is_source = target.source in (spec.source, ANY)
            is_whole = not target.scenarios or shown <= set(
                expand_groups(target.scenarios)
            )
            is_statistic = target.statistic == part.statistic
            if is_same and is_source and is_whole and is_statistic:
                return None if target.of_published else target
    return None


def show_limits(spec: RowSpec) -> str:
    """Return the limits of a line's parts, in the units of its cells."""
    limits = []
    for part in spec.parts:
        target = find_target(spec, part)
        bounds = () if target is None else (target.at_least, target.at_most)
        finite = [part.show(bound) for bound in bounds if np.isfinite(bound)]
        limits.append(" to ".join(finite) or NO_FIGURE)
    is_bare = all(limit == NO_FIGURE for limit in limits)
    return NO_FIGURE if is_bare else spec.joint.join(limits)


def show_mark(spec: RowSpec, ours: Sequence[float]) -> str:
    """Return whether our figures keep their limits, and which does not."""
    targets = [find_target(spec, part) for part in spec.parts]
    judged = [
        target.is_met_by(value)
        for target, value in zip(targets, ours, strict=True)
        if target is not None
    ]
    if not judged:
        return ""
    if all(judged):
        return "met"
    if len(judged) == 1:
        return "**missed**"
    ordinals = ("first", "second", "third", "fourth")
    missed = [ordinals[k] for k, is_met in enumerate(judged) if not is_met]
    return f"**missed** ({', '.join(missed)})"


def fill_line(results: pd.DataFrame, table: TableSpec, spec: RowSpec) -> list[str]:
    """Return a line of a table: its cells, its limits, and whether they are kept."""
    cells = [spec.what]
    mark = NOT_MEASURED
    for method in table.methods:
        values = [select_values(results, spec, part, method) for part in spec.parts]
        if any(value.empty for value in values):
            cells.append(NO_FIGURE)
            continue
        figures = [
            summarize_part(*pair) for pair in zip(values, spec.parts, strict=True)
        ]
        cells.append(spec.joint.join(map(Part.show, spec.parts, figures)))
        if method == "ours":
            mark = show_mark(spec, figures)
    return [*cells, show_limits(spec), mark]


def fill_figures(results: pd.DataFrame, commit: str) -> dict[str, Any]:
    """Return the figures of a campaign, as `figures.json` has them.

    Args:
        results: All its results.
        commit: Of the code that was measured.
    """
    runs = results.drop_duplicates(["plant", "scenario", "seed"])
    return {
        "commit": commit,
        "runs": runs.groupby("plant").size().to_dict(),
        "tables": {
            table.name: [fill_line(results, table, spec) for spec in table.row]
            for table in read_specs()
        },
    }


def render_table(
    table: TableSpec, figures: dict[str, Any], *, is_first: bool = True
) -> str:
    """Return a table for its pages; the first of a page names the commit and the runs.

    Lines that the campaign did not measure are named below it.
    """
    names = [METHOD_NAMES[method] for method in table.methods]
    heads = ["", *names, "target", ""]
    rule = ["---", *("---:" for _ in names), "---", "---"]
    filled = figures["tables"][table.name]
    measured = [line for line in filled if line[-1] != NOT_MEASURED]
    left_out = [line[0] for line in filled if line[-1] == NOT_MEASURED]
    lines = [heads, rule, *measured]
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    runs = ", ".join(
        f"{count} on `{plant}`" for plant, count in figures["runs"].items()
    )
    notes = []
    if is_first:
        notes.append(f"Measured on commit {figures['commit']}; runs: {runs}.")
    if left_out:
        notes.append(f"Not measured in this campaign: {'; '.join(left_out)}.")
    return f"{body}\n\n{' '.join(notes)}".rstrip()


def fill_pages(figures: dict[str, Any]) -> dict[Path, str]:
    """Return the pages with the figures between their marks.

    Raises:
        ResultsError: A page lacks the marks of a table.
    """
    texts: dict[Path, str] = {}
    for table in read_specs():
        for name in table.pages:
            page = ROOT / name
            text = texts.get(page) or page.read_text(encoding="utf-8")
            begin = f"<!-- figures: {table.name} -->"
            block = re.compile(f"{re.escape(begin)}.*?{re.escape(END)}", re.DOTALL)
            if not block.search(text):
                raise ResultsError(f"{name} has no block from '{begin}' to '{END}'")
            content = render_table(table, figures, is_first=page not in texts)
            filled = f"{begin}\n{content}\n{END}"
            texts[page] = block.sub(lambda _, filled=filled: filled, text)
    return texts


def write_figures(figures: dict[str, Any]) -> None:
    """Write the figures to `figures.json` and into their pages."""
    pages = fill_pages(figures)
    text = json.dumps(figures, indent=1, ensure_ascii=False)
    STORED.write_text(f"{text}\n", encoding="utf-8")
    for page, filled in pages.items():
        page.write_text(filled, encoding="utf-8")
