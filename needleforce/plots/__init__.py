"""Charts and the self-contained page; knows neither robots nor needles.

matplotlib and jinja2 are imported only when something is drawn.

Reading order: `chart` (charts as plain data), `palette` (colours, line styles, words of
an axis), `drawing` (charts saved as PNG, SVG or PDF), `page` (one HTML file with
figures, tables and text inside), `report_folder`, `errors`.
"""

from needleforce.plots import palette as palette
from needleforce.plots.chart import (
    Chart as Chart,
    Curve as Curve,
    Instants as Instants,
    LineStyle as LineStyle,
    Panel as Panel,
    Shading as Shading,
)
from needleforce.plots.drawing import (
    draw_svg as draw_svg,
    require_matplotlib as require_matplotlib,
    save_figure as save_figure,
)
from needleforce.plots.errors import (
    ChartError as ChartError,
    FiguresError as FiguresError,
    WriteError as WriteError,
)
from needleforce.plots.page import (
    PAGE as PAGE,
    Page as Page,
    PageFigure as PageFigure,
    PageTable as PageTable,
    Section as Section,
    save_page_figure as save_page_figure,
    settings_table as settings_table,
    write_page as write_page,
)
from needleforce.plots.report_folder import whole_folder as whole_folder
