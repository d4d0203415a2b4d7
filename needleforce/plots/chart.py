"""A chart as plain data."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from needleforce.plots.errors import ChartError, MissingExtraError, WriteError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# How one kind of curve is drawn.


Dash = str | tuple[float, tuple[float, ...]]
"""As matplotlib takes it: ``-``, ``:``, or (offset, (on, off, …)) in points."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LineStyle:
    """How one kind of curve is drawn.

    Attributes:
        color: As ``#rrggbb``.
        dash: Tells the curves apart where colours do not: in print, and to eyes that mix them up.
        width_pt: Of the line.
        opacity: 0 to 1.
        marker: Of the points, as matplotlib names it; none for a line.
        size_pt: Of the marker.
    """

    color: str
    dash: Dash = "-"
    width_pt: float = 1.1
    opacity: float = 1.0
    marker: str = ""
    size_pt: float = 7.0


# One line of a panel.


Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One line of a panel; nothing is drawn where a value is not finite.

    Attributes:
        style: How it is drawn.
        x: Places, shape (n,), read-only.
        y: Values, shape (n,), read-only.
        label: In the legend; None for none there.
        std: Standard deviations, shape (n,): a band of two is shaded. None for no band.
        band_label: Of the band in the legend; None for none there.
    """

    style: LineStyle
    x: Array
    y: Array
    label: str | None = None
    std: Array | None = None
    band_label: str | None = None

    def __post_init__(self) -> None:
        """Keep read-only copies.

        Raises:
            ChartError: x, y and std do not go together.
        """
        for name in ("x", "y", "std"):
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(value, dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
            if array.ndim != 1 or array.shape != self.x.shape:
                raise ChartError(
                    f"curve {self.label!r}: {name} has shape {array.shape} where x has "
                    f"{self.x.shape}; give one value per point"
                )


# One of the panels that share the x axis of a chart.


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One of the panels that share the x axis of a chart.

    Attributes:
        y_label: With the unit.
        curves: In the order of drawing, the last on top.
        limits: Of the y axis; None for what the curves need, without lonely spikes.
        height: In proportion to the other panels.
        has_zero_line: Whether a thin line marks zero.
    """

    y_label: str
    curves: tuple[Curve, ...]
    limits: tuple[float, float] | None = None
    height: float = 1.0
    has_zero_line: bool = True


# What is marked in every panel of a chart.


