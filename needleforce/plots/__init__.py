"""Charts and the self-contained page; knows neither robots nor needles.

A chart is plain data: panels over one axis, curves in them, and what is marked in all of them.
`palette` is the one home of colours, line styles and the words of an axis.

    chart = Chart(title="…", x_label=palette.TIME, panels=(Panel(y_label=palette.FORCE, …),))
    path = save_svg(chart, folder / "force")
    write_page(folder / "index.html", Page(title="…", sections=(Section(…),)))

Reading order: `chart` with `panel` and `curve`, `draw`, `save`; `page` with `section`, `page.css`.
matplotlib is imported only when a chart is drawn.
"""

from needleforce.plots import palette
from needleforce.plots.chart import (
    Chart,
    Curve,
    Instants,
    LineStyle,
    Panel,
    Shading,
    Ticks,
    require_matplotlib,
    save_png,
    save_svg,
)
from needleforce.plots.errors import FiguresError
from needleforce.plots.page import Attachment, Page, PageFigure, PageTable, Section, write_page

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
