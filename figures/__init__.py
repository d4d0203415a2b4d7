"""Charts and the self-contained page; knows neither robots nor needles.

A chart is plain data: panels over one axis, curves in them, and what is marked in all of them.
`palette` is the one home of colours, line styles and the words of an axis.

    chart = Chart(title="…", x_label=palette.TIME, panels=(Panel(y_label=palette.FORCE, …),))
    path = save_svg(chart, folder / "force")
    write_page(folder / "index.html", Page(title="…", sections=(Section(…),)))

Reading order: `chart` with `panel` and `curve`, `draw`, `save`; `page` with `section`, `page.css`.
matplotlib is imported only when a chart is drawn.
"""

from figures import palette
from figures.chart import Chart
from figures.curve import Curve
from figures.errors import FiguresError
from figures.line_style import LineStyle
from figures.marks import Instants, Shading, Ticks
from figures.page import Page, write_page
from figures.page_figure import PageFigure
from figures.page_table import PageTable
from figures.panel import Panel
from figures.save import require_matplotlib, save_png, save_svg
from figures.section import Attachment, Section

__all__ = [
    "Attachment",
    "Chart",
    "Curve",
    "FiguresError",
    "Instants",
    "LineStyle",
    "Page",
    "PageFigure",
    "PageTable",
    "Panel",
    "Section",
    "Shading",
    "Ticks",
    "palette",
    "require_matplotlib",
    "save_png",
    "save_svg",
    "write_page",
]
