"""The mathematics of the mixture: time, events, a force, priors, noise."""

import numpy as np
import pytest

from foundation.records import as_record, from_record
from identification.mixture.block import Block
from identification.mixture.disturbances import driven, smooth_walk
from identification.mixture.evidence import weigh_evidence
from identification.mixture.force_model import (
    COLOURED_NOISE,
    FRICTION_BEFORE,
    FRICTION_LAST,
    HEARTBEAT,
    HELD,
    LAYER,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    MEMBRANE,
    MODEL_ERROR,
    MODEL_ERROR_MM,
    OFFSET,
    STIFFNESS,
    TRAVERSED_COULOMB,
    TRAVERSED_VISCOUS,
    UNKNOWNS,
    regressor,
)
from identification.mixture.kalman import update
from identification.mixture.layer_report import friction_of_layer
from identification.mixture.mixture import (
    CAPACITY,
    Mixture,
    MixtureMemory,
    correct,
    first_mixture,
    predict,
)
from identification.mixture.noise_levels import NoiseLevels, Texture
from identification.mixture.priors import (
    add_friction_prior,
    add_stiffness_prior,
    use_friction_fraction,
)
from identification.mixture.shaft_posterior import ShaftPosterior, update_posterior
from tests.identification.worlds import noisy

BLOCK = Block(
    time_s=3.0,
    duration_s=0.01,
    depth_mm=12.0,
    speed_mm_s=4.0,
    deflection=1.0,
    force_N=0.9,
    usual_speed_mm_s=4.0,
    noise_std_N=0.01,
    force_before_N=1.1,
)


def component(seed, medium=LAYER, *, holds_force=False):
    """A mixture of one component that has been in its layer for a while."""
    rng = np.random.default_rng(seed)
    factor = 0.05 * rng.standard_normal((UNKNOWNS, UNKNOWNS))
    means = 0.1 * np.abs(rng.standard_normal((1, UNKNOWNS)))
    mixture = first_mixture()
    place_mm = {"layer_start_mm": 4.0, "tip_start_mm": 5.0}
    assumed = {"medium": medium, "holds_force": holds_force} | place_mm
    if medium == LAYER:
        assumed |= {"release_start_mm": 5.0, "release_length_mm": 0.3, "ruptures": 1.0}
    else:
        means[0, [LAYER_COULOMB, LAYER_VISCOUS, STIFFNESS]] = 0.0
    for name, value in assumed.items():
        mixture.assumptions[name] = value
    return mixture._replace(means=means, covariances=(factor @ factor.T)[None])


def branch(mixture, travel_mm, reported, block=BLOCK):
    """The mixture with what may have happened over a travel before a block."""
    memory = MixtureMemory(mixture.state)
    memory.branch(block, block.depth_mm - travel_mm, 0.0, reported)
    return memory.mixture


def select(mixture, rows):
    """The components of some rows."""
    return Mixture(*(np.ascontiguousarray(array[rows]) for array in mixture.arrays))


def forces(mixture):
    """Force that each component predicts at `BLOCK`, shape (n,)."""
    rows = [regressor(each, BLOCK) for each in mixture.assumptions]
    return np.einsum("ni,ni->n", rows, mixture.means)


def ends(mixture):
    """Which components have just left the layer, and hold no force."""
    assumed = mixture.assumptions
    return (assumed["ruptures"] == 2.0) & (assumed["holds_force"] == 0.0)


def later(mixture, duration_s, travel_mm):
    """The mixture moved on by a time and a travel."""
    memory = MixtureMemory(mixture.state)
    predict(memory.store, 1, duration_s, travel_mm, 0.0, 1e-4, 2e-4, 3e-4, 4e-4)
    return memory.mixture


def test_two_steps_of_time_and_travel_are_one_and_disturbances_become_stationary():
    mixture = component(1)
    whole = later(mixture, 0.02, 0.08)
    halves = later(later(mixture, 0.01, 0.04), 0.01, 0.04)
    variances = np.diag(later(mixture, 60.0, 300.0).covariances[0])

    assert (whole.means, whole.covariances, whole.state[3]) == (
        pytest.approx(halves.means, abs=1e-12),
        pytest.approx(halves.covariances, abs=1e-12),
        pytest.approx(halves.state[3]),
    )
    assert variances[[COLOURED_NOISE, HEARTBEAT, MODEL_ERROR]] == pytest.approx(
        [1e-4, 2e-4, 4e-4]
    )


def learned(mixture, force_N):
    """The mixture after a force at `BLOCK`."""
    memory = MixtureMemory(mixture.state)
    correct(memory.store, 1, BLOCK._replace(force_N=force_N), 4e-4)
    return memory.mixture


