"""The mixture on forces made here.

Two layers, noise, the tissue's own motion, rests.
"""

from typing import NamedTuple

import numpy as np
import pytest

from groundtruth import insert_needle
from identification import (
    MIXTURE,
    Identifier,
    MixtureConfig,
    SampleStatus,
    replay,
)
from identification.config import CheckConfig
from identification.errors import InvalidConfigError
from identification.mixture import reporter
from identification.mixture.decisions import count_ruptures

SPEED_M_S = 4e-3

THICKNESS_M = (15e-3, 20e-3)
"""Of the two layers."""

STIFFNESS_N_PER_M = (20.0, 35.0)
"""Growth of the tip force in each."""

FRICTION_N_PER_M = (25.0, 40.0)
"""Shaft friction of each at `SPEED_M_S`, per length."""

RELEASE_M = 0.3e-3
"""Travel of a release."""

ABOVE_M = 4e-3
"""The needle begins so far above the tissue."""


class TrueForce(NamedTuple):
    """The force of the tissue at a depth [N]."""

    tip_N: float
    friction_N: float


def true_force(depth_m, sliding=1.0):
    """Tip force and friction at a depth, `sliding` as 1 when inwards at `SPEED_M_S`."""
    tip_N = 0.0
    friction_N = 0.0
    start_m = 0.0
    layers = zip(THICKNESS_M, STIFFNESS_N_PER_M, FRICTION_N_PER_M, strict=True)
    for thickness_m, stiffness_N_per_m, friction_N_per_m in layers:
        inside_m = depth_m - start_m
        if 0.0 < inside_m <= thickness_m:
            tip_N += stiffness_N_per_m * inside_m
        elif thickness_m < inside_m < thickness_m + RELEASE_M:
            remaining = 1.0 - (inside_m - thickness_m) / RELEASE_M
            tip_N += stiffness_N_per_m * thickness_m * remaining**2
        embedded_m = min(max(inside_m, 0.0), thickness_m)
        friction_N += sliding * friction_N_per_m * embedded_m
        start_m += thickness_m
    return TrueForce(tip_N, friction_N)


class Row(NamedTuple):
    """A sample as `Identifier.update` takes it."""

    depth_m: float
    speed_m_s: float | None
    force_N: float
    dt_s: float


def insertion(moves, seed=0, noise_N=5e-3, motion_m=None, jitter_m=0.0, sway=0.0):
    """Samples of moves, each a travel [m] and seconds, from above the tissue."""
    rng = np.random.default_rng(seed)
    depth_m = -ABOVE_M
    deepest_m = -ABOVE_M
    sliding = 1.0
    t_s = 0.0
    rows = []
    for travel_m, seconds in moves:
        n = round(1e3 * seconds)
        ramp = np.minimum(np.minimum(np.arange(n) + 1.0, n - np.arange(n)) / 100.0, 1.0)
        ramp *= 1.0 + sway * np.sin(2.0 * np.pi * 0.5e-3 * np.arange(n))
        for step_m in (travel_m * ramp / ramp.sum()).tolist():
            depth_m = depth_m + step_m
            t_s = t_s + 1e-3
            in_tissue_m = depth_m - (motion_m(t_s) if motion_m else 0.0)
            if step_m:
                limit = np.sign(step_m)
                remaining = np.exp(-abs(step_m) / 0.3e-3)
                sliding = limit + (sliding - limit) * remaining
            # Half of the friction is Coulomb's, half viscous.
            viscous = step_m / (1e-3 * SPEED_M_S)
            force = true_force(in_tissue_m, 0.5 * sliding + 0.5 * viscous)
            tip_N = force.tip_N if in_tissue_m >= deepest_m - 0.3e-3 else 0.0
            deepest_m = max(deepest_m, in_tissue_m)
            seen_m = depth_m + jitter_m * rng.standard_normal()
            force_N = tip_N + force.friction_N + noise_N * rng.standard_normal()
            rows.append(Row(float(seen_m), 1e3 * step_m, float(force_N), 1e-3))
    return rows


def straight(seed=0, **changes):
    """Samples of an insertion through both layers at `SPEED_M_S`."""
    return insertion([(46e-3, 46e-3 / SPEED_M_S)], seed, **changes)


def run(rows, identifier=None):
    """The identifier after the rows, and its estimates."""
    identifier = Identifier(MIXTURE) if identifier is None else identifier
    return identifier, [identifier.update(*row) for row in rows]


def values_of(estimates, name):
    """A field of all estimates where it is not None."""
    values = (getattr(estimate, name) for estimate in estimates)
    return [value for value in values if value is not None]


