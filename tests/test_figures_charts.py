"""Charts: what is drawn is what was given, also when there is too much of it."""

import builtins
import re
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from needleforce.plots.errors import ChartError, MissingExtraError, WriteError

from needleforce.plots import (
    Chart,
    Curve,
    FiguresError,
    Instants,
    Panel,
    Shading,
    Ticks,
    palette,
    require_matplotlib,
    save_png,
    save_svg,
)
from needleforce.plots import chart as save
from needleforce.plots.chart import kept_points, limits_of

pytest.importorskip("matplotlib")


def curve(y, label="a force", **more):
    y = np.asarray(y, dtype=float)
    return Curve(style=palette.OURS, x=np.arange(len(y)) * 1e-3, y=y, label=label, **more)


def chart(*curves, **more):
    panel = Panel(y_label=palette.FORCE, curves=curves)
    return Chart(title="8a  a title", x_label=palette.TIME, panels=(panel,), **more)


def words(path):
    """Text of a drawing: matplotlib notes it beside the shapes of the letters."""
    return re.findall(r"<!-- (.*?) -->", path.read_text(encoding="utf-8"))


@given(arrays(float, st.integers(1, 400), elements=st.floats(-1e6, 1e6)), st.integers(1, 50))
def test_thinning_keeps_the_ends_and_the_extremes(y, blocks):
    kept = kept_points(y, blocks)
    assert kept[0] == 0
    assert kept[-1] == len(y) - 1
    assert np.all(np.diff(kept) > 0)
    assert y[kept].min() == y.min()
    assert y[kept].max() == y.max()
    assert len(kept) <= max(2 * blocks + 2, min(len(y), 2 * blocks))


def test_thinning_bridges_no_gap():
    y = np.zeros(10_000)
    y[4_321] = np.nan
    assert 4_321 in kept_points(y, 50)


def test_labels_units_and_legend_are_in_the_drawing(tmp_path):
    drawn = chart(
        curve([0.0, 1.0], std=np.array([0.1, 0.1]), band_label="± 2 std"),
        shadings=(Shading(label="tare", color=palette.TARE, spans=((0.0, 0.5e-3),)),),
        instants=(Instants(label="rupture", style=palette.RUPTURE, places=(0.5e-3,)),),
        ticks=(Ticks(label="skipped", color=palette.REJECTED, places=(0.2e-3,)),),
    )
    path = save_svg(drawn, tmp_path / "a")
    assert path == tmp_path / "a.svg"
    told = words(path)
    for text in ("8a  a title", "axial force [N]", "time [s]", "a force", "± 2 std", "tare"):
        assert text in told
    assert "rupture" in told
    assert "skipped" in told
    assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_a_label_stands_in_the_legend_once(tmp_path):
    spans = ((0.0, 1e-4), (2e-4, 3e-4))
    drawn = chart(curve([0.0, 1.0]), shadings=(Shading(label="here", color="#ddd", spans=spans),))
    assert words(save_svg(drawn, tmp_path / "a")).count("here") == 1


def test_a_stretch_too_short_to_be_seen_can_be_drawn_wider(tmp_path):
    def drawn(least_pt):
        spans = ((0.5e-3, 0.5e-3 + 1e-9),)
        shading = Shading(label="here", color="#123456", spans=spans, least_pt=least_pt)
        path = save_svg(chart(curve([0.0, 1.0]), shadings=(shading,)), tmp_path / "a")
        return path.read_text(encoding="utf-8")

    assert "stroke-width: 2.5" in drawn(2.5)
    assert "stroke-width: 2.5" not in drawn(0.0)


def test_equal_charts_give_equal_bytes(tmp_path):
    paths = [save_svg(chart(curve([0.0, 2.0, 1.0])), tmp_path / name) for name in "ab"]
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_points_and_places_can_be_named(tmp_path):
    style = palette.LineStyle(color=palette.BLUE, marker="^")
    points = Curve(style=style, x=np.array([0.0, 1.0]), y=np.array([1.0, 2.0]), label="gel")
    path = save_svg(chart(points, x_ticks=((0.0, "25 %"), (1.0, "50 %"))), tmp_path / "a")
    assert {"25 %", "50 %", "gel"} <= set(words(path))


def test_a_very_large_drawing_becomes_dots(tmp_path, monkeypatch):
    monkeypatch.setattr(save, "MOST_SVG_BYTES", 100)
    path = save_svg(chart(curve([0.0, 1.0])), tmp_path / "a")
    assert path.suffix == ".png"
    assert path.read_bytes().startswith(b"\x89PNG")


def test_a_long_curve_makes_a_small_file(tmp_path):
    noise = np.random.default_rng(0).normal(size=1_000_000)
    assert save_svg(chart(curve(noise)), tmp_path / "a").stat().st_size < 100_000


def test_room_is_made_for_nearly_everything_but_lonely_spikes():
    y = np.ones(10_000)
    y[77] = 1e6
    low, high = limits_of([curve(y)], None)
    assert low < 0.0 < 1.0 < high < 2.0
    low, high = limits_of([curve(y, std=np.full(len(y), 2.0))], None)
    assert low < -3.0
    assert high > 5.0
    assert limits_of([curve([np.nan])], None) == (-1.0, 1.0)


def test_only_what_is_shown_needs_room():
    y = np.concatenate([np.full(100, 50.0), np.ones(100)])
    assert limits_of([curve(y)], (0.11, 0.2))[1] < 2.0


def test_a_curve_keeps_copies():
    y = np.zeros(3)
    kept = curve(y)
    y[0] = 5.0
    assert kept.y[0] == 0.0
    assert not kept.y.flags.writeable


def test_ragged_and_empty_charts_are_refused():
    with pytest.raises(ChartError, match=r"'a': y has shape \(2,\) where x has \(3,\)"):
        Curve(style=palette.OURS, x=np.zeros(3), y=np.zeros(2), label="a")
    with pytest.raises(ChartError, match="no panel"):
        Chart(title="a", x_label="b", panels=())


def test_what_cannot_be_written_is_said(tmp_path):
    with pytest.raises(WriteError, match="cannot write"):
        save_png(chart(curve([0.0])), tmp_path / "none" / "a.png")
    assert issubclass(WriteError, FiguresError)


def test_without_matplotlib_the_way_out_is_told(monkeypatch, tmp_path):
    real = builtins.__import__

    def missing(name, *more):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *more)

    monkeypatch.delitem(sys.modules, "matplotlib.figure", raising=False)
    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(MissingExtraError, match=r"--report needs matplotlib.*needleforce\[plots\]"):
        require_matplotlib("--report")
    with pytest.raises(MissingExtraError):
        save_svg(chart(curve([0.0])), tmp_path / "a")


def luminance(color):
    """Relative luminance of a colour, as the web's accessibility guidelines define it."""
    parts = [int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.03928 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


def test_lines_that_share_a_panel_differ_without_colour_and_stand_out_on_white():
    roles = [palette.OURS, palette.PUBLISHED, palette.PUBLISHED_KV, palette.TRUE_PART]
    assert len({role.dash for role in roles}) == len(roles)
    for role in (*roles, palette.TRUE, palette.READING):
        assert 1.05 / (luminance(role.color) + 0.05) >= 3.0