def test_an_expected_force_teaches_as_kalman_says_and_a_surprise_costs_weight():
    mixture = component(2)
    row = regressor(mixture.assumptions[0], BLOCK)
    covariance = mixture.covariances[0]
    expected_N = float(forces(mixture)[0])
    after, surprised = (learned(mixture, expected_N + more) for more in (0.0, 1.0))
    cross_covariance = covariance @ row
    # Late in the layer nothing is being released, and no other noise comes on top.
    variance = row @ cross_covariance + 4e-4
    reduction = np.outer(cross_covariance, cross_covariance) / variance

    assert (after.means[0], after.covariances[0], after.log_weights[0]) == (
        pytest.approx(mixture.means[0]),
        pytest.approx(covariance - reduction),
        pytest.approx(-0.5 * 0.5 * np.log(variance)),
    )
    assert surprised.log_weights[0] < after.log_weights[0]
    assert row @ surprised.means[0] > expected_N


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("medium", "holds_force"), [(LAYER, False), (LAYER, True), (MEMBRANE, True)]
)
def test_the_force_goes_on_across_an_event(seed, medium, holds_force):
    parent = component(seed, medium, holds_force=holds_force)
    ruptures = parent.assumptions["ruptures"][0]
    children = select(branch(parent, 0.3, int(ruptures)), slice(1, None))

    assert 2 < children.size < CAPACITY
    assert forces(children) == pytest.approx(forces(parent)[0])
    assert set(children.assumptions["ruptures"] - ruptures) <= {0.0, 1.0}


def test_friction_of_a_layer_traversed_stays_on_the_shaft():
    parent = component(5)
    parent.means[0, HELD] = 0.0  # no cutting force, part of which may be friction
    mixture = branch(parent, 0.3, 1)
    is_end = ends(mixture)
    parts = parent.means[0, [LAYER_COULOMB, LAYER_VISCOUS]]
    friction_N = (BLOCK.depth_mm - 4.0) * (parts @ [1.0, BLOCK.speed_mm_s])
    likely = mixture._replace(log_weights=np.where(is_end, 0.0, -50.0))
    evidence = weigh_evidence(likely, None, 0)
    reported_N, _ = friction_of_layer(evidence, 2, 0.0, is_last=True)
    frictions_N = [*mixture.means[is_end, FRICTION_LAST], reported_N]

    assert set(mixture.history["rupture_force_N"][is_end]) == {BLOCK.force_before_N}
    assert np.array(frictions_N) == pytest.approx(friction_N)


@pytest.mark.parametrize(
    ("reported", "last", "before"), [(1, 0.16, 0.3), (0, 0.46, 0.5)]
)
def test_friction_of_an_unreported_rupture_counts_with_the_next(reported, last, before):
    # The component knows of one rupture, and has 8 mm of shaft in the layer.
    parent = component(5)
    frictions = [LAYER_COULOMB, LAYER_VISCOUS, FRICTION_LAST, FRICTION_BEFORE]
    parent.means[0, frictions] = 0.02, 0.0, 0.3, 0.5
    parent.means[0, HELD] = 0.0
    mixture = branch(parent, 0.1, reported)
    is_end = mixture.assumptions["release_start_mm"] == BLOCK.depth_mm
    found = mixture.means[is_end][:, [FRICTION_LAST, FRICTION_BEFORE]]

    assert set(mixture.assumptions["ruptures"][is_end]) == {reported + 1.0}
    assert np.allclose(found, [last, before])


def test_a_part_of_the_cutting_force_stays_on_the_shaft_as_friction():
    parent = component(5)
    parent.means[0, HELD] = 0.0
    without = branch(parent, 0.3, 1)
    parent.means[0, HELD] = 0.1
    mixture = branch(parent, 0.3, 1)
    travel_mm = BLOCK.depth_mm - parent.assumptions[0]["tip_start_mm"]
    on_shaft_N = 0.04 * (1.0 - np.exp(-travel_mm / 10.0))
    gained_N = (mixture.means - without.means)[ends(mixture)]
    doubt_N2 = (mixture.covariances - without.covariances)[ends(mixture)]

    assert gained_N[:, [TRAVERSED_COULOMB, FRICTION_LAST]] == pytest.approx(
        on_shaft_N, rel=1e-6
    )
    assert doubt_N2[:, TRAVERSED_COULOMB, TRAVERSED_COULOMB].min() > (
        (0.8 * on_shaft_N) ** 2
    )