def rms(values):
    """The root of the mean square."""
    return np.sqrt(np.mean(np.square(values)))


def assert_both_found(identifier, estimates, *, within=0.2):
    """Both ruptures are reported, and the friction of both layers."""
    ruptures = values_of(estimates, "rupture")
    retracted = values_of(estimates, "retracted")
    assert len(ruptures) - len(retracted) == 2
    retracted_s = {rupture.alarm_s for rupture in retracted}
    kept = [rupture for rupture in ruptures if rupture.alarm_s not in retracted_s]
    ends_m = np.cumsum(THICKNESS_M)
    assert [rupture.depth_m for rupture in kept] == pytest.approx(ends_m, abs=0.3e-3)
    for layer, friction_N_per_m, thickness_m in zip(
        identifier.layers, FRICTION_N_PER_M, THICKNESS_M, strict=True
    ):
        friction_N = friction_N_per_m * thickness_m
        error_N = abs(layer.friction_N - friction_N)
        assert error_N < within * friction_N
        assert error_N < 3.0 * layer.friction_std_N + 0.03 * friction_N


@pytest.mark.slow
def test_a_provisional_alarm_comes_before_the_one_that_confirms_it():
    _, estimates = run(straight())

    provisional = values_of(estimates, "provisional")
    assert provisional
    for early in provisional:
        assert early.probability > MIXTURE.provisional_probability
        confirmed = [
            rupture
            for rupture in values_of(estimates, "rupture")
            if rupture.layer == early.layer
        ]
        assert 0.0 < confirmed[0].alarm_s - early.alarm_s < 0.1


@pytest.mark.parametrize(("most", "alarms"), [(0.975, 0), (0.985, 1)])
def test_an_alarm_is_raised_from_a_probability_of_98_percent_on(
    monkeypatch, most, alarms
):
    def count_doubtfully(*args):
        count = count_ruptures(*args)
        return count._replace(more=min(count.more, most))

    monkeypatch.setattr(reporter, "count_ruptures", count_doubtfully)
    _, estimates = run(straight()[:5200])

    assert len(values_of(estimates, "rupture")) == alarms


@pytest.mark.slow
def test_a_provisional_alarm_is_confirmed_or_retracted_but_not_both():
    config = MixtureConfig(provisional_probability=0.5)
    _, estimates = run(straight(seed=1), Identifier(config))

    is_open = False
    for estimate in estimates:
        if estimate.provisional is not None:
            assert not is_open
            is_open = True
        if estimate.provisional_retracted is not None:
            assert is_open
            assert estimate.rupture is None
            is_open = False
        if estimate.rupture is not None:
            is_open = False
    assert not is_open


@pytest.mark.slow
def test_two_layers_and_their_friction_are_found():
    identifier, estimates = run(straight())

    assert_both_found(identifier, estimates)

    first, second = values_of(estimates, "rupture")

    assert [first.layer, second.layer] == [1, 2]
    assert first.probability >= MIXTURE.alarm_probability
    assert not first.is_final
    assert first.contact_depth_m == pytest.approx(0.0, abs=0.5e-3)
    assert 0.0 < first.alarm_s - first.time_s < 0.06


@pytest.mark.slow
def test_each_layer_is_reported_provisionally_and_finally():
    _, estimates = run(straight())
    reports = [
        (layer.layer, layer.is_final, layer.rupture.is_final)
        for layer in values_of(estimates, "identified_layer")
    ]
    provisional_and_final = [(False, False), (True, True)]

    assert reports == [
        (number, *flags) for number in (1, 2) for flags in provisional_and_final
    ]


@pytest.mark.slow
def test_behind_the_layers_only_friction_remains():
    _, estimates = run(straight())
    last = estimates[-1]

    assert last.tip_force_N == pytest.approx(0.0, abs=0.1)
    assert last.enhanced_force_N == pytest.approx(0.0, abs=0.1)
    assert last.layer == 3


@pytest.mark.slow
def test_jitter_of_the_speed_says_nothing_of_friction():
    run = insert_needle("gel-70-sinusoidal", seed=1, rate_hz=100.0)
    jitter = np.random.default_rng(1).standard_normal((2, len(run.t_s)))
    depth_m = run.depth_m + 1e-5 * jitter[0]
    speed_m_s = run.speed_m_s + 1e-4 * jitter[1]
    estimates = replay(run.t_s, depth_m, run.force_N, speed_m_s).estimates
    is_behind = (run.t_s > run.truth.rupture_s[0] + 1.0) & (run.speed_m_s > 1e-4)
    enhanced_N = np.array([estimate.enhanced_force_N for estimate in estimates])

    assert run.force_N[is_behind].mean() > 0.9
    assert rms(enhanced_N[is_behind]) < 0.06


