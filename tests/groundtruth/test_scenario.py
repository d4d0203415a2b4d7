"""Motions, the catalogue and the random stacks: the paper's values, and needle-only
runs."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from groundtruth import (
    SCENARIOS,
    ForceNoise,
    MotionError,
    ScenarioError,
    Tissue,
    Tremor,
    constant_motion,
    insert_needle,
    random_stack,
    scenario,
    sinusoidal_motion,
)

CONSTANT = constant_motion(speed_m_s=2.3e-3, depth_m=45e-3, standoff_m=5e-3)
SINE = sinusoidal_motion(stroke_m=70e-3, frequency_hz=0.016, standoff_m=20e-3)
FREE = SCENARIOS["free-motion"].motion


def numeric_speed(motion, t, h):
    return (motion.position_m(t + h) - motion.position_m(t - h)) / (2.0 * h)


def test_a_tremor_swings_between_tare_and_withdrawal():
    motion = replace(CONSTANT, tremor=Tremor(amplitude_m=0.1e-3, frequency_hz=8.0))
    t = np.linspace(-1.0, motion.duration_s + 1.0, 20_001)
    swing_m = motion.position_m(t) - CONSTANT.position_m(t)
    is_outside = (t <= motion.tare_end_s) | (t >= motion.withdrawal_start_s)
    upwards_s = t[1:][np.diff(np.sign(swing_m)) > 0]

    assert motion.speed_m_s(t) == pytest.approx(
        numeric_speed(motion, t, 1e-6), abs=1e-6
    )
    assert not swing_m[is_outside].any()
    assert swing_m.max() == pytest.approx(0.1e-3, rel=1e-3)
    assert np.count_nonzero((upwards_s > 20.0) & (upwards_s < 21.0)) == 8


@pytest.mark.parametrize("motion", [CONSTANT, SINE, FREE])
def test_speed_is_the_bounded_rate_of_position(motion):
    t = np.linspace(-1.0, motion.duration_s + 1.0, 50_001)
    speed_m_s = motion.speed_m_s(t)
    end_s = motion.duration_s
    rests_s = np.array([0.0, 0.5, 1.0, end_s - 0.25, end_s + 9.0])

    assert speed_m_s == pytest.approx(numeric_speed(motion, t, 1e-5), abs=2e-6)
    assert np.abs(np.diff(speed_m_s) / np.diff(t)).max() < 0.05
    assert not motion.speed_m_s(rests_s).any()


@pytest.mark.parametrize("motion", [CONSTANT, SINE])
def test_tare_is_in_air_and_withdrawal_mirrors_insertion(motion):
    tare_s = np.linspace(0.0, motion.tare_end_s, 5000)
    end_s = np.linspace(motion.withdrawal_end_s, motion.duration_s + 1.0, 100)

    signs = np.sign(motion.speed_m_s(tare_s))
    s = np.linspace(0.0, motion.insertion_end_s - motion.tare_end_s, 1000)
    inward = motion.position_m(motion.insertion_end_s - s)
    outward = motion.position_m(motion.withdrawal_start_s + s)

    assert (motion.position_m(np.append(tare_s, end_s)) < 0.0).all()
    assert np.ptp(motion.position_m(tare_s)) == pytest.approx(0.1)
    assert [s for previous, s in pairwise(signs) if s and s != previous] == [1, -1, 1]
    assert motion.withdrawal_start_s - motion.insertion_end_s == pytest.approx(2.0)
    assert outward == pytest.approx(inward, abs=1e-12)


def test_sinusoidal_insertion_is_the_papers():
    s = np.linspace(0.0, 0.5 / 0.016, 500)
    expected = 0.035 * (1.0 - np.cos(2.0 * np.pi * 0.016 * s)) - 20e-3

    contact = SINE.tare_end_s + s[np.searchsorted(expected, 0.0)]
    free_m = FREE.position_m(np.linspace(0.0, FREE.duration_s, 1000))

    assert SINE.position_m(SINE.tare_end_s + s) == pytest.approx(expected, abs=1e-12)
    assert SINE.speed_m_s(contact) > 2e-3
    assert free_m.max() == pytest.approx(-20e-3)


GOOD = {
    constant_motion: {"speed_m_s": 2e-3, "depth_m": 0.05, "standoff_m": 5e-3},
    sinusoidal_motion: {"stroke_m": 0.07, "frequency_hz": 0.016, "standoff_m": 0.02},
    insert_needle: {"scenario": "gel-25-constant", "rate_hz": 250.0},
}


@pytest.mark.parametrize(
    ("make", "change", "word"),
    [
        (constant_motion, {"speed_m_s": 0.1, "depth_m": 0.01}, "too short"),
        (sinusoidal_motion, {"stroke_m": 0.02}, "above the surface"),
        *(
            (make, {field: value}, field)
            for make, good in GOOD.items()
            for field in good
            if field != "scenario"
            for value in (0.0, -1.0, float("nan"), float("inf"))
        ),
    ],
)
def test_impossible_motions_and_rates_are_refused(make, change, word):
    with pytest.raises(MotionError, match=word):
        make(**(GOOD[make] | change))


RUPTURES = {
    **dict.fromkeys(
        (
            f"gel-{k}-{kind}"
            for k in (25, 50, 70)
            for kind in ("constant", "sinusoidal")
        ),
        1,
    ),
    **dict.fromkeys(
        (
            "stack-constant",
            "stack-sinusoidal",
            "stack-glove-constant",
            "stack-glove-sinusoidal",
            "abdomen-sinusoidal",
        ),
        3,
    ),
    "liver-constant": 2,
}
DRAWN = [random_stack(np.random.default_rng(seed)) for seed in range(200)]
NEEDLE_M = 0.153


@pytest.fixture(scope="module")
def runs():
    return {name: insert_needle(name, rate_hz=500.0) for name in SCENARIOS}


def test_names_are_permanent_and_choose_motion_and_seed():
    assert {scenario(name).id for name in SCENARIOS} == {*RUPTURES, "free-motion"}
    assert scenario("random-stack", 7) == DRAWN[7] != DRAWN[8]
    assert scenario("gel-25-constant", 7) is scenario("gel-25-constant")
    with pytest.raises(ScenarioError, match=r"'gel-80'.*random-stack"):
        scenario("gel-80")

    # The needle goes at least a centimetre beyond and is long enough.
    for case in (*(scenario(name) for name in RUPTURES), *DRAWN):
        end_m = Tissue(case.layers).interfaces[-1].depth_m
        assert end_m + 10e-3 <= case.motion.deepest_m < NEEDLE_M


def test_drawn_tissue_goes_on_cutting_behind_a_rupture():
    stacks = [scenario("drawn-tissue", seed) for seed in range(60)]
    layers = [layer for stack in stacks for layer in stack.layers]
    cutting_N = [layer.cutting_fraction * layer.exit_force_N for layer in layers]

    assert {len(stack.layers) for stack in stacks} == {1, 2, 3}
    assert 0.1 <= min(cutting_N) < 0.2 < 0.6 < max(cutting_N) <= 0.9
    assert {5.0 < layer.stiffness_N_per_m < 50.0 for layer in layers} == {True}
    for stack in stacks:
        end_m = Tissue(stack.layers).interfaces[-1].depth_m
        assert end_m + 10e-3 <= stack.motion.deepest_m < NEEDLE_M


def test_speeds_peaks_ruptures_and_friction_are_the_papers(runs):
    for name in (name for name in RUPTURES if name.endswith("-constant")):
        run = runs[name]
        is_steady = run.t_s < run.scenario.motion.insertion_end_s - 1.0
        speed_m_s = 3e-3 if "glove" in name else 2.3e-3
        assert run.speed_m_s[is_steady & (run.truth.layer > 0)] == pytest.approx(
            speed_m_s, rel=1e-9
        )
    # About 15 s into the constant and 20 s into the sinusoidal insertion (Figs. 2, 8,
    # 9).
    kinds = [runs[f"gel-70-{kind}"] for kind in ("constant", "sinusoidal")]
    into_s = [run.truth.rupture_s[0] - run.tare_end_s for run in kinds]
    ruptures = runs["stack-constant"].truth.ruptures  # Table I at this speed
    friction = [rupture.layer_friction_N for rupture in ruptures]

    assert into_s == pytest.approx([15.0, 20.0], abs=2.0)
    assert friction == pytest.approx(
        [113 * 2.3e-3, 283 * 2.3e-3, 534 * 2.3e-3], rel=0.01
    )
    assert ruptures[-1].friction_N == pytest.approx(sum(friction), rel=0.01)


@pytest.mark.parametrize(("name", "count"), RUPTURES.items())
def test_ruptures_are_the_papers_in_order(runs, name, count):
    run = runs[name]
    ruptures = run.truth.ruptures

    assert len(ruptures) == count
    assert (np.diff([item.onset_s for item in ruptures]) > 1.0).all()

    boundaries = [b for b in Tissue(run.scenario.layers).interfaces if b.drop_N > 0.0]
    for rupture, boundary in zip(ruptures, boundaries, strict=True):
        around = np.abs(run.t_s - rupture.onset_s) < 0.02
        end_m = np.interp(rupture.end_s, run.t_s, run.depth_m)
        assert rupture.drop_N == pytest.approx(run.truth.tip_N[around].max(), rel=0.01)
        assert rupture.drop_N == pytest.approx(boundary.drop_N, rel=0.03)
        assert 0.0 < rupture.visible_drop_N < rupture.drop_N + 0.03
        assert end_m - rupture.onset_m == pytest.approx(boundary.release_m, abs=1e-6)


def test_free_motion_reads_the_stated_noise(runs):
    run = runs["free-motion"]
    white_std_N = np.diff(run.force_N).std() / np.sqrt(2.0)
    steps = 256.0 * run.force_N

    assert not run.truth.axial_N.any()
    assert run.truth.ruptures == ()
    assert np.isnan([run.truth.contact_s, run.truth.withdrawn_s]).all()
    assert white_std_N == pytest.approx(0.01, rel=0.05)
    assert steps == pytest.approx(np.round(steps), abs=1e-9)


def test_seeds_change_the_noise_only(runs):
    usual = runs["gel-25-constant"]
    again, other = (
        insert_needle("gel-25-constant", seed=seed, rate_hz=500.0) for seed in (0, 4)
    )
    quiet = insert_needle("gel-25-constant", rate_hz=500.0, noise=ForceNoise())

    assert (again.force_N == usual.force_N).all()
    assert (other.force_N != usual.force_N).any()
    assert (other.truth.axial_N == usual.truth.axial_N).all()
    assert (quiet.force_N == usual.truth.axial_N).all()
    assert not quiet.force_N.flags.writeable | quiet.truth.axial_N.flags.writeable


def test_the_rate_changes_the_sampling_not_the_force(runs):
    dense = runs["liver-constant"]
    rare = insert_needle("liver-constant", rate_hz=250.0)
    rows = slice(0, 2 * rare.t_s.size, 2)

    assert rare.t_s == pytest.approx(dense.t_s[rows])
    assert rare.truth.axial_N == pytest.approx(dense.truth.axial_N[rows], abs=1e-3)


@pytest.mark.parametrize("name", RUPTURES)
def test_tissue_never_pulls_and_friction_never_drives(runs, name):
    run = runs[name]
    truth = run.truth
    z = run.depth_m
    ends_m = np.interp([truth.contact_s, truth.withdrawn_s], run.t_s, z)
    is_outside = (run.t_s < truth.contact_s) | (run.t_s > truth.withdrawn_s)
    power = truth.friction_N * run.speed_m_s
    # Presliding stores a little energy and returns it while the shaft turns round.
    turning_m = 3.0 * max(layer.friction.presliding_m for layer in run.scenario.layers)

    assert run.tare_end_s < truth.contact_s < truth.withdrawn_s
    assert ends_m == pytest.approx([0.0, 0.0], abs=1e-9)
    assert not truth.axial_N[is_outside].any()
    assert truth.tip_N.min() >= 0.0
    assert truth.axial_N == pytest.approx(truth.tip_N + truth.friction_N, abs=1e-12)
    assert (power[np.abs(z - z.max()) > turning_m] >= -1e-15).all()
    assert power.sum() > 0.0


@pytest.mark.slow
def test_drawn_stacks_are_physical_and_rupture_everywhere():
    layers = [layer for stack in DRAWN for layer in stack.layers]
    with_membrane = np.mean([layer.membrane is not None for layer in layers])
    friction = [layer.friction.sliding_N_per_m(2.3e-3) for layer in layers]

    assert {len(stack.layers) for stack in DRAWN} == {1, 2, 3, 4}
    assert {stack.motion.strokes[4].profile for stack in DRAWN} == {"cruise", "cosine"}
    assert with_membrane == pytest.approx(0.25, abs=0.1)
    assert 1.0 < min(friction) < max(friction) < 60.0
    for stack in (*DRAWN[:3], *(scenario("random-tissue", seed) for seed in range(2))):
        run = insert_needle(stack, rate_hz=200.0)
        drops_N = [boundary.drop_N for boundary in Tissue(stack.layers).interfaces]
        assert len(run.truth.ruptures) == np.count_nonzero(drops_N)
        assert run.truth.tip_N.min() >= 0.0
        assert np.abs(run.force_N).max() < 15.0