def test_a_rupture_may_change_the_slow_error_of_torque_sensors():
    """By 0.05 N where it is 0.2 N: their hysteresis turns round as the force falls."""
    mixtures = [
        branch(component(5), 0.3, 1, BLOCK._replace(force_std_N=force_std_N))
        for force_std_N in (0.0, 0.2)
    ]
    before_N2, after_N2 = (
        mixture.covariances[ends(mixture), MODEL_ERROR, MODEL_ERROR]
        for mixture in mixtures
    )

    assert after_N2 - before_N2 == pytest.approx(0.05**2)


def test_hypotheses_that_differ_and_the_sensor_leave_friction_in_doubt():
    mixture = select(component(5), [0, 0])
    mixture.means[:, FRICTION_LAST] = 0.1, 0.5
    mixture.covariances[:] = 0.0
    evidence = weigh_evidence(mixture, None, 0)

    assert friction_of_layer(evidence, 1, 0.15**2, is_last=True) == pytest.approx(
        (0.3, np.hypot(0.2, 0.15))
    )


def known_of_two(first, second, *, layer_N=0.0, ruptures=1, reported=1):
    """What is known of two certain, equally likely hypotheses of friction and offset.

    Each knows of so many ruptures, and takes a part of its friction for that of its
    last layer.
    """
    mixture = select(component(5), [0, 0])
    mixture.means[:, [LAYER_COULOMB, LAYER_VISCOUS, HELD]] = 0.0
    on_shaft = [TRAVERSED_COULOMB, TRAVERSED_VISCOUS, OFFSET]
    mixture.means[:, on_shaft] = first, second
    mixture.means[:, FRICTION_LAST] = layer_N
    mixture.covariances[:] = 0.0
    mixture.assumptions["ruptures"] = ruptures
    record = as_record(ShaftPosterior())
    evidence = weigh_evidence(mixture, None, reported)
    update_posterior(record, evidence, BLOCK, reported, reported, 2.0)
    return from_record(ShaftPosterior, record)


def test_hypotheses_that_differ_leave_the_shaft_in_doubt():
    shaft = known_of_two((0.1, 0.01, 0.0), (0.5, 0.03, 0.0)).shaft
    drifted = known_of_two((0.1, 0.0, 0.06), (0.2, 0.0, -0.04))
    variances = shaft.coulomb_variance, shaft.viscous_variance, shaft.covariance
    offset = drifted.offset, drifted.offset_variance, drifted.shaft.offset_coulomb

    assert (shaft.coulomb, shaft.viscous) == pytest.approx((0.3, 0.02))
    assert variances == pytest.approx((0.2**2, 0.01**2, 0.2 * 0.01))
    assert offset == pytest.approx((0.01, 0.05**2, -0.05 * 0.05))


def test_friction_of_a_layer_counts_as_traversed_once_its_end_is_reported():
    before = known_of_two((0.1, 0.01, 0.0), (0.5, 0.03, 0.0), reported=0)
    partly = known_of_two((0.5, 0.0, 0.0), (0.5, 0.0, 0.0), layer_N=0.2, ruptures=2)

    none = before.traversed

    assert (none.coulomb, none.viscous, none.coulomb_variance) == (0.0, 0.0, 0.0)
    assert (
        before.shaft.coulomb,
        partly.traversed.coulomb,
        partly.shaft.coulomb,
    ) == pytest.approx((0.3, 0.3, 0.5))


@pytest.mark.parametrize(
    ("growth_N_per_mm", "prior_mm_s", "speed_mm_s", "fraction", "within"),
    [
        (0.01, 3.0, 3.0, 0.5, 0.02),
        (0.05, 3.0, 3.0, 0.5, 0.02),
        (0.27, 3.0, 3.0, 0.5, 0.02),
        (0.1, 1.0, 30.0, 0.15, 0.15),
    ],
)
def test_stiffness_is_as_uncertain_a_part_of_every_growth(
    growth_N_per_mm, prior_mm_s, speed_mm_s, fraction, within
):
    mean = np.zeros(UNKNOWNS)
    covariance = np.zeros((UNKNOWNS, UNKNOWNS))
    of_layer = [STIFFNESS, LAYER_COULOMB, LAYER_VISCOUS]
    add_stiffness_prior(mean, covariance, prior_mm_s)
    add_friction_prior(mean, covariance, prior_mm_s)
    row = np.zeros(UNKNOWNS)
    row[of_layer] = 1.0, 1.0, speed_mm_s
    cross_covariance = covariance @ row
    variance = row @ cross_covariance + (1e-3 * growth_N_per_mm) ** 2
    update(mean, covariance, cross_covariance, growth_N_per_mm - row @ mean, variance)

    assert use_friction_fraction(mean, covariance, speed_mm_s, prior_mm_s, False)
    assert mean[STIFFNESS] / growth_N_per_mm == pytest.approx(fraction, abs=within)
    assert (np.linalg.eigvalsh(covariance[np.ix_(of_layer, of_layer)]) > 0.0).all()
    if prior_mm_s == speed_mm_s:
        std = np.sqrt(covariance[STIFFNESS, STIFFNESS]) / growth_N_per_mm
        assert std == pytest.approx(0.2, abs=0.01)


