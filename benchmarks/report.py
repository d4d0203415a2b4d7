"""The page: figures, tables and numbers of a run in one file."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from benchmarks.benchmark import Drawing
from benchmarks.paper_figures import FRICTION_FIGURE, PAPER_FIGURES, TABLE_ONE, PaperFigure
from benchmarks.rows import Row, to_json, write_results
from benchmarks.tables import NOTHING, run_tables
from benchmarks.targets import GELS, TABLE_ONE_Ns_per_m
from needleforce.plots import (
    Attachment,
    Chart,
    Curve,
    LineStyle,
    Page,
    PageFigure,
    PageTable,
    Panel,
    Section,
    palette,
    save_svg,
    write_page,
)
from needleforce.plots.page import PAGE

# Cumulative friction of the single gels, gathered from the rows of a run.


PLANTS = ("clean", "fri", "degraded", "ideal", "needle")
"""The first of these on which gels were run is shown."""
SPEEDS = ("constant", "sinusoidal")
PERCENTS = (25, 50, 70)
METRIC = "cumulative_friction_{kind}_Ns_per_m"


@dataclass(frozen=True, slots=True, kw_only=True)
class GelFriction:
    """What the rows of one plant say of the gels.

    Attributes:
        plant: Which.
        rows: Of that plant and these gels.
        tuned: By the published method as its authors ran it, by scenario, seed 0.
    """

    plant: str
    rows: tuple[Row, ...]
    tuned: Mapping[str, float]

    def values(
        self, percent: int, speed: str, kind: str, source: str = "ft", method: str = "default"
    ) -> Sequence[float]:
        """Friction of a gel at a speed in Ns/m, one per seed.

        Args:
            percent: Of isinglass.
            speed: One of `SPEEDS`.
            kind: ``true``, ``offline``, ``online``, or ``tuned``: see `tuned`.
            source: Of the force.
            method: Of the identification.
        """
        if kind == "tuned":
            told = self.tuned.get(f"gel-{percent}-{speed}")
            return [] if told is None else [told]
        wanted = (f"gel-{percent}-{speed}", source, method, METRIC.format(kind=kind))
        return [
            row.value
            for row in self.rows
            if (row.scenario, row.source, row.method, row.metric) == wanted
        ]

    def middle(
        self, percent: int, speed: str, kind: str, source: str = "ft", method: str = "default"
    ) -> float:
        """Median over the seeds of what `values` gives; nan where there is none."""
        found = self.values(percent, speed, kind, source, method)
        return statistics.median(found) if found else float("nan")

    @property
    def scenarios(self) -> set[str]:
        """Gels there are rows for."""
        return {row.scenario for row in self.rows}


def gel_friction(rows: Iterable[Row], drawings: Iterable[Drawing]) -> GelFriction | None:
    """The gels of the best plant they were run on; None without any."""
    found = [row for row in rows if row.scenario in GELS and row.metric.startswith("cumulative_")]
    for plant in PLANTS:
        mine = tuple(row for row in found if row.plant == plant)
        if mine:
            tuned = {
                item.scenario: item.tuned_friction_Ns_per_m
                for item in drawings
                if item.plant == plant and not math.isnan(item.tuned_friction_Ns_per_m)
            }
            return GelFriction(plant=plant, rows=mine, tuned=tuned)
    return None


# The paper's Table I beside ours.


ONLINE = (
    ("published, tuned, F/T", "tuned", "ft", "published"),
    ("published, F/T", "online", "ft", "published"),
    ("ours, F/T", "online", "ft", "default"),
    ("ours, virtual", "online", "virtual", "default"),
)
"""Words, kind, source, method."""


def gel_table(gels: GelFriction) -> PageTable:
    """Mean ± spread over the two speeds (and seeds), and the way from offline in per cent."""
    head = ["gel", "paper\noffline", "paper\nonline", "here\ntrue", "here\noffline"]
    head += [f"here online\n{words}" for words, *_ in ONLINE]
    rows = []
    for percent in PERCENTS:
        published = TABLE_ONE_Ns_per_m[percent]
        offline = _both(gels, percent, "offline")
        rows.append(
            (
                f"{percent} %",
                f"{published.offline} ± {published.offline_spread}",
                f"{published.online} ± {published.online_spread}"
                f" ({100.0 * (published.online / published.offline - 1.0):+.0f} %)",
                _cell(_both(gels, percent, "true")),
                _cell(offline),
                *(_cell(_both(gels, percent, *key), offline) for _, *key in ONLINE),
            )
        )
    return PageTable(
        caption="Cumulative friction of single gels [Ns/m]: mean ± spread over both speeds "
        "(online: difference from offline)",
        head=tuple(head),
        rows=tuple(rows),
        numeric=frozenset(range(1, len(head))),
        note="The paper calls its spread a variance; its size and unit are those of a standard "
        "deviation. Tuned: with the commanded speed, as its authors ran it; else with the speed "
        "that the arm measures, whose noise the published method takes for excitation.",
    )


def _both(
    gels: GelFriction, percent: int, kind: str, source: str = "ft", method: str = "default"
) -> list[float]:
    return [
        value
        for speed in SPEEDS
        for value in gels.values(percent, speed, kind, source=source, method=method)
    ]


def _cell(values: Sequence[float], offline: Sequence[float] = ()) -> str:
    if not values:
        return NOTHING
    mean = statistics.fmean(values)
    spread = f" ± {statistics.pstdev(values):.0f}" if len(values) > 1 else ""
    more = ""
    if offline:
        more = f" ({100.0 * (mean / statistics.fmean(offline) - 1.0):+.0f} %)"
    return f"{mean:.0f}{spread}{more}"


# The parts of the page: one per figure of the paper, one per further run.


def paper_sections(drawings: Sequence[Drawing], rows: Sequence[Row]) -> list[Section]:
    """One section per figure that these runs give, at least in part."""
    sections = []
    for item in PAPER_FIGURES:
        mine = chosen(drawings, item.number)
        if item.number == TABLE_ONE:
            gels = gel_friction(rows, drawings)
            if gels is not None:
                sections.append(_section(item, (), (gel_table(gels),), gels.scenarios))
        elif mine:
            here = {drawing.scenario for drawing in mine}
            if item.number == FRICTION_FIGURE:
                gels = gel_friction(rows, drawings)
                here = gels.scenarios if gels is not None else set()
            sections.append(_section(item, mine, _facts(item, mine), here))
    return sections


def further_sections(drawings: Sequence[Drawing]) -> list[Section]:
    """Runs that are the counterpart of no figure, or were made on another arm as well."""
    used = {drawing.path for item in PAPER_FIGURES for drawing in chosen(drawings, item.number)}
    rest = [drawing for drawing in drawings if drawing.path not in used]
    groups: dict[tuple[str, str], list[Drawing]] = {}
    for drawing in rest:
        groups.setdefault((drawing.scenario, drawing.plant), []).append(drawing)
    return [
        Section(
            heading=f"Further run: {mine[0].provenance}",
            anchor=f"run-{scenario}-{plant}",
            figures=tuple(map(_figure, mine)),
        )
        for (scenario, plant), mine in groups.items()
    ]


def missing_section(sections: Sequence[Section]) -> Section | None:
    """Which command draws the figures that these runs do not give; None if none is missing."""
    here = {section.anchor for section in sections}
    rows = [
        (item.heading, f"`python -m benchmarks run {' '.join(item.scenarios)} --report DIR`")
        for item in PAPER_FIGURES
        if _anchor(item) not in here
    ]
    if not rows:
        return None
    return Section(
        heading="Figures that need other runs",
        anchor="missing",
        paragraphs=("`python -m benchmarks run --report DIR` draws all of them.",),
        tables=(PageTable(caption="Commands", head=("figure", "command"), rows=tuple(rows)),),
    )


def chosen(drawings: Iterable[Drawing], figure: str) -> list[Drawing]:
    """The drawings of a figure, on the one plant that is shown."""
    found = [drawing for drawing in drawings if drawing.figure == figure]
    mine = sorted(found, key=lambda drawing: drawing.panel)
    plants = {drawing.plant for drawing in mine}
    best = next((plant for plant in PLANTS if plant in plants), "")
    return [drawing for drawing in mine if drawing.plant == best]


def _anchor(item: PaperFigure) -> str:
    return f"table-{item.number}" if item.number == TABLE_ONE else f"figure-{item.number}"


def _section(
    item: PaperFigure,
    mine: Sequence[Drawing],
    tables: tuple[PageTable, ...],
    here: set[str],
) -> Section:
    absent = [name for name in item.scenarios if name not in here]
    notice = f"Not among these runs, so not here: {', '.join(absent)}. All of it is drawn by:"
    command = f"python -m benchmarks run {' '.join(item.scenarios)} --report DIR"
    return Section(
        heading=item.heading,
        anchor=_anchor(item),
        paragraphs=(f"In the paper: {item.shows}", f"Here: {item.see}"),
        notices=(notice,) if absent else (),
        figures=tuple(map(_figure, mine)),
        tables=tables,
        command=command if absent else "",
    )


def _figure(drawing: Drawing) -> PageFigure:
    caption = f"{drawing.caption} From {drawing.provenance}."
    return PageFigure(path=drawing.path, alt=drawing.alt, caption=caption)


def _facts(item: PaperFigure, mine: Sequence[Drawing]) -> tuple[PageTable, ...]:
    facts = [fact for drawing in mine for fact in drawing.facts]
    if not facts:
        return ()
    return (
        PageTable(
            caption=f"Figure {item.number}, in numbers",
            head=("", "published", *(head for head, _ in facts[0].here)),
            rows=tuple(
                (fact.what, fact.paper, *(value for _, value in fact.here)) for fact in facts
            ),
        ),
    )


# After the paper's Figure 10: friction of the gels, offline and online.


COLORS = {"constant": palette.BLUE, "sinusoidal": palette.VERMILION}
"""As in the paper."""
SERIES = (
    ("offline", "default", "ft", "^", "offline"),
    ("online", "default", "ft", "*", "ours, F/T"),
    ("online", "default", "virtual", "D", "ours, virtual"),
    ("tuned", "published", "ft", "x", "published"),
)
"""Kind, method, source, marker, words."""
PAPER_PLACE, FIRST_PLACE, STEP = -0.36, -0.2, 0.14


def friction_chart(title: str, gels: GelFriction) -> Chart:
    """One group of points per gel: from the left the paper's means, then ours."""
    curves = [*_paper_points()]
    for k, (kind, method, source, marker, words) in enumerate(SERIES):
        for speed, color in COLORS.items():
            style = LineStyle(color=color, marker=marker, size_pt=7.0 if marker == "*" else 5.5)
            values = [gels.middle(p, speed, kind, source=source, method=method) for p in PERCENTS]
            if np.isfinite(values).any():
                x = np.arange(3.0) + FIRST_PLACE + k * STEP
                label = f"{words}, {speed}"
                curves.append(Curve(style=style, x=x, y=np.array(values), label=label))
    curves += [_truth(gels, speed) for speed in COLORS]
    return Chart(
        title=title,
        x_label="isinglass in the gel",
        panels=(Panel(y_label="cumulative friction [Ns/m]", curves=tuple(curves)),),
        x_limits=(-0.6, 2.6),
        x_ticks=tuple((float(k), f"{percent} %") for k, percent in enumerate(PERCENTS)),
    )


