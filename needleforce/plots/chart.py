"""Charts: panels over one x axis, drawn with matplotlib for the screen and for print.

A chart is plain data, so what it shows can be tested without drawing it. Equal charts
give equal bytes.

    chart = Chart(title="…", x_label=palette.TIME, panels=(Panel(y_label=palette.FORCE,
    …),)) save_figure(chart.within(10.0, 20.0), "forces.pdf")
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.files import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
Span = tuple[float, float]
Dash = (
    str | tuple[float, tuple[float, ...]]
)  # of matplotlib: "-", or (offset, (on, off, …))


class FiguresError(Exception):
    """Base of every error of this package."""


class MissingExtraError(FiguresError, RuntimeError):
    """Something optional is not installed."""


class ChartError(FiguresError, ValueError):
    """A chart or table that cannot be shown: ragged, empty, or of an unknown format."""


class WriteError(FiguresError, OSError):
    """A file cannot be written, or a figure that a page needs cannot be read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStyle:
    """How one kind of curve or event is drawn; a style with a marker draws no line."""

    color: str
    dash: Dash = "-"
    width_pt: float = 1.1
    opacity: float = 1.0
    marker: str = ""
    size_pt: float = 7.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One line of a panel, arrays of one shape (n,); a value that is not finite is
    not drawn.

    Attributes:
        label: In the legend; None for none there, as for the band.
    """

    style: LineStyle
    x: Array
    y: Array
    label: str | None = None
    std: Array | None = (
        None  # standard deviations: a band of two to either side is shaded
    )
    band_label: str | None = None

    def __post_init__(self) -> None:
        for name in ("x", "y", "std"):
            value = getattr(self, name)
            if value is not None and (np.ndim(value) != 1 or len(value) != len(self.x)):
                raise ChartError(
                    f"curve {self.label!r}: {name} has shape {np.shape(value)} where x has "
                    f"{np.shape(self.x)}; give one value per point"
                )


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One of the panels that share the x axis of a chart; its last curve is drawn on
    top.
    """

    y_label: str
    curves: tuple[Curve, ...]
    limits: Span | None = (
        None  # None for `limits_of` the curves; what is cut off is marked
    )
    height: float = 1.0


class Shading(NamedTuple):
    """Spans of the x axis behind the curves of every panel, each at least so wide
    that it shows.
    """

    label: str
    color: str
    spans: tuple[Span, ...]
    least_pt: float = 0.0


class Instants(NamedTuple):
    """Events in every panel: markers on the lower edge, where they hide no peak."""

    label: str
    style: LineStyle
    places: tuple[float, ...]


WIDTH_IN = 4.4
WIDE_IN = 8.4
"""Beside another chart (its letters can be read at the width of a phone), and alone
on a page."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Panels below each other over one x axis, with one legend below them; at least
    one panel.

    Attributes:
        title: First line: what is shown, in bold; further lines: of which run.
        panels: From above.
        shadings: Marked in every panel, as the next.
        x_limits: None for what the curves need.
        x_ticks: Places and what stands there; none for numbers.
        height_in: Without the legend.
    """

    title: str
    x_label: str
    panels: tuple[Panel, ...]
    shadings: tuple[Shading, ...] = ()
    instants: tuple[Instants, ...] = ()
    x_limits: Span | None = None
    x_ticks: tuple[tuple[float, str], ...] = ()
    width_in: float = WIDTH_IN
    height_in: float = 3.0

    def __post_init__(self) -> None:
        if not self.panels:
            raise ChartError(f"chart {self.title!r} has no panel; give at least one")

    def within(self, first: float, last: float) -> "Chart":
        """The same between two places of the x axis, with y axes for what is seen
        there.
        """
        if not first < last:
            raise ChartError(
                f"window from {first:g} to {last:g}; the end must lie after the start"
            )
        panels = tuple(replace(panel, limits=None) for panel in self.panels)
        return replace(self, panels=panels, x_limits=(first, last))


# per cent of a curve, and of its band's edges, that show
MOST_OF = 99.8
MOST_OF_BAND = 95.0
MARGIN = 0.06


def limits_of(curves: Sequence[Curve], x_limits: Span | None) -> Span:
    """Lower and upper limit: zero, and most of every curve and its band."""
    edges = [0.0]
    for curve in curves:
        seen = np.isfinite(curve.y) & _inside(curve.x, x_limits)
        if not seen.any():
            continue
        y = curve.y[seen]
        edges += [*np.percentile(y, (100.0 - MOST_OF, MOST_OF))]
        if curve.std is not None:
            band = np.nan_to_num(2.0 * curve.std[seen], posinf=0.0)
            edges += [np.percentile(y - band, 100.0 - MOST_OF_BAND)]
            edges += [np.percentile(y + band, MOST_OF_BAND)]
    low = float(min(edges))
    high = float(max(edges))
    margin = MARGIN * (high - low) or 1.0
    return low - margin, high + margin


