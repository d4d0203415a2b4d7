"""The page: figures, tables and numbers of a run in one file."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.jobs import Drawing, Job
from benchmarks.judging import GELS
from benchmarks.report.published_figures import (
    FRICTION_FIGURE,
    PUBLISHED_FIGURES,
    TABLE_ONE,
    PublishedFigure,
    TABLE_ONE_Ns_per_m,
)
from benchmarks.report.tables import (
    CUMULATIVE,
    TABLES,
    Frame,
    ResultTable,
    answer,
    build_table,
    frame_of,
    result_tables,
    results_page,
    select,
)
from benchmarks.results import Row, to_json
from foundation.arrays import Array
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    Page,
    PageFigure,
    PageTable,
    Panel,
    Section,
    palette,
    save_page_figure,
    write_page,
)
from needleforce.plots.drawing import write_file
from needleforce.plots.page import PAGE

PLANTS = ("clean", "fri", "degraded", "ideal", "needle")
"""The first of these on which a figure was run is shown."""
SPEEDS = {"constant": palette.BLUE, "sinusoidal": palette.VERMILION}
"""With their colours in the publication."""
PERCENTS = tuple(TABLE_ONE_Ns_per_m)


Estimate = tuple[str, str, str]
"""Which friction of a gel: ``true``, ``offline`` or ``online``; source and method."""
TRUE: Estimate = ("true", "ft", "ours")
OFFLINE: Estimate = ("offline", "ft", "ours")
TUNED: Estimate = ("online", "ft", "published-as-authors-ran")
ONLINE: Estimate = ("online", "ft", "ours")
VIRTUAL: Estimate = ("online", "virtual", "ours")


def gel_friction(rows: Iterable[Row]) -> Frame | None:
    """Return the gels' friction [Ns/m] on the best plant they were run on.

    None without any.
    """
    gel_rows = [
        row
        for row in rows
        if row.scenario in GELS and row.metric.startswith("cumulative_")
    ]
    plant = _best_plant({row.plant for row in gel_rows})
    return frame_of(row for row in gel_rows if row.plant == plant) if plant else None


def _best_plant(plants: set[str]) -> str:
    """Return the first plant of `PLANTS` among some; empty for none."""
    return next((plant for plant in PLANTS if plant in plants), "")


def _medians(gels: Frame, estimate: Estimate, speed: str) -> list[float]:
    """Return the medians of all seeds at a speed, one per gel; nan for none."""
    kind, source, method = estimate
    mine = select(gels, metric=CUMULATIVE.format(kind), source=source, method=method)
    names = [f"gel-{percent}-{speed}" for percent in PERCENTS]
    return [float(select(mine, scenario=name)["value"].median()) for name in names]


def friction_chart(title: str, gels: Frame) -> Chart:
    """Return the chart after the published Figure 10.

    From the left the published means of a gel, then ours.
    """
    places = np.arange(3.0)
    first = -0.2
    step = 0.14
    known = TABLE_ONE_Ns_per_m.values()
    grey = LineStyle(color=palette.GREY, marker="^", size_pt=6.0)
    star = replace(grey, marker="*", size_pt=8.0)
    left = places - 0.36
    points: list[tuple[LineStyle, Array, Sequence[float] | Array, str]] = [
        (grey, left, [gel.offline for gel in known], "published, offline"),
        (star, left, [gel.online for gel in known], "published, online"),
    ]
    series = (
        ("offline", OFFLINE, "^"),
        ("ours, F/T", ONLINE, "*"),
        ("ours, virtual", VIRTUAL, "D"),
        ("published", TUNED, "x"),
    )
    for k, (words, estimate, marker) in enumerate(series):
        for speed, color in SPEEDS.items():
            style = LineStyle(
                color=color, marker=marker, size_pt=7.0 if marker == "*" else 5.5
            )
            values = _medians(gels, estimate, speed)
            if np.isfinite(values).any():
                x = places + first + k * step
                points.append((style, x, values, f"{words}, {speed}"))
    # The truth: short lines across each group.
    ends = np.array([first - 0.06, first + 3 * step + 0.06, math.nan])
    for speed, style in zip(SPEEDS, (palette.TRUE, palette.TRUE_PART), strict=True):
        x = np.add.outer(places, ends).ravel()
        values = np.repeat(_medians(gels, TRUE, speed), 3)
        points.append((style, x, values, f"ground truth, {speed}"))
    curves = [
        Curve(style=style, x=x, y=np.array(y), label=label)
        for style, x, y, label in points
    ]
    return Chart(
        title=title,
        x_label="isinglass in the gel",
        panels=(Panel(y_label="cumulative friction [Ns/m]", curves=tuple(curves)),),
        x_limits=(-0.6, 2.6),
        x_ticks=tuple((float(k), f"{percent} %") for k, percent in enumerate(PERCENTS)),
    )


def published_sections(
    drawings: Sequence[Drawing], rows: Sequence[Row]
) -> list[Section]:
    """Return a section for each published figure that these runs give in part."""
    sections = []
    gels = gel_friction(rows)
    of_gels = set() if gels is None else set(gels["scenario"])
    for item in PUBLISHED_FIGURES:
        mine = chosen(drawings, item.number)
        if item.number == TABLE_ONE and gels is not None:
            table = page_table(build_table(TABLES["table I"], gels))
            sections.append(_section(item, (), (table,), of_gels))
        elif mine:
            here = {drawing.job.benchmark for drawing in mine}
            here = of_gels if item.number == FRICTION_FIGURE else here
            sections.append(_section(item, mine, _facts(item, mine), here))
    return sections


def chosen(drawings: Iterable[Drawing], figure: str) -> list[Drawing]:
    """Return the panels of a figure, on the one plant that is shown."""
    panels = [drawing for drawing in drawings if drawing.figure == figure]
    best = _best_plant({drawing.job.plant for drawing in panels})
    mine = [drawing for drawing in panels if drawing.job.plant == best]
    return sorted(mine, key=lambda drawing: drawing.panel)


def further_sections(drawings: Sequence[Drawing]) -> list[Section]:
    """Return the runs that are the counterpart of no figure.

    Or that were made with another plant model as well.
    """
    used = {
        id(drawing)
        for item in PUBLISHED_FIGURES
        for drawing in chosen(drawings, item.number)
    }
    groups: dict[tuple[str, str], list[Drawing]] = {}
    for drawing in drawings:
        if id(drawing) not in used:
            groups.setdefault((drawing.job.benchmark, drawing.job.plant), []).append(
                drawing
            )
    return [
        Section(
            heading=f"Further run: `{scenario}`, {mine[0].job.where}",
            anchor=f"run-{scenario}-{plant}",
            figures=tuple(map(_figure, mine)),
        )
        for (scenario, plant), mine in groups.items()
    ]


def _section(
    item: PublishedFigure,
    mine: Sequence[Drawing],
    tables: tuple[PageTable, ...],
    here: set[str],
) -> Section:
    """Return the section of a published figure."""
    absent = ", ".join(name for name in item.scenarios if name not in here)
    notice = f"Not among these runs, so missing here: {absent}. For all panels run:"
    return Section(
        heading=f"{item.name}: {item.title}",
        anchor=item.name.replace("Figure ", "figure-").replace("Table ", "table-"),
        paragraphs=(f"Published: {item.shows}", f"To compare: {item.see}"),
        notices=(notice,) if absent else (),
        figures=tuple(map(_figure, mine)),
        tables=tables,
        command=item.command if absent else "",
    )


def _figure(drawing: Drawing) -> PageFigure:
    """Return a figure, with its run in the caption."""
    shown = drawing.shown
    job = drawing.job
    return replace(
        shown, caption=f"{shown.caption} From `{job.benchmark}`, {job.where}."
    )


def _facts(item: PublishedFigure, mine: Sequence[Drawing]) -> tuple[PageTable, ...]:
    """Return the table of a figure's numbers, if it has any."""
    facts = [fact for drawing in mine for fact in drawing.facts]
    if not facts:
        return ()
    head = tuple(facts[0])
    rows = tuple(tuple(fact.values()) for fact in facts)
    return (
        PageTable(caption=f"Figure {item.number}, in numbers", head=head, rows=rows),
    )