def _paper_points() -> list[Curve]:
    x = np.arange(3.0) + PAPER_PLACE
    published = [TABLE_ONE_Ns_per_m[percent] for percent in PERCENTS]
    style = LineStyle(color=palette.GREY, marker="^", size_pt=6.0)
    return [
        Curve(
            style=style,
            x=x,
            y=np.array([item.offline for item in published]),
            label="paper, offline",
        ),
        Curve(
            style=replace(style, marker="*", size_pt=8.0),
            x=x,
            y=np.array([item.online for item in published]),
            label="paper, online",
        ),
    ]


def _truth(gels: GelFriction, speed: str) -> Curve:
    """Short lines across each group; dotted for the sinusoidal speed."""
    x, y = [], []
    for k, percent in enumerate(PERCENTS):
        value = gels.middle(percent, speed, "true")
        x += [k + FIRST_PLACE - 0.06, k + FIRST_PLACE + 3 * STEP + 0.06, np.nan]
        y += [value, value, np.nan]
    style = palette.TRUE if speed == "constant" else palette.TRUE_PART
    return Curve(style=style, x=np.array(x), y=np.array(y), label=f"truth, {speed}")


# The tables of the terminal as tables of the page.


def page_tables(tables: Sequence[Table]) -> tuple[PageTable, ...]:
    """The same heads and cells, without colours."""
    return tuple(_converted(table) for table in tables)