def _inside(x: Array, x_limits: Span | None) -> NDArray[np.bool_]:
    low, high = x_limits or (-np.inf, np.inf)
    return (x >= low) & (x <= high) & np.isfinite(x)


STYLE = Path(__file__).with_name("chart.mplstyle")
"""Must hold while a chart is drawn and while it is saved."""
BAND_OPACITY = 0.2
AREA_POINTS = 1000
LETTERS = 54  # of a title's line at the usual width
LEGEND_ROW_IN = 0.17
CUT_PLACES = 40  # marks of cut curves along an edge at most
_NOT_TEXT = re.compile("[\x00-\x09\x0b-\x1f\x7f-\x9f\ud800-\udfff\ufffe\uffff]")


def printable(text: str) -> str:
    r"""Text that XML and UTF-8 can hold: bytes of a file name that cannot become
    ``\udcff``.
    """
    return _NOT_TEXT.sub(
        lambda found: found.group().encode("unicode_escape").decode(), text
    )


def draw(chart: Chart) -> "Figure":
    """Draw a chart; no window and no global state of matplotlib is involved."""
    from matplotlib.figure import Figure

    figure = Figure(
        (chart.width_in, chart.height_in), layout="constrained", facecolor="white"
    )
    heights = [panel.height for panel in chart.panels]
    grid = figure.subplots(
        len(heights), sharex=True, squeeze=False, height_ratios=heights
    )
    places = list(grid[:, 0])
    for axes, panel in zip(places, chart.panels, strict=True):
        _draw_marks(axes, chart)
        axes.axhline(0.0, color="#555555", linewidth=0.6)
        for curve in panel.curves:
            _draw_curve(axes, curve, chart.x_limits)
        limits = panel.limits or limits_of(panel.curves, chart.x_limits)
        axes.set(ylabel=panel.y_label, ylim=limits)
        for edge, side in zip(limits, (-1.0, 1.0), strict=True):
            _mark_what_is_cut(axes, panel.curves, edge, side, chart.x_limits)
    figure.align_ylabels(places)
    places[-1].set(xlabel=chart.x_label, xlim=chart.x_limits)
    if chart.x_ticks:
        places[-1].set_xticks(*zip(*chart.x_ticks, strict=True))
    room = chart.width_in / WIDTH_IN * LETTERS
    what, *which = (
        "\n".join(wrap(line, int(room))) for line in printable(chart.title).split("\n")
    )
    figure.suptitle(what, x=0.01, ha="left", fontsize=9.5, fontweight="bold")
    # The pad leaves room for the values of cut peaks above the panel.
    places[0].set_title(
        "\n".join(which), loc="left", fontsize=8.5, color="#444444", pad=10.0
    )
    rows = _legend(figure, places, chart)
    figure.set_size_inches(chart.width_in, chart.height_in + rows * LEGEND_ROW_IN)
    return figure


def _draw_marks(axes: "Axes", chart: Chart) -> None:
    from matplotlib.transforms import ScaledTranslation

    for label, color, spans, least_pt in chart.shadings:
        for first, last in spans:
            axes.axvspan(
                first, last, color=color, linewidth=least_pt, label=label, zorder=0.4
            )
    for label, style, places in chart.instants:
        lift = ScaledTranslation(
            0.0, style.size_pt / 144.0, axes.figure.dpi_scale_trans
        )
        if places:
            line: dict[str, Any] = {
                "transform": axes.get_xaxis_transform() + lift,
                "zorder": 4,
            }
            axes.plot(
                places, np.zeros(len(places)), label=label, **line, **_line(style)
            )


