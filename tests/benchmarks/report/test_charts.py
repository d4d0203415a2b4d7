"""The charts of a run: the right curves, events, times and numbers."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.insertion.methods import (
    SIGMA1_N,
    ForceReading,
    identify,
    identify_as_run,
)
from benchmarks.insertion.metrics import IdentifiedRun
from benchmarks.insertion.signals import ForceTruth, NeedleSignal, insertion_truth
from benchmarks.insertion.simulated import identify_kelvin_voigt
from benchmarks.jobs import Job
from benchmarks.report.force_plots import force_figures
from benchmarks.report.identification_figures import draw_identification
from groundtruth import insert_needle
from tests.benchmarks.benchmark_cases import gel_slice

pytestmark = pytest.mark.slow


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


ERRORS_N = {
    ("virtual", "ours"): 0.05,
    ("ft", "ours"): 0.01,
    ("virtual", "published-one-setting"): 0.2,
}
STD_N = np.full(len(T), 0.1)
READINGS = [
    ForceReading(
        source=source, method=method, axial_N=TRUTH.axial_N + error_N, std_N=STD_N
    )
    for (source, method), error_N in ERRORS_N.items()
]


def test_figure_5_has_its_panels_and_published_numbers(
    tmp_path,
):
    over_time, over_depth = force_figures(GEL, tmp_path, TRUTH, READINGS)

    assert [item.figure + item.panel for item in (over_time, over_depth)] == [
        "5a",
        "5c",
    ]

    against_ft, against_truth, delay, within = over_time.facts

    assert against_ft["published"] == "0.2444"
    assert against_ft["published, here"] == "0.1900"
    assert against_ft["ours, here"] == "0.0400"
    assert against_truth["ours, here"] == "0.0500"
    assert within["ours, here"] == "100.0"
    assert "delay" in delay[""]
    assert over_depth.shown.path.is_file()

    job = Job(benchmark="random-stack", plant="degraded", seed=3)
    (drawing,) = force_figures(job, tmp_path, TRUTH, READINGS)

    assert drawing.shown.path.name == "random-stack-degraded-3-force-time.svg"


SHORT = gel_slice()


@pytest.fixture(scope="module")
def run():
    """A short insertion, and what both methods made of it."""
    run = insert_needle(SHORT, seed=0)
    measured = {
        name: getattr(run, name) for name in ("t_s", "depth_m", "speed_m_s", "force_N")
    }
    truth = insertion_truth(run)
    signal = NeedleSignal(source="ft", **measured)
    commanded_m_s = SHORT.motion.speed_m_s(truth.t_s)
    identified = [
        identify(signal, truth, method) for method in ("ours", "published-one-setting")
    ]
    identified.append(identify_as_run(signal, truth, commanded_m_s))
    return SimpleNamespace(
        truth=truth, signal=signal, identified=identified, commanded_m_s=commanded_m_s
    )


def test_the_published_method_as_run_is_near_truth(run):
    noise = np.random.default_rng(0).normal(scale=0.2e-3, size=len(run.truth.t_s))
    noisy = replace(run.signal, speed_m_s=run.signal.speed_m_s + noise)
    tuned = identify_as_run(noisy, run.truth, run.commanded_m_s)
    (rupture,) = run.truth.ruptures

    def error_N(item):
        inside = [
            alarm for alarm in item.alarms if alarm.alarm_s < run.truth.insertion_end_s
        ]
        return abs(
            sum(alarm.layer.friction_N for alarm in inside) - rupture.layer_friction_N
        )

    assert error_N(tuned) < 0.15 * rupture.layer_friction_N
    assert error_N(tuned) < 0.5 * error_N(
        identify(noisy, run.truth, "published-one-setting")
    )
    assert tuned.config.sigma1_N in SIGMA1_N
    assert (min(SIGMA1_N), max(SIGMA1_N)) == (0.03, 0.15), "what its authors used"


def test_a_run_draws_the_panels_of_its_figures(run, tmp_path):
    job = Job(benchmark="gel-70-constant", plant="needle")
    identified = IdentifiedRun(
        truth=run.truth, commanded_m_s=run.commanded_m_s, sources=[run.identified]
    )
    kelvin_voigt = identify_kelvin_voigt(identified)
    numbers = identified.measure()
    drawings = draw_identification(job, tmp_path, identified, numbers, kelvin_voigt)
    panels = [(item.figure, item.panel) for item in drawings]

    assert panels == [("2", "a"), ("8", "a"), ("8", "b"), ("8", "c")]

    facts = [fact for item in drawings if item.figure == "8" for fact in item.facts]

    assert [fact["published"] for fact in facts] == [
        "1, at about 15 s",
        "481 online, 534 offline (Table I)",
        "almost zero (ML)",
    ]

    ours = [fact["ours, one setting, here"] for fact in facts]
    (rupture,) = run.truth.ruptures

    assert (
        ours[0]
        == f"1, at {run.identified[0].alarms[0].alarm_s - run.truth.tare_end_s:.1f} s"
    )
    assert float(ours[1]) == pytest.approx(rupture.layer_friction_N / 5e-3, rel=0.05)
    assert 0.0 <= float(ours[2]) < 10.0

    tuned = facts[1]["published, tuned, here"]

    assert float(tuned) == pytest.approx(float(ours[1]), rel=0.15)
