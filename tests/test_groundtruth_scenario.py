"""The catalogue and the random stacks: names, the paper's values, and needle-only runs of both."""

import time
from dataclasses import replace

import numpy as np
import pytest

from groundtruth import SCENARIOS, ForceNoise, insert_needle, random_stack, scenario
from groundtruth.errors import NoiseError, RunError, ScenarioError
from groundtruth.force_noise import CLEAN, MINI45
from groundtruth.materials import TABLE_I_SPEED_M_S
from groundtruth.scenarios import named_scenario
from groundtruth.tissue import MultilayerTissue, Tissue

GELS = [f"gel-{percent}-{kind}" for percent in (25, 50, 70) for kind in ("constant", "sinusoidal")]
STACKS = ["stack-constant", "stack-sinusoidal", "stack-glove-constant", "stack-glove-sinusoidal"]
RUPTURES = dict.fromkeys(GELS, 1) | dict.fromkeys(STACKS, 3)
RUPTURES |= {"liver-constant": 2, "abdomen-sinusoidal": 3}
DRAWN = [random_stack(np.random.default_rng(seed)) for seed in range(200)]
NEEDLE_M = 0.153


@pytest.fixture(scope="module")
def runs():
    return {name: insert_needle(name, rate_hz=500.0) for name in SCENARIOS}


def test_names_are_permanent():
    assert set(SCENARIOS) == {*RUPTURES, "free-motion"}
    assert all(scenario(name).id == name for name in SCENARIOS)
    with pytest.raises(TypeError):
        SCENARIOS["mine"] = scenario("free-motion")


def test_a_seed_draws_a_scenario_by_name():
    assert named_scenario("random-stack", 7) == DRAWN[7] != DRAWN[8]
    assert named_scenario("gel-25-constant", 7) is scenario("gel-25-constant")


@pytest.mark.parametrize("ask", [scenario, lambda name: named_scenario(name, 0)])
def test_unknown_name_lists_the_known_ones(ask):
    with pytest.raises(ScenarioError, match=r"no scenario 'gel-80'; known: .*random-stack"):
        ask("gel-80")


def test_law_is_chosen_by_the_scenario():
    gel = scenario("gel-25-constant")
    assert isinstance(gel.new_tissue(), Tissue)
    assert isinstance(gel.with_law("multilayer").new_tissue(), MultilayerTissue)
    with pytest.raises(ScenarioError, match="multilayer"):
        gel.with_law("springs")


def test_needle_goes_at_least_a_centimetre_beyond_and_is_long_enough():
    for case in (*(scenario(name) for name in RUPTURES), *DRAWN):
        assert case.motion.deepest_m - case.thickness_m >= 10e-3
        assert case.motion.deepest_m < NEEDLE_M


@pytest.mark.parametrize("name", [name for name in RUPTURES if name.endswith("-constant")])
def test_constant_speeds_are_the_papers(runs, name):
    run = runs[name]
    inside = (run.truth.layer > 0) & (run.t_s < scenario(name).motion.insertion_end_s - 1.0)
    speed_m_s = 3e-3 if "glove" in name else 2.3e-3
    assert run.speed_m_s[inside] == pytest.approx(speed_m_s, rel=1e-9)


def test_gels_peak_and_rupture_as_the_papers_do(runs):
    """About 15 s into the constant and 20 s into the sinusoidal insertion (Figs. 2, 8, 9)."""
    peaks = [runs[f"gel-{percent}-constant"].truth.axial_N.max() for percent in (25, 50, 70)]
    assert peaks[0] < peaks[1] < peaks[2]
    assert 2.5 < peaks[2] < 3.0
    for name, expected_s in (("gel-70-constant", 15.0), ("gel-70-sinusoidal", 20.0)):
        rupture_s = runs[name].truth.rupture_s[0] - runs[name].tare_end_s
        assert rupture_s == pytest.approx(expected_s, abs=2.0)


@pytest.mark.parametrize(("name", "count"), RUPTURES.items())
def test_ruptures_are_the_papers_in_order_and_drop_the_tip_force(runs, name, count):
    run = runs[name]
    found = run.truth.ruptures
    assert len(found) == count
    assert (np.diff([item.onset_s for item in found]) > 1.0).all()
    boundaries = [b for b in run.scenario.new_tissue().interfaces if b.drop_N > 0.0]
    for rupture, boundary in zip(found, boundaries, strict=True):
        assert rupture.end_s > rupture.onset_s
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


def test_free_motion_meets_nothing_and_reads_noise_as_large_as_stated(runs):
    run = runs["free-motion"]
    assert (run.truth.axial_N == 0.0).all()
    assert run.truth.ruptures == ()
    assert np.isnan([run.truth.contact_s, run.truth.withdrawn_s]).all()
    assert np.diff(run.force_N).std() / np.sqrt(2.0) == pytest.approx(MINI45.white_std_N, rel=0.05)
    steps = run.force_N / MINI45.step_N
    assert steps == pytest.approx(np.round(steps), abs=1e-9)