@dataclass(frozen=True, slots=True, kw_only=True)
class Shading:
    """Stretches of the x axis with a meaning.

    Attributes:
        label: In the legend.
        color: Of the shade.
        spans: First and last place of each stretch.
        least_pt: Width to which a short stretch is drawn at least, so that it is seen.
    """

    label: str
    color: str
    spans: tuple[tuple[float, float], ...]
    least_pt: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Instants:
    """Vertical lines.

    Attributes:
        label: In the legend.
        style: Of the lines.
        places: On the x axis.
    """

    label: str
    style: LineStyle
    places: tuple[float, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Ticks:
    """Short strokes along the lower edge.

    Attributes:
        label: In the legend.
        color: Of the strokes.
        places: On the x axis.
    """

    label: str
    color: str
    places: tuple[float, ...]


WIDTH_IN = 4.4
"""At the width of a phone the letters are then still large enough to read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Chart:
    """Panels below each other over one x axis, with one legend below them.

    Attributes:
        title: One line above.
        x_label: With the unit.
        panels: From above.
        shadings: Stretches marked in every panel.
        instants: Lines marked in every panel.
        ticks: Strokes marked in every panel.
        x_limits: None for what the curves need.
        x_ticks: Places and what stands there; empty for numbers.
        width_in: In inches.
        height_in: In inches, without the legend.
    """

    title: str
    x_label: str
    panels: tuple[Panel, ...]
    shadings: tuple[Shading, ...] = ()
    instants: tuple[Instants, ...] = ()
    ticks: tuple[Ticks, ...] = ()
    x_limits: tuple[float, float] | None = None
    x_ticks: tuple[tuple[float, str], ...] = ()
    width_in: float = WIDTH_IN
    height_in: float = 3.0

    def __post_init__(self) -> None:
        """Check that there is something to draw.

        Raises:
            ChartError: No panel.
        """
        if not self.panels:
            raise ChartError(f"chart {self.title!r} has no panel; give at least one")


# How much room a panel needs.


MOST_OF = 99.8
"""Per cent of each curve that is shown; lonely spikes may leave the panel."""
MARGIN = 0.06


def limits_of(curves: Sequence[Curve], x_limits: tuple[float, float] | None) -> tuple[float, float]:
    """Lower and upper limit: zero, and nearly all of every curve with its band."""
    edges = [0.0]
    for curve in curves:
        inside = np.isfinite(curve.y) & np.isfinite(curve.x)
        if x_limits is not None:
            inside &= (curve.x >= x_limits[0]) & (curve.x <= x_limits[1])
        if not inside.any():
            continue
        y = curve.y[inside]
        band = np.zeros_like(y) if curve.std is None else 2.0 * curve.std[inside]
        band[~np.isfinite(band)] = 0.0
        edges.append(float(np.percentile(y - band, 100.0 - MOST_OF)))
        edges.append(float(np.percentile(y + band, MOST_OF)))
    low, high = min(edges), max(edges)
    margin = MARGIN * (high - low) or 1.0
    return low - margin, high + margin


# Fewer points of a curve that look the same: the least and the largest of every block.


BLOCKS = 500
"""More than a chart has columns of dots on a phone; print gets two points of each."""


def kept_points(y: Array, blocks: int = BLOCKS) -> NDArray[np.intp]:
    """Indices of the points to draw, increasing.

    A block keeps its least and its largest value, so that no spike is lost, and its first value
    that is not finite, so that no gap is bridged. The first and the last point stay.

    Args:
        y: Values, shape (n,).
        blocks: Into which the curve is cut.
    """
    size = -(-len(y) // blocks)
    if size <= 2:
        return np.arange(len(y))
    keep = {0, len(y) - 1}
    for start in range(0, len(y), size):
        block = y[start : start + size]
        is_finite = np.isfinite(block)
        if is_finite.any():
            keep.add(start + int(np.argmin(np.where(is_finite, block, np.inf))))
            keep.add(start + int(np.argmax(np.where(is_finite, block, -np.inf))))
        if not is_finite.all():
            keep.add(start + int(np.argmin(is_finite)))
    return np.array(sorted(keep), dtype=np.intp)


# From a chart to a matplotlib figure.


SETTINGS: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same everywhere
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 9.0,
    "lines.solid_capstyle": "round",
    "axes.formatter.useoffset": False,
    "svg.fonttype": "path",
    "svg.hashsalt": "needleforce",  # equal charts give equal bytes
}
"""Of matplotlib; must hold while a chart is drawn and while it is saved."""
BAND_OPACITY = 0.2
TWO_COLUMNS = 54
"""Letters that two columns of a legend have room for at the usual width; longer words get one."""
LEGEND_ROW_IN = 0.17
TITLE_LETTERS = 50
"""Of a line at the usual width."""


def draw(chart: Chart) -> "Figure":
    """Draw a chart; no window and no global state of matplotlib is involved."""
    from matplotlib.figure import Figure

    figure = Figure(layout="constrained", facecolor="white")
    heights = [panel.height for panel in chart.panels]
    places = figure.subplots(
        len(heights), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights}
    )[:, 0]
    for place, panel in zip(places, chart.panels, strict=True):
        _mark(place, chart)
        _draw_panel(place, panel, chart.x_limits)
    figure.align_ylabels(list(places))
    places[-1].set_xlabel(chart.x_label)
    if chart.x_limits is not None:
        places[-1].set_xlim(*chart.x_limits)
    if chart.x_ticks:
        places[-1].set_xticks(*zip(*chart.x_ticks, strict=True))
    figure.suptitle(_title(chart), x=0.01, ha="left", fontsize=9.5, fontweight="bold")
    rows = _legend(figure, list(places), chart)
    figure.set_size_inches(chart.width_in, chart.height_in + rows * LEGEND_ROW_IN)
    return figure


def _draw_panel(axes: "Axes", panel: Panel, x_limits: tuple[float, float] | None) -> None:
    if panel.has_zero_line:
        axes.axhline(0.0, color="#555555", linewidth=0.6)
    for curve in panel.curves:
        _draw_curve(axes, curve)
    axes.set_ylabel(panel.y_label)
    axes.set_ylim(*(panel.limits or limits_of(panel.curves, x_limits)))


def _draw_curve(axes: "Axes", curve: Curve) -> None:
    rows = kept_points(curve.y)
    x, y, style = curve.x[rows], curve.y[rows], curve.style
    if curve.std is not None:
        low, high = y - 2.0 * curve.std[rows], y + 2.0 * curve.std[rows]
        axes.fill_between(
            x,
            low,
            high,
            color=style.color,
            alpha=BAND_OPACITY,
            linewidth=0,
            label=curve.band_label,
            rasterized=False,
        )
    axes.plot(x, y, label=curve.label, **_line(style), **_marker(style))


def _line(style: LineStyle) -> dict[str, Any]:
    return {
        "color": style.color,
        "linestyle": "none" if style.marker else style.dash,
        "linewidth": style.width_pt,
        "alpha": style.opacity,
    }


def _marker(style: LineStyle) -> dict[str, Any]:
    if not style.marker:
        return {}
    return {"marker": style.marker, "markersize": style.size_pt, "markeredgewidth": style.width_pt}


def _mark(axes: "Axes", chart: Chart) -> None:
    for shading in chart.shadings:
        for first, last in shading.spans:
            wide, color = shading.least_pt, shading.color
            axes.axvspan(first, last, color=color, linewidth=wide, label=shading.label)
    for instants in chart.instants:
        for place in instants.places:
            axes.axvline(place, label=instants.label, **_line(instants.style))
    for ticks in chart.ticks:
        if ticks.places:
            axes.plot(
                ticks.places,
                np.full(len(ticks.places), 0.02),
                "|",
                color=ticks.color,
                markersize=8,
                transform=axes.get_xaxis_transform(),
                label=ticks.label,
            )


def _legend(figure: "Figure", places: list["Axes"], chart: Chart) -> int:
    """One legend for all panels, below them, where it hides nothing; returns its rows."""
    shown: dict[str, Any] = {}
    for axes in places:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            shown.setdefault(label, handle)
    if not shown:
        return 0
    marks = [mark.label for mark in (*chart.shadings, *chart.instants, *chart.ticks)]
    ordered = sorted(shown, key=lambda label: label in marks)
    columns = _legend_columns(ordered, chart)
    figure.legend(
        [shown[label] for label in ordered],
        ordered,
        loc="outside lower left",
        ncols=columns,
        handlelength=2.2,
        columnspacing=1.2,
        labelspacing=0.3,
    )
    return -(-len(ordered) // columns)


def _legend_columns(labels: list[str], chart: Chart) -> int:
    half = -(-len(labels) // 2)
    longest = [max(map(len, part), default=0) for part in (labels[:half], labels[half:])]
    return 2 if sum(longest) <= TWO_COLUMNS * chart.width_in / WIDTH_IN else 1


def _title(chart: Chart) -> str:
    most = int(TITLE_LETTERS * chart.width_in / WIDTH_IN)
    return "\n".join(part for line in chart.title.splitlines() for part in wrap(line, most))


# Charts as files.


MOST_SVG_BYTES = 1_000_000
"""A larger drawing is quicker to show as dots."""
DPI = 160
_COORDINATE = re.compile(r"(-?\d+\.\d)\d+")
_SPACE = re.compile(r"\s*\n|(?<=[A-Za-z]) ")
_PATH = re.compile(r' d="([^"]*)"')


def require_matplotlib(what: str) -> None:
    """Find out before the work what could not be drawn after it.

    Args:
        what: Who needs it, for the message, such as ``--png``.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            f"{what} needs matplotlib, which is not installed; "
            "install it with: pip install 'needleforce[plots]'"
        ) from error


