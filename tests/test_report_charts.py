"""The charts of a run: the right curves, events, times and numbers."""

from dataclasses import replace

import numpy as np
import pytest
from benchmark_cases import gel_slice

from benchmarks.benchmark import Job
from benchmarks.force_plots import RunFigures, force_chart, force_figures, rmse_N
from benchmarks.identification_figures import draw_identification
from benchmarks.identification_metrics import SIGMA1_N, identify_as_run
from benchmarks.identification_plots import (
    Compared,
    enhanced_chart,
    offline_chart,
    parameter_chart,
    true_friction,
)
from benchmarks.methods import ForceReading, identify
from benchmarks.signals import ForceTruth, NeedleSignal, insertion_truth
from groundtruth import insert_needle
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
GEL = Job(benchmark="gel-70-constant", plant="clean")


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
    over_time = force_chart("a", TRUTH, READINGS)
    over_depth = force_chart("a", TRUTH, READINGS, "depth")
    assert over_time.x_label == palette.INSERTION_TIME
    assert over_depth.x_label == palette.DEPTH
    first = over_time.panels[0].curves[0]
    assert first.x[0] == pytest.approx(0.0, abs=0.01), "zeroed before, nothing is shown"
    assert over_depth.panels[0].curves[0].x.max() == pytest.approx(10.0, abs=0.01)
    assert [curve.label for curve in over_time.panels[0].curves] == [
        "F/T sensor, RMSE 0.010 N",
        "virtual sensor, ours, RMSE 0.050 N",
        "virtual sensor, published, RMSE 0.200 N",
        "true force",
    ]
    errors = over_time.panels[1].curves
    assert [curve.std is not None for curve in errors] == [True, False, False]
    assert errors[0].y == pytest.approx(0.05), "the noisy curve lies below the others"


def test_no_wild_curve_flattens_the_others_and_an_rmse_counts_the_judged_part_only():
    wild = force_chart("a", TRUTH, (*READINGS[:2], reading("virtual", "published", 50.0)))
    low, high = wild.panels[1].limits
    assert -low == high < 0.5
    late = replace(READINGS[1], axial_N=np.where(T < 4.0, 9.0, 1.0))
    assert rmse_N(late, TRUTH, TRUTH.axial_N) == pytest.approx(0.0, abs=0.05)


def test_figure_5_has_two_panels_and_the_papers_numbers(tmp_path):
    over_time, over_depth = force_figures(GEL, tmp_path, TRUTH, READINGS)
    assert [(item.figure, item.panel) for item in (over_time, over_depth)] == [
        ("5", "a"),
        ("5", "c"),
    ]
    against_ft, against_truth, delay, within = over_time.facts
    assert against_ft.published == "0.2444"
    assert dict(against_ft.here) == {"published, here": "0.1900", "ours, here": "0.0400"}
    assert dict(against_truth.here)["ours, here"] == "0.0500"
    assert dict(within.here)["ours, here"] == "100.0"
    assert "delay" in delay.what
    assert over_depth.shown.path.is_file()


def test_what_figure_5_says_of_delay_and_band_is_of_this_run(tmp_path):
    """A sensor that is late and too sure of itself must not be praised."""
    wave = np.sin(T)
    truth = replace(TRUTH, axial_N=wave)
    late, sure = np.interp(T - 0.1, T, wave), np.full(len(T), 1e-4)
    ours = ForceReading(source="virtual", method="default", axial_N=late, std_N=sure)
    published, ft = reading("virtual", "published", 0.2), reading("ft", "default", 0.01)
    readings = (ours, ft, replace(published, axial_N=wave))
    *_, delay, within = force_figures(GEL, tmp_path, truth, readings)[0].facts
    assert dict(delay.here) == {"published, here": "0", "ours, here": "100"}
    assert float(dict(within.here)["ours, here"]) < 1.0


def test_other_runs_have_their_force_over_time_only_on_the_whole_width(tmp_path):
    job = Job(benchmark="random-stack", plant="degraded", seed=3)
    (drawing,) = force_figures(job, tmp_path, TRUTH, READINGS)
    assert (drawing.figure, drawing.facts) == ("", ())
    assert drawing.shown.path.name == "random-stack-degraded-3-force-time.svg"
    assert drawing.shown.wide is not None
    assert drawing.shown.wide.is_file()
    assert drawing.job.where == "degraded plant, seed 3"


