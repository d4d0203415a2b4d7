"""The report: charts, summary, warnings and settings of a log in one page."""

from collections.abc import Sequence
from pathlib import Path

from figures import Page, PageFigure, PageTable, Section, save_svg, write_page
from figures.report_folder import PAGE
from figures.settings_table import settings_table
from residual.command.force_chart import force_chart, travel_chart
from residual.command.force_result import ForceResult
from residual.command.summary import summary_rows


def write_report(folder: Path, result: ForceResult, warnings: Sequence[str]) -> Path:
    """Write ``index.html``, which needs no other file, and beside it the charts.

    Args:
        folder: Exists.
        result: The estimates.
        warnings: What was told about the log.

    Returns:
        The page.

    Raises:
        figures.FiguresError: A file cannot be written.
    """
    page = Page(
        title=f"Forces from {result.log}",
        lead=(f"Made by `python -m residual`: {result.sensor_line}.",),
        sections=(
            Section(
                heading="Forces",
                anchor="forces",
                notices=tuple(f"Warning: {text}" for text in warnings),
                figures=tuple(_figures(folder, result)),
            ),
            Section(heading="Summary", anchor="summary", tables=(_summary(result),)),
            Section(
                heading="Settings",
                anchor="settings",
                paragraphs=("As in a file for `--config`; SI units.",),
                tables=(settings_table(result.config, "Sensor"),),
            ),
        ),
    )
    return write_page(folder / PAGE, page)


def _figures(folder: Path, result: ForceResult) -> list[PageFigure]:
    over_time = PageFigure(
        path=save_svg(force_chart(result), folder / "forces"),
        alt=f"Estimated forces of {result.log} over time",
        caption="The force of the environment on the tool; the axial force is positive when "
        "tissue pushes back. The band is two standard deviations wide to either side: model "
        "errors, offsets and noise as the tare has learnt them. Grey lines are not tared and "
        "mean little.",
    )
    chart = travel_chart(result)
    if chart is None:
        return [over_time]
    over_travel = PageFigure(
        path=save_svg(chart, folder / "forces-over-travel"),
        alt=f"Axial force of {result.log} over the travel of the tool",
        caption="The same axial force over the travel of the tool along the needle since the "
        "first sample: in tissue the upper branch belongs to the way in, the lower to the way "
        "out.",
    )
    return [over_time, over_travel]


def _summary(result: ForceResult) -> PageTable:
    return PageTable(
        caption="What was used, done and found", head=("", ""), rows=tuple(summary_rows(result))
    )