def page_table(table: ResultTable) -> PageTable:
    """Return a table of the terminal, without colours."""
    return PageTable(
        caption=table.title,
        head=table.heads,
        rows=table.lines,
        numeric=frozenset(k for k, align in enumerate(table.align) if align == "r"),
        note=table.caption,
    )


TITLE = "needleforce: the published figures, from our own runs"
LEAD = (
    "Counterparts of the figures of “Online needle-tissue interaction model "
    "identification for force feedback enhancement in robot-assisted interventional "
    "procedures” (Ferro, Gaz, Anzidei, Vendittelli). The insertions are simulated, so "
    "the true force is known; the estimators get only the signals that a robot would "
    "give them.",
    "Blue, continuous: our method, one setting for everything. Orange, dashed: the "
    "published method; in Figures 8 to 14 with its authors' settings (commanded "
    "speed, σ₁ set for each recording), in the tables of all numbers also with one "
    "setting and the measured speed. Black, dotted: the ground truth. Times count "
    "from the start of the needle's motion. Forces are positive when tissue pushes "
    "back.",
)


def write_report(
    folder: Path,
    rows: Sequence[Row],
    drawings: Sequence[Drawing],
    *,
    with_targets: bool = False,
) -> Path:
    """Write ``index.html`` with everything inside; beside it numbers and tables.

    The numbers are ``results.json``, the tables ``results.md``.

    Raises:
        FiguresError: A file cannot be written.
    """
    write_file(folder / "results.json", to_json(rows))
    command = "python -m benchmarks results results.json --page results.md"
    page = results_page(rows, command, with_targets=with_targets)
    write_file(folder / "results.md", page.encode())
    gels = gel_friction(rows)
    everything = [
        *drawings,
        *([] if gels is None else [_friction_drawing(folder, gels)]),
    ]
    figures = published_sections(everything, rows)
    tables = result_tables(rows, with_targets=with_targets)
    numbers = Section(
        heading="All numbers of these runs",
        anchor="numbers",
        paragraphs=(
            "As printed by the command; `results.json` beside this page has them all.",
        ),
        tables=tuple(map(page_table, tables)),
    )
    sections = [*figures, *further_sections(everything), numbers]
    return write_page(
        folder / PAGE,
        Page(
            title=TITLE,
            lead=tuple(filter(None, (answer(rows), *LEAD))),
            sections=tuple(sections),
        ),
    )


