"""Charts and the self-contained page; knows neither robots nor needles.

matplotlib and jinja2 are imported only when something is drawn.

Reading order: `chart` (charts as plain data, saved as PNG, SVG or PDF), `palette` (colours, line
styles, words of an axis), `page` (one HTML file with figures, tables and text inside).
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
