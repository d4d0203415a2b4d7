"""Charts and the self-contained page; knows neither robots nor needles.

`chart` holds charts as plain data and saves them as PNG, SVG or PDF, `palette` the colours, line
styles and words of an axis, `page` one HTML file with figures, tables and text inside (its
template is `page.html`). matplotlib and jinja2 are imported only when something is drawn.
"""

from needleforce.plots import palette
from needleforce.plots.chart import (
    Chart,
    Curve,
    FiguresError,
    Instants,
    LineStyle,
    Panel,
    Shading,
    require_matplotlib,
    save_figure,
)
from needleforce.plots.page import (
    Attachment,
    Page,
    PageFigure,
    PageTable,
    Section,
    folder_if_filled,
    save_page_figure,
    settings_table,
    write_page,
)

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
    "folder_if_filled",
    "palette",
    "require_matplotlib",
    "save_figure",
    "save_page_figure",
    "settings_table",
    "write_page",
]