def _draw_curve(axes: "Axes", curve: Curve, x_limits: Span | None) -> None:
    x = curve.x
    y = curve.y
    style = curve.style
    if curve.std is not None:
        low = y - 2.0 * curve.std
        high = y + 2.0 * curve.std
        # matplotlib thins lines, not areas. All NaN stay, so that no gap is bridged.
        seen = np.flatnonzero(_inside(x, x_limits))
        some = np.union1d(
            seen[:: len(seen) // AREA_POINTS + 1], np.flatnonzero(np.isnan(low))
        )
        band: dict[str, Any] = {"color": style.color, "label": curve.band_label}
        axes.fill_between(
            x[some], low[some], high[some], alpha=BAND_OPACITY, linewidth=0, **band
        )
        for edge in (low, high):  # above the curve, whose noise may fill the band
            axes.plot(x, edge, color=style.color, linewidth=0.5, alpha=0.6, zorder=3)
    axes.plot(x, y, label=curve.label, **_line(style))


def _line(style: LineStyle) -> dict[str, Any]:
    line: dict[str, Any] = {"color": style.color, "alpha": style.opacity}
    if not style.marker:
        return line | {"linestyle": style.dash, "linewidth": style.width_pt}
    mark = {"marker": style.marker, "ms": style.size_pt, "mew": style.width_pt}
    return line | mark | {"linestyle": "none"}


def _mark_what_is_cut(
    axes: "Axes",
    curves: Sequence[Curve],
    edge: float,
    side: float,
    x_limits: Span | None,
) -> None:
    """Triangles where curves leave the panel, and beside the farthest its value."""
    farthest = (edge, 0.0, "")
    shape = {"marker": "^" if side > 0 else "v", "markersize": 3.5}
    for curve in curves:
        beyond = (side * curve.y > side * edge) & _inside(curve.x, x_limits)
        if not beyond.any():
            continue
        x = curve.x[beyond]
        y = curve.y[beyond]
        color = curve.style.color
        step = np.ptp(x_limits or curve.x[np.isfinite(curve.x)]) / CUT_PLACES or 1.0
        marked = step * np.unique(np.round(x / step))
        edges = np.full(len(marked), edge)
        axes.plot(marked, edges, " ", color=color, clip_on=False, zorder=5, **shape)
        k = int(np.argmax(side * y))
        if side * y[k] > side * farthest[0]:
            farthest = float(y[k]), float(x[k]), color
    value, place, color = farthest
    if color:
        text = f"{value:.3g}" if abs(value) < 1e3 else f"{value:.0f}"
        text = text.replace("-", "\N{MINUS SIGN}")
        aside, side_x = (
            ("right", -4.0) if place > np.mean(axes.get_xlim()) else ("left", 4.0)
        )
        small: dict[str, Any] = {
            "fontsize": 7.0,
            "color": color,
            "va": "bottom",
            "ha": aside,
        }
        axes.annotate(
            text, (place, edge), (side_x, 2.0), textcoords="offset points", **small
        )


def _legend(figure: "Figure", places: list["Axes"], chart: Chart) -> int:
    """One legend for all panels, below them, where it hides nothing; returns its
    rows.
    """
    shown: dict[str, Any] = {}
    for axes in places:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, handle)
    if not shown:
        return 0
    marks = [mark.label for mark in (*chart.shadings, *chart.instants)]
    labels = sorted(shown, key=lambda label: label in marks)
    handles = [shown[label] for label in labels]
    for columns in (4, 3, 2, 1):
        legend = figure.legend(handles, labels, loc="outside lower left", ncols=columns)
        if legend.get_window_extent().width <= figure.bbox.width:
            break
        if columns > 1:
            legend.remove()
    return -(-len(labels) // columns)


FORMATS: dict[str, dict[str, Any]] = {
    ".png": {"dpi": 160},
    ".svg": {"metadata": {"Date": None}},
    ".pdf": {"metadata": {"CreationDate": None}},
}
"""Suffix and what matplotlib needs to know; a date would make equal charts differ."""


def require_matplotlib(what: str, path: str | Path | None = None) -> None:
    """Find out before the work what could not be drawn after it.

    `MissingExtraError` if matplotlib or jinja2 is not installed, which ``what``, such
    as ``--report``, needs; `ChartError` if the path of a figure does not end in one of
    `FORMATS`.
    """
    if path is not None and Path(path).suffix.lower() not in FORMATS:
        raise ChartError(
            f"cannot write {path}: its name must end in one of {', '.join(FORMATS)}"
        )
    try:
        import jinja2  # noqa: F401
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            f"{what} needs {error.name or 'matplotlib'}, which is not installed; "
            "pip install matplotlib jinja2"
        ) from error


def save_figure(chart: Chart, path: str | Path) -> Path:
    """Draw a chart and write it as PNG, SVG or PDF, by the ending of its name; returns
    its path.

    Raises as `require_matplotlib`, and `WriteError` if the file cannot be written.
    """
    require_matplotlib("a figure", path)
    from matplotlib import rc_context

    suffix = Path(path).suffix.lower()
    content = BytesIO()
    with rc_context(fname=STYLE), warnings.catch_warnings():
        # A file name in a script that the font lacks is drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        draw(chart).savefig(content, format=suffix[1:], **FORMATS[suffix])
    drawn = content.getvalue()
    if suffix == ".svg":
        # A tenth of a point is finer than any line; the other digits are half of the
        # file.
        drawn = re.sub(rb" \nL (-?\d+\.\d)\d* (-?\d+\.\d)\d*", rb"L\1 \2", drawn)
    return write_file(path, drawn)


def write_file(path: str | Path, content: bytes) -> Path:
    """Write a file whole, or raise `WriteError`: a full disk leaves the older one as
    it was.
    """
    try:
        with whole_file(path) as file:
            file.write(content)
    except OSError as error:
        raise WriteError(f"cannot write {path}: {error.strerror or error}") from error
    return Path(path)
