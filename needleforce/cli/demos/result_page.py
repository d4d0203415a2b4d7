"""What a demonstration has to show: a table, and a page with its figures."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from needleforce import plots
from needleforce.cli.terminal import aligned, write_out
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    PageFigure,
    Panel,
)

Drawn = Callable[[Path], list[PageFigure]]  # into a folder


NEVER = "Simulation only: not a medical device."


class DemoResult(NamedTuple):
    """What a demonstration has to show.

    Attributes:
        charts: Name of the file, the chart, its caption.
    """

    title: str
    rows: tuple[tuple[str, str], ...]
    charts: tuple[tuple[str, Chart, str], ...]

    def write(
        self, kind: str, folder: Path | None, first: Drawn = lambda _: []
    ) -> None:
        """Print the table, and write it with the figures as a page, if there is a
        folder for it.
        """
        write_out(f"{self.title}\n{aligned(self.rows)}{NEVER}\n")
        if folder is None:
            return
        folder.mkdir(parents=True, exist_ok=True)
        figures = first(folder)
        for name, chart, caption in self.charts:
            place = folder / f"{name}.svg"
            figures.append(
                plots.save_page_figure(chart, place, alt=caption, caption=caption)
            )
        table = plots.PageTable(
            caption="Result", head=("what", "value"), rows=self.rows
        )
        content = {"figures": tuple(figures), "tables": (table,)}
        section = plots.Section(heading=self.title, anchor=kind, **content)
        page = plots.Page(
            title=f"needleforce demo {kind}", lead=(NEVER,), sections=(section,)
        )
        write_out(f"{plots.write_page(folder / plots.PAGE, page)}\n")


def panels_over_time(
    t_s: np.ndarray, *rows: tuple[str, LineStyle, np.ndarray]
) -> tuple[Panel, ...]:
    """One panel for each label of the y axis, style and values over time."""
    curves = ((label, Curve(style=style, x=t_s, y=y)) for label, style, y in rows)
    return tuple(Panel(y_label=label, curves=(curve,)) for label, curve in curves)