def _converted(table: Table) -> PageTable:
    columns = table.columns
    cells = [[_plain(cell) for cell in column.cells] for column in columns]
    return PageTable(
        caption=_plain(table.title),
        head=tuple(_plain(column.header) for column in columns),
        rows=tuple(zip(*cells, strict=True)),
        numeric=frozenset(k for k, column in enumerate(columns) if column.justify == "right"),
        note=_plain(table.caption),
    )


def _plain(cell: RenderableType | None) -> str:
    if cell is None:
        return ""
    return cell.plain if isinstance(cell, Text) else Text.from_markup(str(cell)).plain


TITLE = "needleforce: the paper's figures, from our own runs"
LEAD = (
    "Counterparts of the figures of “Online needle-tissue interaction model identification for "
    "force feedback enhancement in robot-assisted interventional procedures” (Ferro, Gaz, "
    "Anzidei, Vendittelli). The insertions are simulated, so the true force is known; the "
    "estimators see only what a robot would give them.",
    "Blue and continuous: our method, one setting for everything. Orange and dashed: the published "
    "method; in Figures 8 to 14 as its authors ran it, with the commanded speed and σ₁ set for "
    "each recording, in the tables of all numbers with one setting and the measured speed, as "
    "ours. Black: the truth; dotted where it is a part of the force. Times count from the "
    "moment the needle sets out. Forces are positive when tissue pushes back.",
)


