"""The multi-layer method on simulated tissue that does not obey its model."""

import math
from dataclasses import replace

import numpy as np
import pytest

from groundtruth import insert_needle
from identification import MULTILAYER, Identifier, replay
from identification.config import MultilayerConfig
from identification.errors import InvalidConfigError
from identification.estimate import RuptureState


def run(name, seed=0, noise="mini45", rate_hz=1000.0, bias_N=0.0):
    """A needle, its recording from the tare on through the identifier, and the first row of it."""
    needle = insert_needle(name, seed=seed, noise=noise, rate_hz=rate_hz)
    first = int(np.searchsorted(needle.t_s, needle.tare_end_s))
    columns = (needle.t_s, needle.depth_m, needle.force_N + bias_N, needle.speed_m_s)
    return needle, replay(*(column[first:] for column in columns)), first


@pytest.fixture(scope="module")
def gel():
    return run("gel-70-constant")


@pytest.fixture(scope="module")
def stack():
    return run("stack-sinusoidal")


def test_one_gel_one_rupture_its_friction_within_a_few_percent(gel):
    needle, result, _ = gel
    truth = needle.truth.ruptures[0]
    (rupture,) = [e.rupture for e in result.estimates if e.rupture]
    assert 0.0 < rupture.alarm_s - truth.onset_s < 0.04
    assert abs(rupture.time_s - truth.onset_s) < 0.01
    assert rupture.time_s <= rupture.alarm_s
    layer = result.layers[0]
    assert layer.friction_N == pytest.approx(truth.layer_friction_N, rel=0.05)
    assert layer.friction_identified
    assert layer.force_drop_N == pytest.approx(truth.drop_N, rel=0.05)
    assert layer.thickness_m == pytest.approx(32.2e-3, abs=5e-4)
    states = [e.rupture_state for e in result.estimates]
    path = list(dict.fromkeys(states[states.index(RuptureState.DETECTED) :]))
    assert path[:3] == [
        RuptureState.DETECTED,
        RuptureState.FORCE_DROP_MEASURING,
        RuptureState.FRICTION_IDENTIFIED,
    ]


def test_constant_speed_does_not_separate_coulomb_from_viscous_but_the_stop_does(gel):
    needle, result, _ = gel
    then = [e.identified_layer for e in result.estimates if e.identified_layer][-1]
    assert not then.viscous_identified or not then.coulomb_identified
    layer, truth = result.layers[0], needle.scenario.layers[0].friction
    assert layer.viscous_identified
    assert layer.coulomb_identified
    assert layer.coulomb_N_per_m == pytest.approx(truth.coulomb_N_per_m, rel=0.15)
    assert layer.viscous_Ns_per_m2 == pytest.approx(truth.viscous_Ns_per_m2, rel=0.15)


def test_enhanced_force_vanishes_beyond_the_last_layer_and_at_rest(gel):
    needle, result, first = gel
    enhanced = np.array([e.enhanced_force_N for e in result.estimates])
    motion = needle.scenario.motion
    after = int(np.searchsorted(needle.t_s, needle.truth.ruptures[-1].end_s + 1.0)) - first
    stop = int(np.searchsorted(needle.t_s, motion.insertion_end_s)) - first
    plateau = float(np.mean(needle.truth.axial_N[first + after : first + stop]))
    assert np.mean(np.abs(enhanced[after:stop])) < 0.05 * plateau
    assert np.mean(np.abs(enhanced[stop + 300 : stop + 1900])) < 0.05 * plateau


def test_tip_force_follows_the_truth_in_a_stack_at_sinusoidal_speed(stack):
    needle, result, first = stack
    assert len(result.layers) == 3
    begun = next(k for k, e in enumerate(result.estimates) if e.identified_layer)
    tip = np.array([e.tip_force_N for e in result.estimates])[begun:]
    error = tip - needle.truth.tip_N[first + begun :]
    assert np.sqrt(np.mean(error**2)) < 0.15
    for layer, truth in zip(result.layers, needle.truth.ruptures, strict=True):
        assert layer.friction_N == pytest.approx(truth.layer_friction_N, rel=0.1)


def test_every_number_is_finite_and_nothing_physical_is_negative(stack):
    _, result, _ = stack
    for estimate in result.estimates[::50]:
        assert all(math.isfinite(v) for v in estimate if isinstance(v, float))
        assert estimate.stiffness_N_per_m >= 0.0
        assert estimate.friction_Ns_per_m2 >= 0.0
        assert estimate.cumulative_friction_Ns_per_m >= 0.0
    for layer in result.layers:
        assert layer.stiffness_N_per_m >= 0.0
        assert layer.friction_N >= 0.0
        assert layer.friction_std_N > 0.0


def test_withdrawal_raises_no_rupture_and_leaves_all_force_to_friction(stack):
    needle, result, first = stack
    turn = needle.scenario.motion.withdrawal_start_s
    late = result.estimates[int(np.searchsorted(needle.t_s, turn + 3.0)) - first :]
    assert all(e.rupture is None for e in late)
    assert max(abs(e.tip_force_N) for e in late) < 0.05


def test_a_membrane_does_not_move_the_layer_behind_it():
    needle, result, _ = run("stack-glove-constant")
    boundaries = np.cumsum([layer.thickness_m for layer in needle.scenario.layers])
    found = [layer.start_depth_m + layer.thickness_m for layer in result.layers]
    assert found == pytest.approx(boundaries, abs=1e-3)
    assert result.layers[0].rupture.depth_m > boundaries[0] + 3e-3
    for layer, truth in zip(result.layers, needle.truth.ruptures, strict=True):
        assert layer.friction_N == pytest.approx(truth.layer_friction_N, rel=0.1)


