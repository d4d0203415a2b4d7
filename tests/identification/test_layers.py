"""Ruptures, layers and forces, on forces of a known law."""

import re
from functools import cache

import numpy as np
import pytest

from groundtruth import insert_needle
from identification import (
    MIXTURE,
    CheckConfig,
    Identifier,
    MixtureConfig,
    SampleStatus,
    TissueWarning,
    replay,
)
from tests.identification.worlds import (
    SPEED_M_S,
    THICKNESS_M,
    assert_both_found,
    insertion,
    kept_ruptures,
    noisy,
    rows_of,
    run,
    straight,
    true_force,
    values_of,
)


@cache
def straight_run(seed=0):
    """The identifier after both layers, and its estimates."""
    return run(straight(seed))


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_two_layers_are_found_reported_twice_and_split_within_their_deviations(seed):
    identifier, estimates = straight_run(seed)
    ruptures = values_of(estimates, "rupture")
    reports = values_of(estimates, "identified_layer")

    late_m = [rupture.alarm_depth_m for rupture in ruptures] - np.cumsum(THICKNESS_M)

    assert_both_found(identifier, estimates)
    assert [
        (rupture.layer, rupture.is_final, rupture.contact_depth_m)
        for rupture in ruptures
    ] == [(number, False, pytest.approx(0.0, abs=0.5e-3)) for number in (1, 2)]
    assert [
        (layer.layer, layer.is_final, layer.rupture.is_final) for layer in reports
    ] == [
        (number, is_final, is_final) for number in (1, 2) for is_final in (False, True)
    ]
    # A block of 10 ms ends at once where its force falls short.
    assert 0.0 < late_m.min() <= late_m.max() < 0.018 * SPEED_M_S
    truths_N = np.transpose([true_force(row.depth_m) for row in straight(seed)[6000:]])
    for name, truth_N in zip(("tip_force", "shaft_friction"), truths_N, strict=True):
        force_N = np.array(values_of(estimates[6000:], f"{name}_N"))
        std_N = np.array(values_of(estimates[6000:], f"{name}_std_N"))
        assert np.mean(np.abs(force_N - truth_N) < 2.0 * std_N + 5e-3) > 0.9
    last = estimates[-1]
    assert (last.layer, last.tip_force_N, last.enhanced_force_N) == pytest.approx(
        (3, 0.0, 0.0), abs=0.1
    )
    assert not any(TissueWarning.UNEXPLAINED in each.warnings for each in estimates)


def test_a_provisional_alarm_comes_first_and_is_confirmed():
    _, estimates = straight_run()
    confirmed = values_of(estimates, "rupture")
    provisional = values_of(estimates, "provisional")
    delays_s = np.subtract(
        *([e.alarm_s for e in es] for es in (confirmed, provisional))
    )

    assert [each.layer for each in provisional] == [1, 2]
    assert min(e.probability for e in provisional) > MIXTURE.provisional_probability
    assert 0.0 < delays_s.min() <= delays_s.max() < 0.1


@pytest.mark.slow
def test_a_provisional_alarm_is_confirmed_or_retracted_but_not_both():
    config = MixtureConfig(provisional_probability=0.5)
    _, estimates = run(straight(seed=1), Identifier(config))
    letters = {"rupture": "r", "provisional": "p", "provisional_retracted": "x"}
    course = "".join(
        letter
        for estimate in estimates
        for name, letter in letters.items()
        if getattr(estimate, name) is not None
    )

    assert re.fullmatch("(r|pr|px)+", course)


def test_a_surer_alarm_is_later():
    config = MixtureConfig(alarm_probability=0.999999)
    _, estimates = run(straight()[:5200], Identifier(config))
    (surer,) = values_of(estimates, "rupture")
    usual, _ = values_of(straight_run()[1], "rupture")

    assert surer.probability > 0.999999 > usual.probability >= MIXTURE.alarm_probability
    assert surer.alarm_s > usual.alarm_s


@pytest.mark.slow
def test_friction_at_changing_speed_is_no_texture():
    """The speed sways from 1 to 7 mm/s, and the friction with it by up to a newton."""
    swaying = straight(sway=0.8)
    _, estimates = run(swaying)
    std_N, usual_N = (
        np.mean(
            [
                estimate.tip_force_std_N
                for estimate, row in zip(found, rows, strict=True)
                if 20e-3 < row.depth_m < 33e-3
            ]
        )
        for found, rows in ((estimates, swaying), (straight_run()[1], straight()))
    )

    assert len(kept_ruptures(estimates)) == 2
    assert std_N < 2.0 * usual_N


