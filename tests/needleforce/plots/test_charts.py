"""Charts: what is drawn is what was given, also when there is too much of it."""

import re
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest

from needleforce.plots import (
    Chart,
    Curve,
    FiguresError,
    Instants,
    LineStyle,
    Panel,
    Shading,
    palette,
    require_matplotlib,
    save_figure,
)
from needleforce.plots.chart import limits_of
from needleforce.plots.drawing import STYLE, draw
from needleforce.plots.errors import ChartError, WriteError

pytest.importorskip("matplotlib")


def curve(y, label="a force", **more):
    y = np.asarray(y, dtype=float)
    return Curve(
        style=palette.OURS, x=np.arange(len(y)) * 1e-3, y=y, label=label, **more
    )


def chart(*curves, title="Force\na run", limits=None, **more):
    panel = Panel(y_label=palette.FORCE, curves=curves, limits=limits)
    return Chart(title=title, x_label=palette.TIME, panels=(panel,), **more)


def words(path):
    """Text of a figure: matplotlib notes it beside the shapes of the letters."""
    return re.findall(r"<!-- (.*?) -->", path.read_text(encoding="utf-8"))


def places(path, color):
    """Points of the lines of a colour in an SVG, shape (n, 2) in points from the
    upper left."""
    text = path.read_text(encoding="utf-8")
    drawn = re.findall(rf'<path d="([^"]*)" clip-path[^>]*stroke: {color}', text)
    points = re.findall(r"[ML] ?(-?[\d.]+) (-?[\d.]+)", " ".join(drawn))
    return np.array(points, dtype=float)


def drawn_axes(chart):
    from matplotlib import rc_context

    with rc_context(fname=STYLE):
        return draw(chart).axes


def test_labels_units_and_legend_are_in_the_figure(tmp_path):
    style = LineStyle(color=palette.BLUE, marker="^")
    full = chart(
        Curve(style=style, x=np.zeros(1), y=np.zeros(1), label="gel"),
        curve([0.0, 1.0], std=np.array([0.1, 0.1]), band_label="± 2 std"),
        shadings=(Shading("tare", palette.TARE, ((0.0, 1e-4), (2e-4, 5e-4))),),
        instants=(
            Instants(label="rupture", style=palette.RUPTURE, places=(0.5e-3,)),
            Instants(label="rejected", style=palette.REJECTED, places=(0.2e-3,)),
        ),
        x_ticks=((0.0, "25 %"), (1e-3, "50 %")),
    )
    path = save_figure(full, tmp_path / "a.svg")
    texts = words(path)
    expected = [
        "Force",
        "a run",
        "axial force [N]",
        "time [s]",
        "a force",
        "± 2 std",
        "tare",
    ]
    for text in (*expected, "rupture", "rejected", "gel", "25 %"):
        assert texts.count(text) == 1, "once, also where it stands for several marks"

    assert ElementTree.parse(path).getroot().tag.endswith("svg")


@pytest.mark.parametrize("name", ["force", "a force of a name as long as that"])
def test_a_legend_ends_within_the_figure(name):
    axes = drawn_axes(
        chart(*(curve([0.0, 1.0], label=f"{name} {k}") for k in range(9)))
    )
    figure = axes[0].figure

    assert figure.legends[0].get_window_extent().width <= figure.bbox.width
    assert len(figure.legends) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("suffix", "start"), [("svg", b"<?xml"), ("png", b"\x89PNG"), ("PDF", b"%PDF")]
)
def test_format_follows_name_and_equal_charts_equal_bytes(tmp_path, suffix, start):
    paths = [
        save_figure(chart(curve([0.0, 2.0])), tmp_path / f"{name}.{suffix}")
        for name in "ab"
    ]

    assert paths[0].read_bytes().startswith(start)
    assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [r"$\frac{$.csv", "a\udcff\x01 -- <b>&.csv", "针.csv", "^_{}.csv"]
)
@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_any_file_name_can_stand_in_a_title(tmp_path, name, suffix, recwarn):
    path = save_figure(
        chart(curve([0.0, 1.0]), title=f"Forces\n{name}"), tmp_path / f"a.{suffix}"
    )

    assert path.stat().st_size > 1000
    assert not recwarn.list

    if suffix == "svg":
        ElementTree.parse(path)
        readable = name.replace("\udcff\x01", r"\udcff\x01")
        assert readable in words(path) or "--" in name


