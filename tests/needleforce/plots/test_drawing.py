"""Figures as files: equal ones have equal bytes, any name can be shown."""

from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib import rc_context

from needleforce.plots import (
    STYLE,
    ChartError,
    WriteError,
    add_legend,
    draw_line,
    make_panels,
    mark_instants,
    palette,
    require_matplotlib,
    save_figure,
)


def figure(y, title="Forces", std=None):
    """A figure of one line in two panels, with an event."""
    with rc_context(fname=STYLE):
        drawn, panels = make_panels(2, 4.4, 3.0, title)
        x = np.arange(len(y), dtype=float)
        for axes in panels:
            draw_line(axes, x, np.array(y), std, color=palette.BLUE, label="force [N]")
            mark_instants(axes, x[:1], "rupture", color="k", marker="|")
        add_legend(drawn)
    return drawn


def saved(drawn, path):
    with rc_context(fname=STYLE):
        return save_figure(drawn, path)


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_any_file_name_can_stand_in_a_title_of_equal_files(tmp_path, suffix):
    title = "Forces\nläg--2.csv\n$\\frac{$.csv\n力.csv\na\udcff\x01"
    drawn = [figure([0.0, 1.0], title) for _ in range(2)]
    first, second = (
        saved(one, tmp_path / f"{k}.{suffix}").read_bytes()
        for k, one in enumerate(drawn)
    )

    assert first == second
    assert len(first) > 1000
    if suffix == "svg":
        ElementTree.fromstring(first)


def test_a_band_is_two_deviations_to_either_side():
    drawn = figure([1.0, 3.0, 2.0], std=np.array([0.5, 0.5, 1.0]))
    (band,) = drawn.axes[0].collections
    ((low, high),) = [
        (path.vertices[:, 1].min(), path.vertices[:, 1].max())
        for path in band.get_paths()
    ]

    assert (low, high) == (0.0, 4.0)
    assert drawn.axes[0].get_shared_x_axes().joined(*drawn.axes)
    labels = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert labels == ["force [N]", "rupture"]  # one legend of both panels


@pytest.mark.slow
def test_a_long_line_keeps_peaks_in_a_small_file(tmp_path):
    noise = np.random.default_rng(0).normal(size=300_000)
    noise[123_456] = 20.0
    drawn = figure(noise, std=np.ones(len(noise)))
    path = saved(drawn, tmp_path / "a.svg")

    assert path.stat().st_size < 600_000
    assert drawn.axes[0].get_ylim()[1] > 20.0


def test_what_cannot_be_written_is_refused(tmp_path):
    for refuse in (save_figure, require_matplotlib):
        with pytest.raises(ChartError, match="gif"):
            refuse(figure([0.0]), tmp_path / "a.gif")
    with pytest.raises(WriteError, match="none"):
        save_figure(figure([0.0]), tmp_path / "none" / "a.png")