def test_same_seed_same_run_other_seed_other_noise_same_truth():
    first, again, other = (insert_needle("gel-25-constant", seed=s) for s in (3, 3, 4))
    assert (first.force_N == again.force_N).all()
    assert (first.force_N != other.force_N).any()
    assert (first.truth.axial_N == other.truth.axial_N).all()


def test_drift_is_zero_where_the_sensor_was_zeroed():
    drift = ForceNoise(white_std_N=0.0, drift_std_N_per_s=1.0, step_N=0.0)
    t = np.linspace(0.0, 10.0, 11)
    reading = drift.reading_N(np.zeros(11), t, 4.0, np.random.default_rng(0))
    assert reading[4] == 0.0
    assert reading == pytest.approx(reading[5] * (t - 4.0))


def test_clean_reading_is_the_truth_and_arrays_are_read_only():
    for noise in ("clean", CLEAN):
        run = insert_needle("gel-25-constant", noise=noise)
        assert (run.force_N == run.truth.axial_N).all()
    arrays = (run.t_s, run.depth_m, run.speed_m_s, run.force_N, run.truth.axial_N, run.truth.layer)
    assert not any(array.flags.writeable for array in arrays)


@pytest.mark.parametrize("name", ["stack-glove-constant", "liver-constant", "abdomen-sinusoidal"])
def test_substeps_and_rate_change_the_sampling_not_the_force(name):
    coarse = insert_needle(name, noise="clean")
    split = insert_needle(name, substeps=4, noise="clean")
    assert split.truth.axial_N == pytest.approx(coarse.truth.axial_N, abs=2e-4)
    rare = insert_needle(name, rate_hz=250.0, noise="clean")
    assert rare.t_s == pytest.approx(coarse.t_s[::4][: rare.t_s.size])
    assert rare.truth.axial_N == pytest.approx(coarse.truth.axial_N[::4][: rare.t_s.size], abs=1e-3)


@pytest.mark.parametrize("name", RUPTURES)
def test_tissue_acts_inside_only_and_its_tip_never_pulls_nor_its_friction_drives(runs, name):
    run = runs[name]
    truth, z = run.truth, run.depth_m
    assert run.tare_end_s < truth.contact_s < truth.withdrawn_s
    for instant in (truth.contact_s, truth.withdrawn_s):
        assert np.interp(instant, run.t_s, z) == pytest.approx(0.0, abs=1e-9)
    outside = (run.t_s < truth.contact_s) | (run.t_s > truth.withdrawn_s)
    assert (truth.axial_N[outside] == 0.0).all()
    assert truth.tip_N.min() >= 0.0
    assert truth.axial_N == pytest.approx(truth.tip_N + truth.friction_N, abs=1e-12)
    power = truth.friction_N * run.speed_m_s
    # Presliding stores a little energy and returns it while the shaft turns round.
    turning_m = 3.0 * max(layer.friction.presliding_m for layer in run.scenario.layers)
    assert (power[np.abs(z - z.max()) > turning_m] >= -1e-15).all()
    assert power.sum() > 0.0


def test_a_minute_of_insertion_takes_seconds_at_most():
    begin = time.perf_counter()
    run = insert_needle("gel-70-constant")
    assert time.perf_counter() - begin < 0.1 * run.t_s[-1]


def test_unusable_settings_are_refused_by_name():
    for rate_hz in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(RunError, match="rate_hz"):
            insert_needle("gel-25-constant", rate_hz=rate_hz)
    for substeps in (0, -2, 1.5):
        with pytest.raises(RunError, match="substeps"):
            insert_needle("gel-25-constant", substeps=substeps)
    with pytest.raises(NoiseError, match="known: clean, mini45"):
        insert_needle("gel-25-constant", noise="loud")
    with pytest.raises(NoiseError, match="white_std_N"):
        replace(CLEAN, white_std_N=-1.0)


def test_drawn_stacks_vary_in_layers_motion_and_membranes_and_are_physical():
    assert {len(stack.layers) for stack in DRAWN} == {1, 2, 3, 4}
    assert {stack.motion.strokes[4].profile for stack in DRAWN} == {"cruise", "cosine"}
    layers = [layer for stack in DRAWN for layer in stack.layers]
    with_membrane = np.mean([layer.membrane is not None for layer in layers])
    assert with_membrane == pytest.approx(0.25, abs=0.1)
    friction = [layer.friction.sliding_N_per_m(TABLE_I_SPEED_M_S) for layer in layers]
    assert 1.0 < min(friction) < max(friction) < 60.0


def test_drawn_stacks_run_rupture_at_every_boundary_and_end_outside():
    for stack in DRAWN[:6]:
        run = insert_needle(stack, rate_hz=200.0)
        boundaries = [b for b in stack.new_tissue().interfaces if b.drop_N > 0.0]
        assert np.isfinite(run.force_N).all()
        assert len(run.truth.ruptures) == len(boundaries)
        assert run.truth.axial_N[-1] == 0.0
        assert run.truth.axial_N.max() < 15.0