def pushed_tip_N(force_std_N, faster_m_s):
    """By how much the tip force rises where the force does by a newton for 30 ms."""
    rows = straight()
    identifier, before = run(rows[:3000])
    pushed = (
        (
            z,
            v + faster_m_s * (z - rows[3000].depth_m) / v,
            f + 1.0,
            dt_s,
            None,
            force_std_N,
        )
        for z, v, f, dt_s in rows[3000:3030]
    )
    _, after = run(pushed, identifier)
    return after[-1].tip_force_N - before[-1].tip_force_N


@pytest.mark.slow
def test_an_uncertain_force_counts_less_during_acceleration():
    assert pushed_tip_N(force_std_N=0.0, faster_m_s=0.2) > 0.5
    assert pushed_tip_N(force_std_N=1.0, faster_m_s=0.0) > 0.5
    assert abs(pushed_tip_N(force_std_N=1.0, faster_m_s=0.2)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("has_speed", [True, False])
def test_noise_of_the_position_hides_no_ruptures(has_speed):
    # Without the stop at the end, which a speed estimated from such depths shows late.
    rows = straight(4, jitter_m=1e-4)[:-250]
    rows = [row if has_speed else row._replace(speed_m_s=None) for row in rows]

    assert_both_found(*run(rows), within=0.3)


@pytest.mark.slow
def test_rests_and_reversals_are_no_ruptures():
    inwards = [(12e-3, 3.0), (0.0, 1.5), (6e-3, 1.5), (0.0, 1.0)]
    back_and_on = [(-3e-3, 0.75), (3e-3, 0.75), (28e-3, 7.0)]

    assert_both_found(*run(insertion([*inwards, *back_and_on], seed=5)), within=0.3)


@pytest.mark.parametrize(("gap_s", "status"), [(0.25, "TIME_GAP"), (1.0, "OK")])
def test_a_gap_in_time_is_no_rupture_and_how_long_it_is_a_setting(gap_s, status):
    rows = straight(9)
    config = MixtureConfig(check=CheckConfig(gap_s=gap_s))
    gap = rows[3200]._replace(dt_s=0.701)
    _, estimates = run([*rows[:2500], gap, *rows[3201:4000]], Identifier(config))

    assert (estimates[2500].status, values_of(estimates, "rupture")) == (
        SampleStatus[status],
        [],
    )


def test_withdrawal_meets_friction_only_and_ends_in_free_air():
    rows = insertion([(40e-3, 10.0), (-44e-3, 8.0)], seed=6)
    identifier, estimates = run(rows)
    outwards = list(zip(estimates, rows, strict=True))[11_000:]
    estimates = [estimate for estimate, _ in outwards]
    errors_N = [row.force_N - estimate.predicted_force_N for estimate, row in outwards]
    layers = {
        depth_m: {e.layer for e, row in outwards if abs(row.depth_m - depth_m) < 1e-3}
        for depth_m in (30e-3, 10e-3, -2e-3)
    }

    assert len(identifier.layers) == 2
    assert {estimate.tip_force_N for estimate in estimates[:3000]} == {0.0}
    assert np.sqrt(np.mean(np.square(errors_N))) < 0.1
    assert (estimates[-1].shaft_friction_N, estimates[-1].tip_force_N) == (
        0.0,
        pytest.approx(0.0, abs=0.05),
    )
    assert all(e.in_contact for e, row in outwards if row.depth_m > 0.0)
    assert not any(e.in_contact for e, row in outwards if row.depth_m < -2.5e-3)
    assert layers == {30e-3: {2}, 10e-3: {1}, -2e-3: {0}}


@pytest.mark.parametrize("stiffness_N_per_m", [150.0, 250.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_stiffness_of_a_membrane_met_in_air_is_reported(stiffness_N_per_m, seed):
    depth_m = np.arange(0.0, 20e-3, 5e-5)
    pushed_m = np.where(depth_m < 12e-3, np.maximum(depth_m - 5e-3, 0.0), 0.0)
    force_N = noisy(stiffness_N_per_m * pushed_m, 0.01, seed)
    (layer,) = replay(0.01 * np.arange(len(depth_m)), depth_m, force_N).layers
    error = abs(layer.stiffness_N_per_m - stiffness_N_per_m)

    assert error < 3.0 * layer.stiffness_std_N_per_m < 0.3 * stiffness_N_per_m


@pytest.mark.slow
def test_nothing_is_subtracted_before_the_first_rupture_is_reported():
    """A glove is met under the first gel: its friction is known before the rupture."""
    truth = insert_needle("stack-glove-constant", seed=0, rate_hz=250.0)
    t_s = truth.t_s[truth.t_s < truth.truth.rupture_s[0] + 3.0]
    force_N = truth.force_N[: len(t_s)]
    result = replay(t_s, truth.depth_m[: len(t_s)], force_N)
    before = t_s < result.layers[0].rupture.alarm_s - 0.01
    subtracted_N = force_N - [each.enhanced_force_N for each in result.estimates]

    # The zero of the force is learnt.
    assert np.abs(subtracted_N[before]).max() < 0.02


@pytest.mark.slow
def test_thin_layers_crossed_in_two_seconds_each_are_found_one_and_all():
    """Falls that follow one another are no heartbeat: each stays, and is a rupture."""
    thickness_m = 6e-3
    depth_m = 3e-3 * 4e-3 * np.arange(6_250) - 2e-3
    in_tissue_m = np.maximum(depth_m, 0.0)
    force_N = 60.0 * (in_tissue_m % thickness_m) + 1.7 * in_tissue_m
    _, estimates = run(rows_of(depth_m, 3e-3, noisy(force_N, 5e-3, 1), 4e-3))
    alarms_m = [rupture.depth_m for rupture in values_of(estimates, "rupture")]

    assert alarms_m == pytest.approx(thickness_m * np.arange(1, 13), abs=0.3e-3)


@pytest.mark.slow
def test_a_rough_layer_stays_uncertain_behind_a_smooth_one():
    places_m = np.arange(-5e-3, 50e-3, 1e-4)
    white = noisy(0.0 * places_m, 1.0, 2)
    texture_N = np.convolve(white, np.exp(-np.arange(30) / 10.0), "same")
    texture_N *= 0.06 / texture_N.std() * (places_m > 0.0) * (places_m < 14.5e-3)
    smooth = straight(seed=2)
    added_N = np.interp([row.depth_m for row in smooth], places_m, texture_N).tolist()
    identifier, estimates = run(
        row._replace(force_N=row.force_N + more_N)
        for row, more_N in zip(smooth, added_N, strict=True)
    )
    reports = values_of(estimates, "identified_layer")
    first = next(layer for layer in reports if layer.is_final)

    assert first.layer == 1
    assert identifier.layers[0].friction_std_N > 0.8 * first.friction_std_N


@pytest.mark.parametrize(
    ("released_N", "is_reported"), [(0.06, False), (0.08, False), (0.2, True)]
)
def test_a_rupture_releases_more_than_a_tenth_of_a_newton(released_N, is_reported):
    """Less is texture: the least rupture seen in real liver is 0.15 N."""
    depth_m = 4e-3 * 2e-3 * np.arange(3_000) - 4e-3
    fallen_N = released_N * np.clip((depth_m - 12e-3) / 0.2e-3, 0.0, 1.0)
    force_N = noisy(20.0 * np.maximum(depth_m, 0.0) - fallen_N, 2e-3, 0)
    _, estimates = run(rows_of(depth_m, 4e-3, force_N, 2e-3))

    assert bool(kept_ruptures(estimates)) == is_reported


@pytest.mark.parametrize("has_speed", [True, False])
def test_friction_that_falls_as_the_needle_brakes_is_no_rupture(has_speed):
    """The needle slows down from 4 to 1.5 mm/s; all of the force is viscous."""
    braking_s = 1e-3 * (np.arange(8_000) - 6_000)
    speed_m_s = np.clip(4e-3 - 20e-3 * braking_s, 1.5e-3, 4e-3)
    depth_m = 1e-3 * np.cumsum(speed_m_s) - 4e-3
    force_N = 50.0 * np.maximum(depth_m, 0.0) * (0.2 + 0.8 * speed_m_s / 4e-3)
    seen_m_s = speed_m_s if has_speed else None
    _, estimates = run(rows_of(depth_m, seen_m_s, noisy(force_N, 5e-3, 0), 1e-3))

    assert estimates[6_300].predicted_force_N < 0.6 * estimates[5_999].predicted_force_N
    assert values_of(estimates, "rupture") == []
