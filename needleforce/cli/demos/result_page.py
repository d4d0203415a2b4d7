"""What a demonstration shows: a table, and a page with its figures."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

from foundation.arrays import Array
from needleforce import plots
from needleforce.cli.terminal import aligned, write_out
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    PageFigure,
    Panel,
    SpaceChart,
    whole_range_of,
)

NOT_MEDICAL = "Simulation only: not a medical device."


class NamedChart(NamedTuple):
    """A chart of a page.

    Attributes:
        name: Name of its file, without the suffix.
        chart: The chart.
        caption: Its caption.
    """

    name: str
    chart: Chart | SpaceChart
    caption: str


class DemoResult(NamedTuple):
    """What a demonstration shows.

    Attributes:
        title: Title of the table.
        rows: Label and text of every line of the table.
        charts: Charts of the page.
        answer: What the run showed, in a sentence: the heading of the page.
        setting: What was simulated.
    """

    title: str
    rows: tuple[tuple[str, str], ...]
    charts: tuple[NamedChart, ...]
    answer: str = ""
    setting: str = ""

    def print_table(self) -> None:
        """Print the table."""
        text = f"{self.title}\n" + (f"{fill(self.answer)}\n" if self.answer else "")
        write_out(f"{text}{aligned(self.rows)}{NOT_MEDICAL}\n")

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
            caption="The run in numbers", head=("what", "value"), rows=self.rows
        )
        drawn = plots.Section(
            heading=self.title,
            anchor=kind,
            paragraphs=(self.setting,) if self.setting else (),
            figures=tuple(figures),
        )
        numbers = plots.Section(heading="Numbers", anchor="numbers", tables=(table,))
        page = plots.Page(
            title=self.answer or f"needleforce demo {kind}",
            lead=(f"`needleforce demo {kind}`. {NOT_MEDICAL}",),
            sections=(drawn, numbers),
        )
        plots.write_page(folder / plots.PAGE, page)


def panel_over_time(t_s: Array, y_label: str, style: LineStyle, y: Array) -> Panel:
    """Return a panel with one curve over time, with every peak.

    Args:
        t_s: Time [s], shape (n,).
        y_label: Label of the y axis.
        style: Line of the curve.
        y: Values, shape (n,).
    """
    curves = (Curve(style=style, x=t_s, y=y),)
    return Panel(y_label=y_label, curves=curves, limits=whole_range_of(curves))
