"""The catalogue: permanent names, the paper's figures, and needle-only runs of it."""

import time
from dataclasses import replace

import numpy as np
import pytest

import groundtruth
from groundtruth import SCENARIOS, ForceNoise, insert_needle, scenario
from groundtruth.errors import GroundTruthError, NoiseError, RunError, ScenarioError
from groundtruth.force_noise import CLEAN, MINI45
from groundtruth.multilayer_tissue import MultilayerTissue
from groundtruth.tissue import Tissue

NAMES = (
    *(f"gel-{percent}-{kind}" for percent in (25, 50, 70) for kind in ("constant", "sinusoidal")),
    "stack-constant",
    "stack-sinusoidal",
    "stack-glove-constant",
    "stack-glove-sinusoidal",
    "liver-constant",
    "abdomen-sinusoidal",
    "free-motion",
)
TISSUE_NAMES = NAMES[:-1]
NEEDLE_M = 0.153


@pytest.fixture(scope="module")
def runs():
    return {name: insert_needle(name, rate_hz=500.0) for name in NAMES}


def test_names_are_permanent():
    assert set(SCENARIOS) == set(NAMES)
    assert all(scenario(name).id == name for name in NAMES)


def test_unknown_name_lists_the_known_ones():
    with pytest.raises(ScenarioError, match="gel-70-constant"):
        scenario("gel-80-constant")
    with pytest.raises(ScenarioError, match="multilayer"):
        scenario("gel-70-constant").with_law("springs")


def test_catalogue_cannot_be_changed():
    with pytest.raises(TypeError):
        SCENARIOS["mine"] = scenario("free-motion")


def test_law_is_chosen_by_the_scenario():
    assert isinstance(scenario("gel-25-constant").new_tissue(), Tissue)
    assert isinstance(
        scenario("gel-25-constant").with_law("multilayer").new_tissue(), MultilayerTissue
    )


@pytest.mark.parametrize("name", TISSUE_NAMES)
def test_needle_goes_at_least_a_centimetre_beyond_and_is_long_enough(name):
    case = scenario(name)
    assert case.motion.deepest_m - case.thickness_m >= 10e-3
    assert case.motion.deepest_m < NEEDLE_M


@pytest.mark.parametrize(
    ("name", "speed_m_s"),
    [
        ("gel-25-constant", 2.3e-3),
        ("gel-50-constant", 2.3e-3),
        ("gel-70-constant", 2.3e-3),
        ("stack-constant", 2.3e-3),
        ("liver-constant", 2.3e-3),
        ("stack-glove-constant", 3e-3),
    ],
)
def test_constant_speeds_are_the_papers(runs, name, speed_m_s):
    run = runs[name]
    inside = (run.truth.layer > 0) & (run.t_s < scenario(name).motion.insertion_end_s - 1.0)
    assert run.speed_m_s[inside] == pytest.approx(speed_m_s, rel=1e-9)


def test_gel_peaks_grow_with_the_concentration(runs):
    peaks = [runs[f"gel-{percent}-constant"].truth.axial_N.max() for percent in (25, 50, 70)]
    assert peaks[0] < peaks[1] < peaks[2]
    assert 2.5 < peaks[2] < 3.0


def test_the_70_per_cent_gel_ruptures_when_the_papers_does(runs):
    """About 15 s into the constant and 20 s into the sinusoidal insertion (Figs. 2, 8, 9)."""
    for name, expected_s in (("gel-70-constant", 15.0), ("gel-70-sinusoidal", 20.0)):
        rupture_s = runs[name].truth.rupture_s[0] - runs[name].tare_end_s
        assert rupture_s == pytest.approx(expected_s, abs=2.0)


@pytest.mark.parametrize(
    ("name", "count"),
    [(name, 1) for name in NAMES[:6]]
    + [(name, 3) for name in NAMES[6:10]]
    + [("liver-constant", 2), ("abdomen-sinusoidal", 3)],
)
def test_ruptures_are_the_papers_and_in_order(runs, name, count):
    found = runs[name].truth.ruptures
    assert len(found) == count
    assert all(item.end_s > item.onset_s for item in found)
    assert (np.diff([item.onset_s for item in found]) > 1.0).all()


@pytest.mark.parametrize("name", TISSUE_NAMES)
def test_rupture_drop_is_the_tip_force_at_its_onset(runs, name):
    run = runs[name]
    boundaries = [b for b in run.scenario.new_tissue().interfaces if b.drop_N > 0.0]
    for rupture, boundary in zip(run.truth.ruptures, boundaries, strict=True):
        around = np.abs(run.t_s - rupture.onset_s) < 0.02
        assert rupture.drop_N == pytest.approx(run.truth.tip_N[around].max(), rel=0.01)
        assert rupture.drop_N == pytest.approx(boundary.drop_N, rel=0.03)
        assert 0.0 < rupture.visible_drop_N < rupture.drop_N + 0.03
        released_m = np.interp(rupture.end_s, run.t_s, run.depth_m) - rupture.onset_m
        assert released_m == pytest.approx(boundary.release_m, abs=1e-6)


