"""The parts of the page: one per figure of the paper, one per further run."""

from collections.abc import Iterable, Sequence

from benchmarks.charts.paper_figures import (
    FRICTION_FIGURE,
    PAPER_FIGURES,
    TABLE_ONE,
    PaperFigure,
)
from benchmarks.drawing import Drawing
from benchmarks.report.gel_friction import PLANTS, gel_friction
from benchmarks.report.gel_table import gel_table
from benchmarks.row import Row
from figures import PageFigure, PageTable, Section


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
            head=("", "paper", *(head for head, _ in facts[0].here)),
            rows=tuple(
                (fact.what, fact.paper, *(value for _, value in fact.here)) for fact in facts
            ),
        ),
    )
