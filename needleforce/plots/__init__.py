"""Figures in files, and the self-contained page; knows neither robots nor needles.

matplotlib and jinja2 are imported only when something is drawn.

Reading order: `palette` (colours, words of an axis), `drawing` (figures saved as PNG,
SVG or PDF), `page` (one HTML file with figures, tables and text inside),
`report_folder`, `plan_slices` (a CT along a path), `errors`.
"""

from needleforce.plots import palette as palette
from needleforce.plots.drawing import (
    STYLE as STYLE,
    WIDE_IN as WIDE_IN,
    WIDTH_IN as WIDTH_IN,
    add_legend as add_legend,
    draw_line as draw_line,
    make_panels as make_panels,
    mark_instants as mark_instants,
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
    settings_table as settings_table,
    write_page as write_page,
)
from needleforce.plots.plan_slices import (
    draw_along as draw_along,
    draw_probe_view as draw_probe_view,
)
from needleforce.plots.report_folder import whole_folder as whole_folder