def test_layer_friction_at_its_rupture_is_table_i_at_its_speed(runs):
    found = runs["stack-constant"].truth.ruptures
    friction = [rupture.layer_friction_N for rupture in found]
    assert friction == pytest.approx([113 * 2.3e-3, 283 * 2.3e-3, 534 * 2.3e-3], rel=0.01)
    assert found[-1].friction_N == pytest.approx(sum(friction), rel=0.01)


@pytest.mark.parametrize("name", TISSUE_NAMES)
def test_contact_and_withdrawal_are_dated_where_the_depth_is_zero(runs, name):
    run = runs[name]
    assert run.tare_end_s < run.truth.contact_s < run.truth.withdrawn_s
    for instant in (run.truth.contact_s, run.truth.withdrawn_s):
        assert np.interp(instant, run.t_s, run.depth_m) == pytest.approx(0.0, abs=1e-9)
    outside = (run.t_s < run.truth.contact_s) | (run.t_s > run.truth.withdrawn_s)
    assert (run.truth.axial_N[outside] == 0.0).all()


def test_free_motion_meets_nothing(runs):
    truth = runs["free-motion"].truth
    assert (truth.axial_N == 0.0).all()
    assert truth.ruptures == ()
    assert np.isnan([truth.contact_s, truth.withdrawn_s]).all()


def test_same_seed_same_run_other_seed_other_noise_same_truth():
    first, again, other = (insert_needle("gel-25-constant", seed=s) for s in (3, 3, 4))
    assert (first.force_N == again.force_N).all()
    assert (first.force_N != other.force_N).any()
    assert (first.truth.axial_N == other.truth.axial_N).all()


def test_noise_is_as_large_as_stated(runs):
    run = runs["free-motion"]
    assert np.diff(run.force_N).std() / np.sqrt(2.0) == pytest.approx(MINI45.white_std_N, rel=0.05)
    steps = run.force_N / MINI45.step_N
    assert steps == pytest.approx(np.round(steps), abs=1e-9)


def test_drift_is_zero_where_the_sensor_was_zeroed():
    drift = ForceNoise(white_std_N=0.0, drift_std_N_per_s=1.0, step_N=0.0)
    t = np.linspace(0.0, 10.0, 11)
    reading = drift.reading_N(np.zeros(11), t, 4.0, np.random.default_rng(0))
    assert reading[4] == 0.0
    assert reading == pytest.approx(reading[5] * (t - 4.0))


def test_clean_reading_is_the_truth():
    run = insert_needle("gel-25-constant", noise="clean")
    assert (run.force_N == run.truth.axial_N).all()
    assert (insert_needle("gel-25-constant", noise=CLEAN).force_N == run.force_N).all()


def test_substeps_and_rate_change_the_sampling_not_the_force(runs):
    coarse = insert_needle("liver-constant", rate_hz=250.0, noise="clean")
    fine = runs["liver-constant"]
    count = min(coarse.t_s.size, fine.t_s[::2].size)
    assert coarse.t_s[:count] == pytest.approx(fine.t_s[::2][:count])
    assert coarse.truth.axial_N[:count] == pytest.approx(fine.truth.axial_N[::2][:count], abs=1e-3)
    split = insert_needle("liver-constant", rate_hz=250.0, substeps=4, noise="clean")
    assert split.truth.axial_N == pytest.approx(coarse.truth.axial_N, abs=1e-3)


def test_arrays_are_read_only(runs):
    run = runs["gel-25-constant"]
    arrays = (run.t_s, run.depth_m, run.speed_m_s, run.force_N, run.truth.axial_N, run.truth.layer)
    assert not any(array.flags.writeable for array in arrays)


def test_a_minute_of_insertion_takes_seconds_at_most():
    begin = time.perf_counter()
    run = insert_needle("gel-70-constant")
    assert time.perf_counter() - begin < 0.1 * run.t_s[-1]


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_unusable_rate_is_refused(rate_hz):
    with pytest.raises(RunError, match="rate_hz"):
        insert_needle("gel-25-constant", rate_hz=rate_hz)


@pytest.mark.parametrize("substeps", [0, -2, 1.5])
def test_unusable_substeps_are_refused(substeps):
    with pytest.raises(RunError, match="substeps"):
        insert_needle("gel-25-constant", substeps=substeps)


def test_unknown_or_unphysical_noise_is_refused():
    with pytest.raises(NoiseError, match="mini45"):
        insert_needle("gel-25-constant", noise="loud")
    with pytest.raises(NoiseError, match="white_std_N"):
        replace(CLEAN, white_std_N=-1.0)


def test_every_error_is_a_ground_truth_error():
    assert all(
        issubclass(error, GroundTruthError) for error in (NoiseError, RunError, ScenarioError)
    )


def test_public_names_resolve_and_are_few():
    names = groundtruth.__all__
    assert len(names) <= 20
    assert all(hasattr(groundtruth, name) for name in names)