def _friction_drawing(folder: Path, gels: Frame) -> Drawing:
    """Draw the friction of the gels."""
    plant = gels["plant"].iloc[0]
    seeds = gels["seed"].nunique()
    run = "needle without an arm" if plant == "needle" else f"{plant} plant"
    title = f"Figure {FRICTION_FIGURE}: cumulative friction of the gels\n{run}"
    shown = save_page_figure(
        friction_chart(title, gels),
        folder / f"figure-{FRICTION_FIGURE}-{plant}.svg",
        alt="Cumulative friction of the 25, 50 and 70 % gel: the published means and "
        "ours, offline and online, at both speeds",
        caption="Cumulative friction [Ns/m] by gel. Grey: the published means over "
        "both speeds (Table I). Triangles: offline; stars: ours online on the F/T "
        "sensor's force; diamonds: on the virtual sensor's; crosses: the published "
        "method on the F/T sensor's, with its authors' settings. The sinusoidal "
        "speed is lower at the rupture, and friction over speed is then another "
        f"number: hence two lines of ground truth. Medians over {seeds} "
        f"seed{'' if seeds == 1 else 's'}.",
        is_alone=True,
    )
    job = Job(benchmark="gel-*", plant=plant)
    return Drawing(figure=FRICTION_FIGURE, job=job, shown=shown)
