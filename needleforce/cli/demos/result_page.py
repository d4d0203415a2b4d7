"""What a demonstration shows: a table, and a page with its figures."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from foundation.arrays import Array
from needleforce import plots
from needleforce.cli.terminal import aligned, write_out
from needleforce.plots import Chart, Curve, LineStyle, PageFigure, Panel

NOT_MEDICAL = "Simulation only: not a medical device."


class NamedChart(NamedTuple):
    """A chart of a page.

    Attributes:
        name: Name of its file, without the suffix.
        chart: The chart.
        caption: Its caption.
    """

    name: str
    chart: Chart
    caption: str


class DemoResult(NamedTuple):
    """What a demonstration shows.

    Attributes:
        title: Title of the table, and of the section of the page.
        rows: Label and text of every line of the table.
        charts: Charts of the page.
    """

    title: str
    rows: tuple[tuple[str, str], ...]
    charts: tuple[NamedChart, ...]

    def print_table(self) -> None:
        """Print the table."""
        write_out(f"{self.title}\n{aligned(self.rows)}{NOT_MEDICAL}\n")

    def write_page(
        self, kind: str, folder: Path, pictures: Sequence[PageFigure] = ()
    ) -> None:
        """Write a page with table and figures into a folder.

        Args:
            kind: The demonstration.
            folder: Folder of the page.
            pictures: Figures that stand before the charts.
        """
        figures = [*pictures]
        for name, chart, caption in self.charts:
            place = folder / f"{name}.svg"
            figures.append(
                plots.save_page_figure(chart, place, alt=caption, caption=caption)
            )
        table = plots.PageTable(
            caption="Result", head=("what", "value"), rows=self.rows
        )
        result = plots.Section(heading=self.title, anchor=kind, tables=(table,))
        drawn = plots.Section(
            heading="Figures", anchor="figures", figures=tuple(figures)
        )
        page = plots.Page(
            title=f"needleforce demo {kind}",
            lead=(NOT_MEDICAL,),
            sections=(result, drawn),
        )
        plots.write_page(folder / plots.PAGE, page)


def panel_over_time(t_s: Array, y_label: str, style: LineStyle, y: Array) -> Panel:
    """Return a panel with one curve over time.

    Args:
        t_s: Time [s], shape (n,).
        y_label: Label of the y axis.
        style: Line of the curve.
        y: Values, shape (n,).
    """
    return Panel(y_label=y_label, curves=(Curve(style=style, x=t_s, y=y),))
