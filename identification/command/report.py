"""The report: chart, layers, warnings and settings of a log in one page."""

from pathlib import Path

from figures import Page, PageFigure, PageTable, Section, save_svg, write_page
from figures.report_folder import PAGE
from figures.settings_table import settings_table
from identification.command.arguments import METHODS
from identification.command.figure import identification_chart
from identification.command.layer_table import HEADER, layer_cells
from identification.command.result import IdentificationResult

_CAPTION = (
    "Above, the axial force as it was recorded, what the model expected, the enhanced force (less "
    "what was read in free air and the friction of the layers left) and the force at the tip. "
    "Below, stiffness and friction of the layer the tip is in, and the friction of all layers "
    "left; the band, where the method states one, is two standard deviations wide to either side. "
    "Continuous upright lines: ruptures as dated; dashed: friction identified and taken off from "
    "there on. Transients may leave the lower panels."
)


def write_report(folder: Path, result: IdentificationResult) -> Path:
    """Write ``index.html``, which needs no other file, and beside it the chart.

    Args:
        folder: Exists.
        result: With an overview.

    Returns:
        The page.

    Raises:
        figures.FiguresError: A file cannot be written.
    """
    figure = PageFigure(
        path=save_svg(identification_chart(result), folder / "layers"),
        alt=f"Forces and identified parameters of {result.log} over time",
        caption=_CAPTION,
    )
    page = Page(
        title=f"Layers in {result.log}",
        lead=(f"Made by `python -m identification`, method {result.method}.",),
        sections=(
            Section(
                heading="Forces and parameters",
                anchor="forces",
                notices=tuple(f"Warning: {text}" for text in result.warnings),
                figures=(figure,),
            ),
            _layers(result),
            Section(
                heading="Settings",
                anchor="settings",
                paragraphs=("SI units.",),
                tables=(settings_table(METHODS[result.method], f"Method {result.method}"),),
            ),
        ),
    )
    return write_page(folder / PAGE, page)


def _layers(result: IdentificationResult) -> Section:
    if not result.layers:
        nothing = "No layer was left: no rupture was found."
        return Section(heading="Layers", anchor="layers", paragraphs=(nothing,))
    table = PageTable(
        caption="Layers left",
        head=HEADER,
        rows=tuple(layer_cells(layer, result.clock) for layer in result.layers),
        numeric=frozenset(range(len(HEADER))),
        note="Times on the log's clock. A ? marks what the data do not identify.",
    )
    return Section(heading="Layers", anchor="layers", tables=(table,))