def write_report(folder: Path, rows: Sequence[Row], drawings: Sequence[Drawing]) -> Path:
    """Write ``index.html`` with everything inside, and ``results.json`` beside it.

    Args:
        folder: Exists, and holds the drawings.
        rows: The numbers.
        drawings: Of all runs.

    Returns:
        The page.

    Raises:
        ResultsError: The numbers cannot be written.
        figures.FiguresError: The page cannot be written.
    """
    write_results(folder / "results.json", rows)
    everything = [*drawings, *_friction_drawing(folder, rows, drawings)]
    figures = paper_sections(everything, rows)
    missing = missing_section(figures)
    sections = [*figures, *further_sections(everything), _numbers(rows)]
    if missing is not None:
        sections.append(missing)
    return write_page(folder / PAGE, Page(title=TITLE, lead=LEAD, sections=tuple(sections)))


def _numbers(rows: Sequence[Row]) -> Section:
    content = to_json(rows).encode()
    return Section(
        heading="All numbers of these runs",
        anchor="numbers",
        paragraphs=("As printed by the command; targets last.",),
        tables=page_tables(run_tables(rows)),
        attachments=(
            Attachment(name="results.json", media_type="application/json", content=content),
        ),
    )


def _friction_drawing(
    folder: Path, rows: Sequence[Row], drawings: Sequence[Drawing]
) -> list[Drawing]:
    gels = gel_friction(rows, drawings)
    if gels is None:
        return []
    title = f"{FRICTION_FIGURE}  friction of the gels\n{gels.plant}"
    seeds = len({row.seed for row in gels.rows})
    path = save_svg(friction_chart(title, gels), folder / f"figure-{FRICTION_FIGURE}-{gels.plant}")
    return [
        Drawing(
            figure=FRICTION_FIGURE,
            scenario="gel-*",
            plant=gels.plant,
            seed=0,
            path=path,
            alt="Cumulative friction of the 25, 50 and 70 % gel: the paper's means and ours, "
            "offline and online, at both speeds",
            caption="Grey: the paper's means over both speeds (its Table I). Triangles: offline; "
            "stars: ours online on the F/T reading; diamonds: on the virtual sensor; crosses: the "
            "published method on the F/T reading, as its authors ran it. The sinusoidal speed is "
            "lower at the rupture, and friction over speed is then another number: hence two "
            f"lines of truth. Medians over {seeds} seed(s).",
        )
    ]
