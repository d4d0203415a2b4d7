"""The figures of README.md and docs/reference/results.md: one campaign fills both.

`figures.toml` says which tables there are. A table has a line for each row and a column
for each method; a cell joins the row's parts, each a statistic of one metric over all
runs. Limits come from `judged.toml`. What the campaign gave stands in `figures.json`,
with its commit, and between the marks of each page:

    <!-- figures: NAME -->
    ...
    <!-- end of figures -->
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import msgspec
import numpy as np

from benchmarks import ResultsError
from benchmarks.judging import (
    ANY,
    TARGETS,
    Statistic,
    Target,
    expand_groups,
    metric,
    sum_up,
)
from benchmarks.results import METHOD_NAMES, Row

ROOT = Path(__file__).resolve().parents[2]
SPECS = ROOT / "benchmarks" / "figures.toml"
STORED = ROOT / "benchmarks" / "figures.json"
NO_FIGURE = "–"
NOT_MEASURED = "not measured"
END = "<!-- end of figures -->"


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
        source: Whose force; see `benchmarks.results.Source`.
        scenarios: Names, patterns of names, or groups.
        joint: Stands between the numbers of a cell.
    """

    what: str
    plant: str
    parts: tuple[Part, ...]
    joint: str = "; "
    source: str = "virtual"
    scenarios: tuple[str, ...] = ("tissue",)

    @property
    def names(self) -> tuple[str, ...]:
        """Names and patterns of its scenarios, groups written out."""
        return expand_groups(self.scenarios)


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


class Figures(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What one campaign gave.

    Attributes:
        commit: Of the code that was measured.
        runs: Number of runs, by plant.
        tables: Lines of each table, by its name.
    """

    commit: str
    runs: dict[str, int]
    tables: dict[str, list[list[str]]]


def read_specs() -> tuple[TableSpec, ...]:
    """Return the tables of `figures.toml`."""
    specs = msgspec.toml.decode(SPECS.read_bytes(), type=dict[str, list[TableSpec]])
    return tuple(specs["table"])


def select_values(
    rows: Iterable[Row], spec: RowSpec, part: Part, method: str
) -> list[float]:
    """Return the values of a part, one for each run that has it."""
    return [
        row.value
        for row in rows
        if row.metric == part.metric
        and row.method == method
        and row.plant == spec.plant
        and row.source == spec.source
        and any(fnmatchcase(row.scenario, name) for name in spec.names)
        and not (metric(part.metric).may_be_undefined and np.isnan(row.value))
    ]


def summarize_part(values: Sequence[float], part: Part) -> float:
    """Return the statistic of a part; nan if one value is not finite."""
    best = metric(part.metric).best
    return sum_up(values, part.statistic, lambda value: abs(value - best))


def find_target(spec: RowSpec, part: Part) -> Target | None:
    """Return the target of a part.

    A metric of a closed loop has its target on the plant `clean`: that of every plant
    in the table is judged by it.
    """
    plants = (spec.plant, "clean") if spec.scenarios != ("tissue",) else (spec.plant,)
    for plant in plants:
        for target in TARGETS:
            is_same = (target.metric, target.plant) == (part.metric, plant)
            is_source = target.source in (spec.source, ANY)
            is_whole = not target.scenarios or set(target.scenarios) >= set(spec.names)
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
    return NO_FIGURE if is_bare else "; ".join(limits)


def show_mark(spec: RowSpec, ours: Sequence[float]) -> str:
    """Return whether our figures keep their limits, and which does not."""
    judged = []
    for part, value in zip(spec.parts, ours, strict=True):
        target = find_target(spec, part)
        if target is not None:
            judged.append((metric(part.metric).meaning, target.is_met_by(value)))
    if not judged:
        return ""
    missed = [number for number, (_, is_met) in enumerate(judged, 1) if not is_met]
    if not missed:
        return "met"
    if len(judged) == 1:
        return "**missed**"
    ordinals = {1: "first", 2: "second", 3: "third"}
    return f"**missed** ({', '.join(ordinals[number] for number in missed)})"


def fill_line(rows: Sequence[Row], table: TableSpec, spec: RowSpec) -> list[str]:
    """Return a line of a table: its cells, its limits, and whether they are kept."""
    cells = [spec.what]
    ours: list[float] = []
    for method in table.methods:
        values = [select_values(rows, spec, part, method) for part in spec.parts]
        if not all(values):
            cells.append(NO_FIGURE)
            continue
        figures = [
            summarize_part(*pair) for pair in zip(values, spec.parts, strict=True)
        ]
        cells.append(spec.joint.join(map(Part.show, spec.parts, figures)))
        ours = figures if method == "ours" else ours
    mark = show_mark(spec, ours) if ours else NOT_MEASURED
    return [*cells, show_limits(spec), mark]


def fill_figures(rows: Sequence[Row], commit: str) -> Figures:
    """Return the figures of a campaign.

    Args:
        rows: All its results.
        commit: Of the code that was measured.
    """
    runs: dict[str, set[tuple[str, int]]] = {}
    for row in rows:
        runs.setdefault(row.plant, set()).add((row.scenario, row.seed))
    return Figures(
        commit=commit,
        runs={plant: len(names) for plant, names in sorted(runs.items())},
        tables={
            table.name: [fill_line(rows, table, spec) for spec in table.row]
            for table in read_specs()
        },
    )


def render_table(table: TableSpec, figures: Figures) -> str:
    """Return a table for its pages, with the commit that it was measured on.

    Lines that the campaign did not measure are named below it.
    """
    names = [METHOD_NAMES[method] for method in table.methods]
    heads = ["", *names, "target", ""]
    rule = ["---", *("---:" for _ in names), "---", "---"]
    filled = figures.tables[table.name]
    measured = [line for line in filled if line[-1] != NOT_MEASURED]
    left_out = [line[0] for line in filled if line[-1] == NOT_MEASURED]
    lines = [heads, rule, *measured]
    runs = ", ".join(f"{count} on `{plant}`" for plant, count in figures.runs.items())
    body = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    text = f"{body}\n\nMeasured on commit {figures.commit}; runs: {runs}."
    if left_out:
        text += f" Not measured in this campaign: {'; '.join(left_out)}."
    return text


def fill_pages(figures: Figures) -> Mapping[Path, str]:
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
                raise ResultsError(
                    f"{name} has no block from '{begin}' to '{END}': add it where "
                    "the table is to stand"
                )
            filled = f"{begin}\n{render_table(table, figures)}\n{END}"
            texts[page] = block.sub(lambda _, filled=filled: filled, text)
    return texts


def read_figures() -> Figures:
    """Return the figures of the campaign that the pages show."""
    return msgspec.json.decode(STORED.read_bytes(), type=Figures)


def write_figures(figures: Figures) -> None:
    """Write the figures to `figures.json` and into their pages."""
    pages = fill_pages(figures)
    encoded = msgspec.json.format(msgspec.json.encode(figures), indent=1)
    STORED.write_bytes(encoded + b"\n")
    for page, text in pages.items():
        page.write_text(text, encoding="utf-8")