@pytest.mark.slow
def test_long_curve_keeps_peaks_in_small_file(tmp_path):
    noise = np.random.default_rng(0).normal(size=1_000_000)
    path = save_figure(chart(curve(noise)), tmp_path / "a.svg")

    assert path.stat().st_size < 100_000

    wave = np.sin(np.linspace(0.0, 20.0, 300_000))
    save_figure(chart(curve(wave, std=np.ones(len(wave)))), path)

    assert path.stat().st_size < 100_000, "of a band as well"

    noise[123_456] = 20.0
    spiked = places(
        save_figure(chart(curve(noise), limits=(-25, 25)), path), palette.BLUE
    )
    upper = spiked[:, 1].min()
    lower = spiked[:, 1].max()
    middle = np.median(spiked[:, 1])

    assert middle - upper > 3.0 * (lower - middle)

    holed = np.zeros(100_000)
    holed[4_321:6_000] = np.nan
    std = np.ones(len(holed))
    text = save_figure(chart(curve(holed, std=std)), path).read_text(encoding="utf-8")
    lines = re.findall(rf'<path d="([^"]*)" clip-path[^>]*stroke: {palette.BLUE}', text)

    assert [line.count("M") for line in lines] == [2, 2, 2], (
        "two pieces: curve and edges of band"
    )


def test_cut_curves_are_marked_also_in_a_window():
    y = np.ones(10_000)
    y[77] = 1e6
    low, high = limits_of([curve(y)], None)

    assert low < 0.0 < 1.0 < high < 2.0
    assert limits_of([curve([np.nan])], None) == (-1.0, 1.0)

    (axes,) = drawn_axes(chart(curve(y)))
    marks = [line for line in axes.lines if line.get_marker() == "^"]

    assert [line.get_xdata()[0] for line in marks] == [pytest.approx(0.077, abs=0.1)]
    assert marks[0].get_ydata()[0] == axes.get_ylim()[1]
    assert [text.get_text() for text in axes.texts] == ["1000000"]
    assert not drawn_axes(chart(curve(np.ones(9))))[0].texts, (
        "nothing is cut, nothing is marked"
    )

    # A window has axes for the part that it shows.
    y = np.concatenate([np.full(100, 50.0), np.ones(100)])

    assert limits_of([curve(y)], (0.11, 0.2))[1] < 2.0

    window = chart(curve(y), limits=(0.0, 60.0)).within(0.11, 0.2)
    (axes,) = drawn_axes(window)

    assert axes.get_xlim() == (0.11, 0.2)
    assert axes.get_ylim()[1] < 2.0
    assert not axes.texts, "what is cut outside of the window is not marked"
    with pytest.raises(
        ChartError, match="from 2 to 1; the end must lie after the start"
    ):
        window.within(2.0, 1.0)


def test_what_cannot_be_drawn_or_written_is_refused(tmp_path):
    for refuse in (save_figure, require_matplotlib):
        with pytest.raises(ChartError, match=r"a\.gif: its name must end in one of"):
            refuse(chart(curve([0.0])), tmp_path / "a.gif")

    with pytest.raises(ChartError, match=r"'a': y has shape \(2,\) where x has \(3,\)"):
        Curve(style=palette.OURS, x=np.zeros(3), y=np.zeros(2), label="a")
    with pytest.raises(ChartError, match="no panel"):
        Chart(title="a", x_label="b", panels=())
    with pytest.raises(WriteError, match="cannot write"):
        save_figure(chart(curve([0.0])), tmp_path / "none" / "a.png")
    assert issubclass(WriteError, FiguresError)


def test_a_lone_peak_is_cut():
    peaked = curve([0.0] * 5000 + [7.0] + [0.0] * 5000)

    assert limits_of((peaked,), None)[1] < 7.0
