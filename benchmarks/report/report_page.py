"""The page: figures, tables and numbers of a run in one file."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.charts.paper_figures import FRICTION_FIGURE
from benchmarks.drawing import Drawing
from benchmarks.report.friction_chart import friction_chart
from benchmarks.report.gel_friction import gel_friction
from benchmarks.report.page_tables import page_tables
from benchmarks.report.sections import further_sections, missing_section, paper_sections
from benchmarks.results_file import to_json, write_results
from benchmarks.row import Row
from benchmarks.tables.run_tables import run_tables
from figures import Attachment, Page, Section, save_svg, write_page
from figures.report_folder import PAGE

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