def save_png(chart: Chart, path: str | Path) -> Path:
    """Draw a chart and write it as PNG.

    Raises:
        MissingExtraError: matplotlib is not installed.
        WriteError: The file cannot be written.
    """
    return _write(Path(path), _rendered(chart, "png"))


def save_svg(chart: Chart, path: str | Path) -> Path:
    """Draw a chart and write it as SVG, or as PNG if the SVG would be very large.

    Args:
        chart: What to draw.
        path: Without its ending, which is added.

    Returns:
        The file.

    Raises:
        MissingExtraError: matplotlib is not installed.
        WriteError: The file cannot be written.
    """
    stem = Path(path)
    drawing = _rounded(_rendered(chart, "svg"))
    if len(drawing) > MOST_SVG_BYTES:
        return save_png(chart, stem.with_name(f"{stem.name}.png"))
    return _write(stem.with_name(f"{stem.name}.svg"), drawing)


def _rendered(chart: Chart, kind: str) -> bytes:
    require_matplotlib("a figure")
    from matplotlib import rc_context

    more: dict[str, Any] = {"metadata": {"Date": None}} if kind == "svg" else {"dpi": DPI}
    file = BytesIO()
    with rc_context(SETTINGS):
        draw(chart).savefig(file, format=kind, **more)
    return file.getvalue()


def _rounded(drawing: bytes) -> bytes:
    """A tenth of a point is finer than any line; the other digits are half of the file."""

    def round_path(match: re.Match[str]) -> str:
        shorter = _SPACE.sub("", _COORDINATE.sub(r"\1", match.group(1)))
        return f' d="{shorter}"'

    return _PATH.sub(round_path, drawing.decode()).encode()


def _write(path: Path, content: bytes) -> Path:
    try:
        path.write_bytes(content)
    except OSError as error:
        raise WriteError(f"cannot write {path}: {error.strerror or error}") from error
    return path
