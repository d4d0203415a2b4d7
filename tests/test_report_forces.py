"""The charts of a force: Figure 5 and its numbers."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.plots import Sketchbook, draw_forces, force_over_depth, force_over_time, rmse_N

from benchmarks.benchmark import Job
from benchmarks.methods import ForceReading
from benchmarks.signals import ForceTruth
from needleforce.plots import palette

pytest.importorskip("matplotlib")

T = np.linspace(0.0, 20.0, 4001)
TRUTH = ForceTruth(
    t_s=T,
    depth_m=np.where(T < 10.0, T, 20.0 - T) * 1e-3,
    axial_N=np.where(T > 4.0, 1.0, 0.0),
    zeroed_s=3.0,
    start_s=4.0,
    end_s=19.0,
)


def reading(source, method, error):
    return ForceReading(
        source=source, method=method, axial_N=TRUTH.axial_N + error, std_N=np.full(len(T), 0.1)
    )


READINGS = (
    reading("virtual", "default", 0.05),
    reading("ft", "default", 0.01),
    reading("virtual", "published", 0.2),
)


def test_forces_are_drawn_over_time_and_depth_with_their_errors():
    over_time, over_depth = (
        draw("a", TRUTH, READINGS) for draw in (force_over_time, force_over_depth)
    )
    assert over_time.x_label == palette.INSERTION_TIME
    assert over_depth.x_label == palette.DEPTH
    first = over_time.panels[0].curves[0]
    assert first.x[0] == pytest.approx(0.0, abs=0.01), "zeroed before, nothing is shown"
    assert over_depth.panels[0].curves[0].x.max() == pytest.approx(10.0, abs=0.01)
    labels = [curve.label for curve in over_time.panels[0].curves]
    assert labels == [
        "F/T sensor, RMSE 0.010 N",
        "virtual, published, RMSE 0.200 N",
        "virtual, ours, RMSE 0.050 N",
        "true force",
    ]
    errors = over_time.panels[1].curves
    assert [curve.std is not None for curve in errors] == [False, False, True]
    assert errors[2].y == pytest.approx(0.05)


def test_no_wild_curve_flattens_the_others():
    wild = force_over_time("a", TRUTH, (*READINGS[:2], reading("virtual", "published", 50.0)))
    low, high = wild.panels[1].limits
    assert -low == high < 0.5


def test_an_rmse_counts_the_judged_part_only():
    late = ForceReading(
        source="ft", method="default", axial_N=np.where(T < 4.0, 9.0, 1.0), std_N=np.ones(len(T))
    )
    assert rmse_N(late, TRUTH, TRUTH.axial_N) == pytest.approx(0.0, abs=0.05)


def test_figure_5_has_two_panels_and_the_papers_numbers(tmp_path):
    book = Sketchbook(Job(benchmark="gel-70-constant", plant="clean"), tmp_path)
    draw_forces(book, TRUTH, READINGS)
    over_time, over_depth = book.drawings
    assert [item.panel for item in book.drawings] == ["a", "c"]
    assert {item.figure for item in book.drawings} == {"5"}
    against_ft, against_truth, delay, within = over_time.facts
    assert against_ft.paper == "0.2444"
    assert dict(against_ft.here) == {"published, here": "0.1900", "ours, here": "0.0400"}
    assert dict(against_truth.here)["ours, here"] == "0.0500"
    assert dict(within.here)["ours, here"] == "100.0"
    assert "delay" in delay.what
    assert over_depth.path.is_file()


def test_what_figure_5_says_of_delay_and_band_is_of_this_run(tmp_path):
    """A sensor that is late and too sure of itself must not be praised."""
    wave = np.sin(T)
    truth = replace(TRUTH, axial_N=wave)
    late, sure = np.interp(T - 0.1, T, wave), np.full(len(T), 1e-4)
    ours = ForceReading(source="virtual", method="default", axial_N=late, std_N=sure)
    paper, ft = reading("virtual", "published", 0.2), reading("ft", "default", 0.01)
    book = Sketchbook(Job(benchmark="gel-70-constant", plant="clean"), tmp_path)
    draw_forces(book, truth, (ours, ft, replace(paper, axial_N=wave)))
    *_, delay, within = book.drawings[0].facts
    assert dict(delay.here) == {"published, here": "0", "ours, here": "100"}
    assert float(dict(within.here)["ours, here"]) < 1.0


def test_other_runs_have_their_force_over_time_only(tmp_path):
    book = Sketchbook(Job(benchmark="random-stack", plant="degraded", seed=3), tmp_path)
    draw_forces(book, TRUTH, READINGS)
    (drawing,) = book.drawings
    assert drawing.figure == ""
    assert drawing.facts == ()
    assert drawing.path.name == "random-stack-degraded-3-force-time.svg"
    assert drawing.provenance == "`random-stack`, degraded arm, seed 3"