def test_a_title_says_what_is_shown_and_of_which_run(tmp_path):
    for plant, number, expected in (
        ("degraded", "8b", "Figure 8b: axial forces\na, degraded plant, seed 2"),
        ("recording", "", "Axial forces\na, recording 2"),
        ("needle", "", "Axial forces\na, needle without an arm, seed 2"),
    ):
        figures = RunFigures(Job(benchmark="a", plant=plant, seed=2), tmp_path)
        assert figures._title(number, "axial forces") == expected


SHORT = gel_slice()


class Insertion:
    """A short insertion, and what both methods made of it."""

    def __init__(self):
        run = insert_needle(SHORT, seed=0)
        self.truth = insertion_truth(run)
        self.signal = NeedleSignal(
            source="ft",
            t_s=run.t_s,
            depth_m=run.depth_m,
            speed_m_s=run.speed_m_s,
            force_N=run.force_N,
        )
        self.commanded_m_s = SHORT.motion.speed_m_s(self.truth.t_s)
        methods = ("default", "published")
        self.identified = [identify(self.signal, self.truth, method) for method in methods]
        self.identified.append(identify_as_run(self.signal, self.truth, self.commanded_m_s))
        by_method = {item.method: item for item in self.identified}
        self.ours, self.published = by_method["default"], by_method["published"]


@pytest.fixture(scope="module")
def run():
    return Insertion()


def curves(chart):
    """Curves by label, of the first panel that has them."""
    found = {}
    for panel in chart.panels:
        for curve in panel.curves:
            found.setdefault(curve.label, curve)
    return found


def test_true_ruptures_alarms_and_identified_friction_are_marked(run):
    chart = enhanced_chart("a", run.truth, run.ours)
    (shading,) = chart.shadings
    (rupture,) = run.truth.ruptures
    zero = run.truth.tare_end_s
    assert shading.spans == ((rupture.onset_s - zero, rupture.end_s - zero),)
    detected, identified = chart.instants
    alarms = tuple(alarm.alarm_s - zero for alarm in run.ours.alarms)
    assert (detected.label, detected.places) == ("rupture detected", alarms)
    assert identified.label == "friction identified"
    assert len(identified.places) >= 1
    assert all(place > alarms[0] for place in identified.places)
    low, high = chart.x_limits
    assert low < run.truth.contact_s - zero < run.truth.insertion_end_s - zero < high
    assert {detected.style, identified.style} == {palette.RUPTURE, palette.COMPENSATION}


def test_the_forces_of_a_method_are_drawn_in_its_style(run):
    ours = curves(enhanced_chart("a", run.truth, run.ours))
    assert ours["enhanced force, ours"].style is palette.OURS
    assert np.array_equal(ours["enhanced force, ours"].y, run.ours.enhanced_N)
    assert np.array_equal(ours["force of the F/T sensor"].y, run.ours.force_N)
    assert np.array_equal(ours["true enhanced force"].y, run.truth.enhanced_N)
    published = enhanced_chart("a", run.truth, run.published, run.published, has_speed=True)
    labels = {"enhanced force, published", "enhanced force, Kelvin-Voigt", "speed, not to scale"}
    assert labels <= set(curves(published))


def test_another_sensor_lies_broad_below_the_force_it_is_compared_with(run):
    n = len(run.truth.t_s)
    ft = ForceReading(source="ft", method="default", axial_N=np.ones(n), std_N=np.ones(n))
    virtual = replace(run.ours, signal=replace(run.signal, source="virtual"))
    first, second, *_ = enhanced_chart("a", run.truth, virtual, ft=ft).panels[0].curves
    assert first.label == "force of the F/T sensor"
    assert second.label == "force of the virtual sensor"
    assert np.array_equal(first.y, ft.axial_N)
    assert first.style.width_pt > second.style.width_pt + 1.0