def test_a_capsule_at_the_surface_is_a_fictitious_layer():
    needle, result, _ = run("liver-constant")
    capsule, liver = result.layers
    assert capsule.force_drop_N == pytest.approx(needle.truth.ruptures[0].drop_N, rel=0.1)
    total = capsule.friction_N + liver.friction_N
    assert total == pytest.approx(needle.truth.ruptures[1].layer_friction_N, rel=0.1)


def test_free_motion_meets_nothing():
    _, result, _ = run("free-motion")
    assert result.layers == ()
    assert all(e.rupture is None for e in result.estimates)
    assert result.estimates[-1].layer == 0


def test_sparse_samples_are_enough():
    _, result, _ = run("gel-70-constant", rate_hz=50.0)
    assert len(result.layers) == 1
    assert result.layers[0].thickness_m == pytest.approx(32.2e-3, abs=1e-3)


def test_an_offset_of_the_sensor_is_taken_out():
    needle, result, _ = run("gel-50-constant", seed=2, bias_N=-0.4)
    assert abs(result.estimates[-1].enhanced_force_N) < 0.05
    truth = needle.truth.ruptures[0].layer_friction_N
    assert result.layers[0].friction_N == pytest.approx(truth, rel=0.05)


def pushed(force, noise_N, seed):
    """27 mm at 3 mm/s from 2 mm above the surface on, under a force of the depth."""
    rng, identifier = np.random.default_rng(seed), Identifier()
    depth = -2e-3 + 3e-6 * np.arange(9000)
    noisy = force(depth) + noise_N * rng.standard_normal(len(depth))
    rows = zip(depth.tolist(), noisy.tolist(), strict=True)
    return [identifier.update(z, 3e-3, f, 1e-3) for z, f in rows], identifier


def linear_layer(seed, noise_N, drop_N=0.0, release_m=0.4e-3):
    """60 N/m from the depth 0 on, and a release at 20 mm after 22/3 s."""

    def force(depth):
        released = drop_N * np.clip((depth - 20e-3) / release_m, 0.0, 1.0)
        return 60.0 * np.maximum(depth, 0.0) - released

    return pushed(force, noise_N, seed)


@pytest.mark.parametrize("seed", range(4))
def test_a_rupture_time_is_that_of_its_onset_not_of_its_alarm(seed):
    estimates, _ = linear_layer(seed, noise_N=0.03, drop_N=0.8)
    (rupture,) = [e.rupture for e in estimates if e.rupture]
    assert rupture.alarm_s - 22.0 / 3.0 > 0.01
    assert rupture.time_s == pytest.approx(22.0 / 3.0, abs=0.006)
    assert rupture.depth_m == pytest.approx(20e-3, abs=2e-5)
    assert rupture.alarm_depth_m > rupture.depth_m + 3e-5
    assert rupture.travel_in_tissue_m == pytest.approx(20e-3, abs=0.3e-3)


def test_without_a_rupture_the_friction_is_as_uncertain_as_its_prior():
    """At constant speed nothing separates stiffness from friction: half of 60 N/m, give or take
    a fifth of it."""
    estimates, _ = linear_layer(5, noise_N=1e-3)
    last = estimates[-1]
    assert 3e-3 * last.friction_Ns_per_m2 == pytest.approx(30.0, rel=0.02)
    assert 3e-3 * last.friction_std_Ns_per_m2 == pytest.approx(0.2 * 60.0, rel=0.05)
    assert last.stiffness_std_N_per_m == pytest.approx(0.2 * 60.0, rel=0.05)
    assert last.shaft_friction_std_N == pytest.approx(0.2 * 60.0 * 25e-3, rel=0.05)


def test_a_layer_is_reported_provisionally_then_finally():
    estimates, identifier = linear_layer(0, noise_N=0.01, drop_N=0.8)
    reported = [(e.time_s, e.identified_layer) for e in estimates if e.identified_layer]
    assert [layer.is_final for _, layer in reported] == [False, True]
    assert [layer.layer for _, layer in reported] == [1, 1]
    travel_m = [3e-3 * time_s - 22e-3 for time_s, _ in reported]
    windows = (MULTILAYER.provisional_window_m, MULTILAYER.final_window_m)
    assert travel_m == pytest.approx(windows, abs=0.2e-3)
    assert identifier.layers[0].is_final


@pytest.mark.parametrize(
    ("change", "message"),
    [({"presliding_m": 0.0}, "presliding_m"), ({"final_window_m": 1e-4}, "exceed")],
)
def test_bad_settings_are_refused(change, message):
    with pytest.raises(InvalidConfigError, match=message):
        replace(MULTILAYER, **change)
    assert MultilayerConfig() == MULTILAYER


@pytest.mark.parametrize("width_m", [0.4e-3, 0.7e-3, 1.1e-3])
@pytest.mark.parametrize("fall_N", [0.1, 0.4])
def test_an_alarm_whose_force_comes_back_is_retracted_and_leaves_no_layer(width_m, fall_N):
    """A dent in a growing force: a fall, but nothing was released."""

    def force(depth):
        since = (depth - 12e-3) / 0.3e-3
        dent = np.clip(since, 0.0, 1.0) - np.clip(since - width_m / 0.3e-3, 0.0, 1.0)
        return 60.0 * np.maximum(depth, 0.0) - fall_N * dent

    estimates, identifier = pushed(force, 0.005, 7)
    raised = [e.rupture for e in estimates if e.rupture]
    assert len(raised) == 1
    known_now = [replace(one, probability=0.0) for one in raised]
    assert [e.retracted for e in estimates if e.retracted] == known_now
    assert identifier.layers == ()
    assert estimates[-1].layer == 1
    assert estimates[-1].rupture_state is RuptureState.NO_RUPTURE