@pytest.mark.slow
def test_friction_at_changing_speed_is_no_texture():
    """The speed sways from 1 to 7 mm/s, and the friction with it by up to a newton."""
    stds_N = []
    for rows in (straight(), straight(sway=0.8)):
        _, estimates = run(rows)
        ruptures = values_of(estimates, "rupture")
        assert len(ruptures) == 2 + len(values_of(estimates, "retracted"))
        is_in_second = [20e-3 < row.depth_m < 33e-3 for row in rows]
        tip_stds_N = np.array(values_of(estimates, "tip_force_std_N"))
        stds_N.append(tip_stds_N[is_in_second].mean())

    assert stds_N[1] < 2.0 * stds_N[0]


def pushed_tip_N(force_std_N, faster_m_s):
    """By how much the tip force rises where the force does by a newton for 30 ms."""
    rows = straight()
    identifier, estimates = run(rows[:3000])
    estimate = estimates[-1]
    for row in rows[3000:3030]:
        progress = (row.depth_m - rows[3000].depth_m) / row.speed_m_s
        estimate = identifier.update(
            row.depth_m,
            row.speed_m_s + faster_m_s * progress,
            row.force_N + 1.0,
            row.dt_s,
            force_std_N=force_std_N,
        )
    return estimate.tip_force_N - estimates[-1].tip_force_N