def test_parameters_have_units_bands_and_the_truth_where_there_is_one(run):
    compared = Compared(
        ours=run.ours,
        tuned=run.published,
        published=run.published,
        kelvin_voigt=replace(run.published),
        on_ft=run.ours,
    )
    chart = parameter_chart("a", run.truth, compared)
    assert [panel.y_label.count("[") for panel in chart.panels] == [1, 1, 1]
    _, friction, total = chart.panels
    labels = [{curve.label for curve in panel.curves} for panel in chart.panels]
    assert "ground truth" not in labels[0]
    assert "ground truth" in labels[1] & labels[2]
    assert "published, Kelvin-Voigt" in labels[0] & labels[2]
    assert "published, Kelvin-Voigt" not in labels[1], "its unit is another"
    assert "published" in labels[1]
    ours = next(curve for curve in friction.curves if curve.label == "ours")
    assert ours.std is not None
    assert total.limits[1] > true_friction(run.truth)["cumulative_friction_Ns_per_m"][1][-1]
    layers = [alarm.layer for alarm in run.ours.alarms if alarm.layer is not None]
    for panel, name in zip(chart.panels, ("stiffness_N_per_m", "friction_Ns_per_m2"), strict=False):
        assert panel.limits[1] > max(getattr(layer, name) for layer in layers)


def test_true_friction_is_force_over_speed_at_the_rupture(run):
    (rupture,) = run.truth.ruptures
    steps = true_friction(run.truth)
    times, total = steps["cumulative_friction_Ns_per_m"]
    assert total[0] == 0.0
    assert total[-1] == pytest.approx(rupture.layer_friction_N / 5e-3, rel=1e-3)
    assert times[-1] == run.truth.insertion_end_s
    _, local = steps["friction_Ns_per_m2"]
    assert local[0] == pytest.approx(total[-1] / rupture.onset_m)


def test_the_published_method_with_its_authors_settings_comes_near_the_truth(run):
    noise = np.random.default_rng(0).normal(scale=0.2e-3, size=len(run.truth.t_s))
    noisy = replace(run.signal, speed_m_s=run.signal.speed_m_s + noise)
    tuned = identify_as_run(noisy, run.truth, run.commanded_m_s)
    (rupture,) = run.truth.ruptures

    def error_N(item):
        inside = [alarm for alarm in item.alarms if alarm.alarm_s < run.truth.insertion_end_s]
        return abs(sum(alarm.layer.friction_N for alarm in inside) - rupture.layer_friction_N)

    assert error_N(tuned) < 0.15 * rupture.layer_friction_N
    assert error_N(tuned) < 0.5 * error_N(identify(noisy, run.truth, "published"))
    assert tuned.config.sigma1_N in SIGMA1_N
    assert (min(SIGMA1_N), max(SIGMA1_N)) == (0.03, 0.15), "what its authors used"


def test_the_offline_fit_predicts_the_withdrawal(run):
    chart = offline_chart("a", run.signal, run.truth)
    unfitted, _ = chart.shadings
    assert unfitted.spans[0][0] == run.truth.insertion_end_s - run.truth.tare_end_s
    labels = list(curves(chart))
    assert labels[0] == "force of the F/T sensor"
    assert [label.split(" model")[0] for label in labels[1:3]] == ["multi-layer", "Kelvin-Voigt"]
    ml = curves(chart)[labels[1]]
    assert ml.y.min() < -0.1, "in the withdrawal the needle is held back"
    assert chart.x_limits[1] == pytest.approx(ml.x[-1])


def test_a_run_of_a_figure_draws_panels_of_their_own_letters_and_numbers(run, tmp_path):
    job = Job(benchmark="gel-70-constant", plant="needle")
    found = [run.identified]
    drawings = draw_identification(job, tmp_path, run.truth, run.commanded_m_s, found)
    panels = [(item.figure, item.panel) for item in drawings]
    assert panels == [("2", "a"), ("8", "a"), ("8", "b"), ("8", "c")]
    facts = [fact for item in drawings if item.figure == "8" for fact in item.facts]
    assert [fact.published for fact in facts] == [
        "1, at about 15 s",
        "481 online, 534 offline (Table I)",
        "almost zero (ML)",
    ]
    ours = [dict(fact.here)["ours, one setting, here"] for fact in facts]
    (rupture,) = run.truth.ruptures
    assert ours[0] == f"1, at {run.ours.alarms[0].alarm_s - run.truth.tare_end_s:.1f} s"
    assert float(ours[1]) == pytest.approx(rupture.layer_friction_N / 5e-3, rel=0.05)
    assert 0.0 <= float(ours[2]) < 10.0
    tuned = dict(facts[1].here)["published, tuned, here"]
    assert float(tuned) == pytest.approx(float(ours[1]), rel=0.15)
    assert all(
        item.shown.alt and item.shown.caption and item.shown.path.is_file() for item in drawings
    )
    assert [item.shown.wide is not None for item in drawings] == [False, False, False, True]
