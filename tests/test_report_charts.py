"""The charts of a run: the right curves, marks, times and numbers."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.plots import (
    InsertionAxis,
    Sketchbook,
    enhanced_chart,
    identification_drawings,
    offline_chart,
    parameter_chart,
    sigma1_N,
    true_friction,
    tuned_published,
)
from gel_slice import gel_slice

from benchmarks.benchmark import Job
from benchmarks.identification_metrics import identify_all
from benchmarks.methods import ForceReading, identify
from benchmarks.signals import NeedleSignal, truth_of_needle
from groundtruth import insert_needle
from needleforce.plots import palette

pytest.importorskip("matplotlib")

SHORT = gel_slice()


class Told:
    """A short insertion, and what both methods made of it."""

    def __init__(self):
        run = insert_needle(SHORT, seed=0)
        self.truth = truth_of_needle(run)
        self.signal = NeedleSignal(
            source="ft",
            t_s=run.t_s,
            depth_m=run.depth_m,
            speed_m_s=run.speed_m_s,
            force_N=run.force_N,
        )
        self.signals = {"default": self.signal, "published": self.signal}
        self.identified = identify_all(self.signals, self.truth)
        by_method = {item.method: item for item in self.identified}
        self.ours, self.published = by_method["default"], by_method["published"]
        self.commanded_m_s = SHORT.motion.speed_m_s(self.truth.t_s)


@pytest.fixture(scope="module")
def told():
    return Told()


def curves(chart):
    """Curves by label, of the first panel that has them."""
    found = {}
    for panel in chart.panels:
        for curve in panel.curves:
            found.setdefault(curve.label, curve)
    return found


def instants(chart):
    return {item.label: item for item in chart.instants}


def test_times_count_from_where_the_needle_sets_out(told):
    axis = InsertionAxis(told.truth)
    assert axis.at(told.truth.tare_end_s) == 0.0
    assert axis.place(np.array([told.truth.tare_end_s + 2.0])) == pytest.approx(2.0)
    low, high = axis.limits
    assert low < axis.at(told.truth.contact_s) < axis.at(told.truth.insertion_end_s) < high


def test_true_ruptures_alarms_and_compensations_are_marked(told):
    chart = enhanced_chart("a", told.truth, told.ours)
    (shading,) = chart.shadings
    (rupture,) = told.truth.ruptures
    zero = told.truth.tare_end_s
    assert shading.spans == ((rupture.onset_s - zero, rupture.end_s - zero),)
    marks = instants(chart)
    alarms = tuple(alarm.alarm_s - zero for alarm in told.ours.alarms)
    assert marks["rupture detected"].places == alarms
    assert marks["rupture detected"].style.dash == "-"
    compensated = marks["friction compensated"]
    assert len(compensated.places) >= 1
    assert all(place > alarms[0] for place in compensated.places)
    assert compensated.style.dash != "-"


def test_the_forces_of_a_method_are_drawn_in_its_style(told):
    ours = curves(enhanced_chart("a", told.truth, told.ours))
    assert ours["enhanced, ours"].style is palette.OURS
    assert np.array_equal(ours["enhanced, ours"].y, told.ours.enhanced_N)
    assert np.array_equal(ours["F/T reading"].y, told.ours.force_N)
    assert np.array_equal(ours["enhanced, truth"].y, told.truth.enhanced_N)
    published = enhanced_chart("a", told.truth, told.published, told.published, has_speed=True)
    assert {"enhanced, published", "enhanced, published, KV", "speed, no scale"} <= set(
        curves(published)
    )


def test_another_sensor_is_drawn_for_comparison(told):
    n = len(told.truth.t_s)
    ft = ForceReading(source="ft", method="default", axial_N=np.ones(n), std_N=np.ones(n))
    drawn = curves(enhanced_chart("a", told.truth, told.ours, ft=ft))
    assert np.array_equal(drawn["F/T reading, to compare"].y, ft.axial_N)


def test_parameters_have_units_bands_and_the_truth_where_there_is_one(told):
    chart = parameter_chart("a", told.truth, told.ours, told.published, told.published, told.ours)
    assert [panel.y_label.count("[") for panel in chart.panels] == [1, 1, 1]
    stiffness, friction, total = chart.panels
    labels = [{curve.label for curve in panel.curves} for panel in chart.panels]
    assert "truth" not in labels[0]
    assert "truth" in labels[1] & labels[2]
    assert "published, Kelvin-Voigt" in labels[0] & labels[2]
    assert "published, Kelvin-Voigt" not in labels[1], "its unit is another"
    ours = next(curve for curve in friction.curves if curve.label == "ours")
    assert ours.std is not None
    assert stiffness.limits is not None
    assert total.limits is not None
    assert total.limits[1] > true_friction(told.truth)["cumulative_friction_Ns_per_m"][1][-1]


def test_true_friction_is_force_over_speed_at_the_rupture(told):
    (rupture,) = told.truth.ruptures
    steps = true_friction(told.truth)
    times, total = steps["cumulative_friction_Ns_per_m"]
    assert total[0] == 0.0
    assert total[-1] == pytest.approx(rupture.layer_friction_N / 5e-3, rel=1e-3)
    assert times[-1] == told.truth.insertion_end_s
    _, local = steps["friction_Ns_per_m2"]
    assert local[0] == pytest.approx(total[-1] / rupture.onset_m)


def test_the_published_method_run_as_by_its_authors_comes_near_the_truth(told):
    noise = np.random.default_rng(0).normal(scale=0.2e-3, size=len(told.truth.t_s))
    noisy = replace(told.signal, speed_m_s=told.signal.speed_m_s + noise)
    tuned = tuned_published(noisy, told.truth, told.commanded_m_s)
    (rupture,) = told.truth.ruptures

    def error_N(item):
        inside = [alarm for alarm in item.alarms if alarm.alarm_s < told.truth.insertion_end_s]
        return abs(sum(alarm.layer.friction_N for alarm in inside) - rupture.layer_friction_N)

    assert error_N(tuned) < 0.15 * rupture.layer_friction_N
    assert error_N(tuned) < 0.5 * error_N(identify(noisy, told.truth, "published"))


def test_sigma_1_stays_within_what_its_authors_used():
    for figure, source in (("8", "ft"), ("11", "virtual"), ("13", "virtual"), ("", "ft")):
        assert 0.03 <= sigma1_N(figure, source) <= 0.15


def test_the_offline_fit_foretells_the_withdrawal(told):
    chart = offline_chart("a", told.signal, told.truth)
    (_, unfitted) = chart.shadings
    assert unfitted.spans[0][0] == told.truth.insertion_end_s - told.truth.tare_end_s
    labels = list(curves(chart))
    assert labels[0] == "F/T reading"
    assert [label.split(",")[0] for label in labels[1:3]] == ["Kelvin-Voigt", "multi-layer"]
    ml = next(curve for label, curve in curves(chart).items() if label.startswith("multi"))
    assert ml.y.min() < -0.1, "on the way out the needle is held back"
    assert chart.x_limits[1] == pytest.approx(ml.x[-1])


def test_a_run_of_a_figure_draws_its_panels_and_numbers(told, tmp_path):
    job = Job(benchmark="gel-70-constant", plant="needle")
    found = [(told.signals, told.identified)]
    drawings = identification_drawings(job, tmp_path, told.truth, told.commanded_m_s, found)
    assert [(item.figure, item.panel) for item in drawings] == [
        ("2", "a"),
        ("8", "a"),
        ("8", "a"),
        ("8", "b"),
    ]
    facts = [fact for item in drawings if item.figure == "8" for fact in item.facts]
    assert [fact.paper for fact in facts] == [
        "1, at about 15 s",
        "481 online, 534 offline (Table I)",
        "almost zero (ML)",
    ]
    ours = [dict(fact.here)["ours, one setting, here"] for fact in facts]
    (rupture,) = told.truth.ruptures
    assert ours[0] == f"1, at {told.ours.alarms[0].alarm_s - told.truth.tare_end_s:.1f} s"
    assert float(ours[1]) == pytest.approx(rupture.layer_friction_N / 5e-3, rel=0.05)
    assert 0.0 <= float(ours[2]) < 10.0
    (tuned,) = [item for item in drawings if not np.isnan(item.tuned_friction_Ns_per_m)]
    assert tuned.tuned_friction_Ns_per_m == pytest.approx(float(ours[1]), rel=0.15)
    assert all(item.alt and item.caption and item.path.is_file() for item in drawings)


def test_a_title_says_which_run_it_is(tmp_path):
    simulated = Sketchbook(Job(benchmark="a", plant="degraded", seed=2), tmp_path)
    assert simulated.title("8", "b", "forces") == "8b  forces\na, degraded, seed 2"
    recorded = Sketchbook(Job(benchmark="a", plant="recording", seed=3), tmp_path)
    assert recorded.title("", "", "forces") == "forces\na, recording 3"