@pytest.mark.slow
def test_an_uncertain_force_counts_less_during_acceleration():
    assert pushed_tip_N(force_std_N=0.0, faster_m_s=0.2) > 0.5
    assert pushed_tip_N(force_std_N=1.0, faster_m_s=0.0) > 0.5
    assert abs(pushed_tip_N(force_std_N=1.0, faster_m_s=0.2)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_forces_are_within_their_deviations(seed):
    rows = straight(seed)
    _, estimates = run(rows)
    truths = [true_force(row.depth_m) for row in rows[6000:]]
    tips_N = [force.tip_N for force in truths]
    frictions_N = [force.friction_N for force in truths]
    for name, truth_N in (("tip_force", tips_N), ("shaft_friction", frictions_N)):
        force_N = np.array(values_of(estimates[6000:], f"{name}_N"))
        std_N = np.array(values_of(estimates[6000:], f"{name}_std_N"))
        assert np.mean(np.abs(force_N - truth_N) < 2.0 * std_N + 5e-3) > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_friction_is_well_known_before_braking(seed):
    """One speed does not show how much of the friction stays at rest."""
    _, estimates = run(straight(seed))
    estimate = estimates[-200]

    assert estimate.shaft_friction_std_N < 0.1 * estimate.shaft_friction_N


@pytest.mark.slow
def test_the_tissue_may_beat():
    rows = straight(3, motion_m=lambda t_s: 0.2e-3 * np.sin(2.0 * np.pi * 1.2 * t_s))
    identifier, estimates = run(rows)
    ruptures = values_of(estimates, "rupture")

    assert len(ruptures) - len(values_of(estimates, "retracted")) == 2
    assert len(identifier.layers) == 2


@pytest.mark.slow
@pytest.mark.parametrize("has_speed", [True, False])
def test_noise_of_the_position_hides_no_ruptures(has_speed):
    # Without the stop at the end, which a speed estimated from such depths shows late.
    rows = straight(4, jitter_m=1e-4)[:-250]
    if not has_speed:
        rows = [row._replace(speed_m_s=None) for row in rows]

    assert_both_found(*run(rows), within=0.3)


@pytest.mark.slow
def test_rests_and_reversals_are_no_ruptures():
    inwards = [(12e-3, 3.0), (0.0, 1.5), (6e-3, 1.5), (0.0, 1.0)]
    back_and_on = [(-3e-3, 0.75), (3e-3, 0.75), (28e-3, 7.0)]
    identifier, estimates = run(insertion([*inwards, *back_and_on], seed=5))

    assert_both_found(identifier, estimates, within=0.3)


def test_friction_may_let_go_at_rest():
    _, estimates = run(insertion([(12e-3, 3.0), (0.0, 1.5)], seed=5))
    moving = estimates[3100]
    resting = estimates[4400]

    assert resting.shaft_friction_N < 0.95 * moving.shaft_friction_N

    error_N = abs(resting.shaft_friction_N - 0.1)

    assert error_N < 2.0 * resting.shaft_friction_std_N


@pytest.fixture(scope="module")
def withdrawal():
    """Rows and estimates of a needle drawn out through both layers, and layers."""
    rows = insertion([(40e-3, 10.0), (-44e-3, 8.0)], seed=6)
    identifier, estimates = run(rows)
    pairs = zip(estimates, rows, strict=True)
    outwards = [pair for pair in pairs if pair[1].speed_m_s < 0.0][1000:]
    return outwards, identifier.layers


def test_withdrawal_meets_friction_only(withdrawal):
    outwards, layers = withdrawal
    estimates = [estimate for estimate, _ in outwards]

    assert len(layers) == 2
    assert all(layer.is_final for layer in layers)
    assert values_of(estimates, "rupture") == []
    assert {estimate.tip_force_N for estimate in estimates[:3000]} == {0.0}

    errors_N = [row.force_N - estimate.predicted_force_N for estimate, row in outwards]

    assert rms(errors_N) < 0.1
    assert rms([estimate.enhanced_force_N for estimate in estimates[:5000]]) < 0.15


def test_behind_the_withdrawal_nothing_acts(withdrawal):
    outwards, _ = withdrawal
    last, _ = outwards[-1]

    assert last.shaft_friction_N == 0.0
    assert abs(last.tip_force_N) < 0.05


@pytest.mark.parametrize(("depth_m", "layer"), [(30e-3, 2), (10e-3, 1), (-2e-3, 0)])
def test_withdrawal_passes_the_layers_backwards(withdrawal, depth_m, layer):
    outwards, _ = withdrawal
    near = [
        estimate.layer
        for estimate, row in outwards
        if abs(row.depth_m - depth_m) < 1e-3
    ]

    assert set(near) == {layer}


def test_a_gap_in_time_is_no_rupture():
    rows = straight(9)
    late = rows[3200:4000]
    identifier, _ = run(rows[:2500])
    first = identifier.update(*late[0]._replace(dt_s=0.701))

    assert first.status is SampleStatus.TIME_GAP

    _, estimates = run(late[1:], identifier)

    assert values_of(estimates, "rupture") == []


@pytest.mark.parametrize(("gap_s", "is_gap"), [(0.25, True), (1.0, False)])
def test_the_configured_gap_is_that_of_the_method(gap_s, is_gap):
    """Where half a second is a gap, no difference of the force reaches across it."""
    config = MixtureConfig(check=CheckConfig(gap_s=gap_s))
    rows = straight(9)
    identifier, _ = run(rows[:2500], Identifier(config))
    for row in rows[2500:2520]:  # to the end of a block
        identifier.update(*row)
        if identifier.snapshot().state.contact.block_s == 0.0:
            break
    steps = identifier.snapshot().state.learner.levels.differences.steps
    estimate = identifier.update(*rows[3100]._replace(dt_s=0.5))
    state = identifier.snapshot().state

    assert estimate.status is (SampleStatus.TIME_GAP if is_gap else SampleStatus.OK)
    assert state.learner.levels.differences.steps == (0.0 if is_gap else steps + 1.0)


@pytest.mark.slow
@pytest.mark.parametrize("rate_hz", [1000, 50, 20])
def test_noise_of_the_force_is_known_at_any_rate(rate_hz):
    stride = 1000 // rate_hz
    slow = insertion([(46e-3, 23.0)], seed=8, noise_N=0.02)
    rows = [row._replace(dt_s=1e-3 * stride) for row in slow[::stride]]
    identifier, _ = run(rows)
    levels = identifier.snapshot().state.learner.levels
    samples = max(round(0.01 * rate_hz), 1)

    assert levels.variances.white == pytest.approx(0.02**2 / samples, rel=0.5)
    assert levels.differences.step == pytest.approx(samples / rate_hz)
    assert levels.variances.heartbeat < 2e-3
    assert levels.variances.breathing < 2e-3


@pytest.mark.parametrize("probability", [0.3, 1.0, np.nan, -1.0])
def test_a_probability_of_an_alarm_must_be_one(probability):
    with pytest.raises(InvalidConfigError, match="alarm_probability"):
        MixtureConfig(alarm_probability=probability)


@pytest.mark.parametrize("stiffness_N_per_m", [150.0, 250.0])
@pytest.mark.parametrize("seed", [1, 2])
def test_stiffness_of_a_membrane_met_in_air_is_reported(stiffness_N_per_m, seed):
    depth_m = np.arange(0.0, 20e-3, 5e-5)
    pushed_m = np.where(depth_m < 12e-3, np.maximum(depth_m - 5e-3, 0.0), 0.0)
    noise_N = 0.01 * np.random.default_rng(seed).standard_normal(len(depth_m))
    force_N = stiffness_N_per_m * pushed_m + noise_N
    (layer,) = replay(0.01 * np.arange(len(depth_m)), depth_m, force_N).layers

    error = layer.stiffness_N_per_m - stiffness_N_per_m
    assert 0.0 < layer.stiffness_std_N_per_m < 0.1 * stiffness_N_per_m
    assert abs(error) < 3.0 * layer.stiffness_std_N_per_m


def test_a_provisional_alarm_cannot_ask_for_more_than_an_alarm():
    with pytest.raises(InvalidConfigError, match="provisional_probability"):
        MixtureConfig(alarm_probability=0.9, provisional_probability=0.95)


@pytest.mark.parametrize("zero_m", [-0.105, 0.0, 1.0])
def test_the_first_layer_is_split_alike_wherever_depth_has_its_zero(zero_m):
    truth = insert_needle("gel-25-constant", seed=1000, rate_hz=250.0)
    result = replay(truth.t_s, truth.depth_m + zero_m, truth.force_N)
    contact_s = truth.truth.contact_s
    rupture_s = truth.truth.ruptures[0].onset_s
    is_first_layer = (truth.t_s > contact_s) & (truth.t_s < rupture_s)
    tip_N = np.array([estimate.tip_force_N for estimate in result.estimates])
    std_N = np.array([estimate.tip_force_std_N for estimate in result.estimates])
    error_N = np.abs(tip_N - truth.truth.tip_N)[is_first_layer]

    assert np.mean(error_N < 2.0 * std_N[is_first_layer]) > 0.95
    assert error_N.max() < 0.1


def test_nothing_is_subtracted_before_the_first_rupture_is_reported():
    """A glove is met under the first gel: its friction is known before the rupture."""
    truth = insert_needle("stack-glove-constant", seed=0, rate_hz=250.0)
    result = replay(truth.t_s, truth.depth_m, truth.force_N)
    first_s = result.layers[0].rupture.alarm_s
    before = truth.t_s < first_s - 0.01
    enhanced_N = np.array([each.enhanced_force_N for each in result.estimates])
    difference_N = (enhanced_N - truth.force_N)[before]

    assert np.abs(difference_N).max() < 0.02  # the zero of the force is learnt


@pytest.mark.slow
def test_thin_layers_crossed_in_two_seconds_each_are_found_one_and_all():
    """Falls that follow one another are no heartbeat: each stays, and is a rupture."""
    speed_m_s = 3e-3
    thickness_m = 6e-3
    identifier = Identifier()
    noise_N = np.random.default_rng(1).normal(0.0, 5e-3, 25_000)
    alarms_m = []
    for tick, error_N in enumerate(noise_N):
        depth_m = speed_m_s * 1e-3 * tick - 2e-3
        in_tissue_m = max(depth_m, 0.0)
        tip_N = 60.0 * (in_tissue_m % thickness_m)
        friction_N = 1.7 * in_tissue_m
        force_N = tip_N + friction_N + error_N
        estimate = identifier.update(depth_m, speed_m_s, force_N, 1e-3)
        if estimate.rupture is not None:
            alarms_m.append(estimate.rupture.depth_m)

    boundaries_m = thickness_m * np.arange(1, 13)
    assert alarms_m == pytest.approx(boundaries_m, abs=0.3e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_rupture_in_the_midst_of_a_block_does_not_wait_for_its_end(seed):
    """A block of 10 ms ends at once where its force falls short of what is expected."""
    _, estimates = run(straight(seed))

    ends_m = np.cumsum(THICKNESS_M)
    depths_m = [rupture.alarm_depth_m for rupture in values_of(estimates, "rupture")]
    delays_s = (np.array(depths_m) - ends_m) / SPEED_M_S
    assert np.all(delays_s < 0.018)


def test_a_needle_drawn_out_of_the_tissue_is_in_free_air():
    rows = insertion([(46e-3, 11.5), (-50e-3, 12.0)], seed=1)
    _, estimates = run(rows)
    deepest = int(np.argmax([row.depth_m for row in rows]))
    on_the_way_out = list(zip(rows[deepest:], estimates[deepest:], strict=True))

    assert all(e.in_contact for row, e in on_the_way_out if row.depth_m > 0.0)
    assert not any(e.in_contact for row, e in on_the_way_out if row.depth_m < -2.5e-3)