def learn_levels(forces_N, duration_s=0.01, speed_mm_s=2.0):
    """Noise learnt from the forces of blocks, block by block."""
    levels = [NoiseLevels()]
    for force_N in forces_N.tolist():
        levels.append(levels[-1].with_force(force_N, duration_s, speed_mm_s))
    return levels[1:]


def test_noise_is_learned_part_by_part():
    beat_N = 0.05 * np.sin(2.0 * np.pi * 1.2 * 0.01 * np.arange(2000))
    levels = learn_levels(noisy(beat_N, 0.01, 9))[-1]
    has_motion = [
        each.variances.heartbeat > 0.0 or each.variances.breathing > 0.0
        for each in learn_levels(noisy(0.0 * beat_N, 0.01, 9))
    ]

    assert np.sqrt(levels.variances.white) == pytest.approx(0.01, rel=0.15)
    assert np.sqrt(levels.variances.coloured) < 0.008
    assert 0.02 < np.sqrt(levels.variances.heartbeat) < 0.08
    assert levels.restarted().with_force(1.0, 0.01, 2.0).differences.steps == 1.0
    assert np.mean(has_motion) < 0.1


def test_a_ramp_and_a_slow_bend_in_long_blocks_are_no_noise():
    ramp = learn_levels(0.001 * np.arange(2000))[-1]
    bend_N = noisy(0.5 * np.sin(2.0 * np.pi * 0.01 * np.arange(400)), 0.01, 9)
    # Blocks of a swing last about 0.1 s.
    bent = learn_levels(bend_N, 0.1, 3.0)[-1]

    assert np.sqrt(ramp.variances).max() < 1e-6
    assert 0.01 < bent.noise_std_N < 0.05


def texture_errors(forces_N, force_N=1.0, slow_std_N=0.0):
    """Error of the force model that texture shows, every 0.05 mm."""
    texture = Texture()
    errors_N = []
    for value_N in forces_N.tolist():
        texture = texture.with_force(value_N, 0.05)
        errors_N.append(texture.model_error(force_N, slow_std_N))
    return np.array(errors_N)


def test_texture_shows_an_error_but_no_noise_and_no_bend():
    rng = np.random.default_rng(2)
    white_N = 0.005 * rng.standard_normal(4000)
    travel_mm = 0.05 * np.arange(4000)
    step = driven(smooth_walk(0.05, MODEL_ERROR_MM), 1.0 / MODEL_ERROR_MM, 0.2**2)
    state = np.zeros(2)  # the error of the force model and its slope
    rough_N = np.empty(4000)
    for k in range(4000):
        state = step.transition @ state + rng.multivariate_normal((0, 0), step.noise)
        rough_N[k] = state[0]
    smooth = texture_errors(white_N + 0.03 * travel_mm + 1e-5 * travel_mm**2)
    rough = texture_errors(white_N + rough_N)

    # The first 50 mm show how little noise can hide.
    assert smooth[1000:].max() < 0.04
    assert rough.mean() == pytest.approx(0.2, rel=0.25)
    # A slow error of the sensor may be all that texture shows, and hides as much.
    assert texture_errors(white_N + rough_N, slow_std_N=0.3)[-1] < 0.1


def test_texture_that_noise_can_hide_counts():
    quiet_N = texture_errors(noisy(np.zeros(1000), 0.002, 3))[-1]
    loud_N = texture_errors(noisy(np.zeros(1000), 0.05, 3), slow_std_N=0.05)[-1]

    assert 5.0 * quiet_N < min(0.1, loud_N)


def test_texture_is_a_part_of_the_force():
    """Before it is known a fifth, at most half: friction is between none and all."""
    errors_N = [
        Texture().model_error(0.5, 0.0),
        Texture().model_error(2.0, 0.05),
        Texture(variance_N2=1e3, hidden_N2=0.0).model_error(0.8, 0.0),
    ]

    assert errors_N == pytest.approx([0.1, 0.4, 0.4])
