"""What the force at a stop says of tip force and friction."""

import numpy as np
import pytest

from foundation.records import as_record
from identification import replay
from identification.mixture.block import Block
from identification.mixture.force_split import estimate_sample
from identification.mixture.needle_contact import NeedleContact
from identification.mixture.needle_stop import NeedleStop, Retention, meet_stop
from identification.mixture.shaft_posterior import (
    Friction,
    ShaftPosterior,
    update_stop,
)

NO_LAYERS = np.zeros((0, 4))
TIP = 4
TIP_STD = 5
SHAFT = 6


def stopped_posterior() -> ShaftPosterior:
    """Return 1 N of friction, half of it viscous, and 1 N at the tip, at 3 mm/s."""
    return ShaftPosterior(
        in_contact=True,
        depth_mm=20.0,
        noise_variance=1e-4,
        tip_force=1.0,
        shaft=Friction(coulomb=0.5, viscous=0.5 / 3.0, coulomb_variance=0.01),
        stop=NeedleStop(
            speed_mm_s=3.0,
            depth_mm=20.0,
            force=2.0,
            friction=1.0,
            friction_variance=0.01,
            kept_friction=0.5,
            kept_friction_variance=0.1,
            kept_tip=0.95,
            kept_tip_variance=0.02,
        ),
    )


def split_at_rest(posterior: ShaftPosterior, force: float) -> tuple[float, ...]:
    """Return what is reported of a needle that has just come to rest."""
    contact = NeedleContact(deflection=1.0, deepest_m=0.02)
    return estimate_sample(
        as_record(posterior), as_record(contact), NO_LAYERS, 0.02, 0.0, force
    )


def test_a_force_that_stays_at_a_stop_leaves_the_friction_on_the_shaft():
    outputs = split_at_rest(stopped_posterior(), 1.98)

    assert outputs[TIP] == pytest.approx(1.0, abs=0.15)
    assert outputs[SHAFT] == pytest.approx(1.0, abs=0.15)
    assert 0.05 < outputs[TIP_STD] < 0.3


def test_a_fall_at_a_stop_is_friction_rather_than_tip_force():
    fallen_N = 0.5
    outputs = split_at_rest(stopped_posterior(), 2.0 - fallen_N)

    assert 0.8 < outputs[TIP] < 1.0
    assert outputs[SHAFT] < 0.7


@pytest.mark.parametrize("speed_m_s", [2.7e-3, 2.9e-3])
def test_the_tip_force_does_not_jump_where_the_needle_begins_to_brake(speed_m_s):
    posterior = stopped_posterior()
    contact = NeedleContact(deflection=1.0, deepest_m=0.02)
    state = as_record(posterior), as_record(contact), NO_LAYERS, 0.02
    steady = estimate_sample(*state, 3e-3, 2.0)
    braking = estimate_sample(*state, speed_m_s, 2.0)

    assert abs(braking[TIP] - steady[TIP]) < 2.0 * steady[TIP_STD]


def test_what_a_stop_has_shown_is_expected_at_the_next():
    posterior = stopped_posterior()
    at_rest = Block(duration_s=0.2, depth_mm=20.0, deflection=1.0, force_N=1.98)
    for _ in range(3):
        update_stop(posterior, at_rest)
    advancing = Block(
        duration_s=0.01, depth_mm=25.0, speed_mm_s=3.0, deflection=1.0, force_N=2.1
    )
    update_stop(posterior, advancing)
    stop = posterior.stop

    assert stop.depth_mm == 25.0
    assert stop.kept_friction > 0.7
    assert stop.kept_friction_variance < 0.05


def test_a_second_stop_shows_anew_what_friction_keeps():
    """The first keeps nearly all of it, the second little more than half."""
    posterior = stopped_posterior()
    kept = []
    for depth_mm, at_rest_N in ((20.0, 1.98), (25.0, 1.2)):
        at_rest = Block(
            duration_s=0.2, depth_mm=depth_mm, deflection=1.0, force_N=at_rest_N
        )
        for _ in range(3):
            update_stop(posterior, at_rest)
        advancing = Block(
            duration_s=0.01,
            depth_mm=depth_mm + 5.0,
            speed_mm_s=3.0,
            deflection=1.0,
            force_N=2.1,
        )
        update_stop(posterior, advancing)
        kept.append(posterior.stop.kept_friction)

    assert kept[0] > 0.75
    assert kept[1] < 0.65


@pytest.mark.slow
def test_coulomb_friction_stays_on_the_shaft_at_a_stop():
    """Coulomb friction of 20 N/m and a constant tip force, stopped at 40 mm."""
    t_s = np.arange(0.0, 20.0, 1e-3)
    depth_m = np.clip(3e-3 * (t_s - 2.0), 0.0, 40e-3)
    in_tissue_m = np.maximum(depth_m - 5e-3, 0.0)
    tip_N = 0.5 * (1.0 - np.exp(-in_tissue_m / 1e-3))
    friction_N = 20.0 * in_tissue_m
    noise_N = np.random.default_rng(5).normal(0.0, 5e-3, len(t_s))
    estimates = replay(t_s, depth_m, tip_N + friction_N + noise_N).estimates
    rest = [item for item in estimates if item.time_s > 17.0]
    error_N = np.array([item.tip_force_N for item in rest]) - tip_N[-1]
    std_N = np.array([item.tip_force_std_N for item in rest], dtype=float)

    assert np.mean(np.abs(error_N) <= 2.0 * std_N) > 0.95


def test_friction_at_rest_is_that_of_weighed_draws():
    """Draws of friction and of what remains, weighed by how well they fit the force."""
    rng = np.random.default_rng(0)
    friction_N = rng.normal(1.0, 0.12, 200_000)
    kept_friction = rng.normal(0.5, 0.1, 200_000)
    kept_tip = rng.normal(0.95, 0.05, 200_000)
    at_rest_N = kept_friction * friction_N
    missed_N = 1.5 - at_rest_N - kept_tip * (2.0 - friction_N)
    weights = np.exp(-0.5 * (missed_N / 0.05) ** 2)
    mean_N = np.average(at_rest_N, weights=weights)
    variance_N2 = np.average((at_rest_N - mean_N) ** 2, weights=weights)
    stop = NeedleStop(force=2.0, friction=1.0, friction_variance=0.12**2)
    before = Retention(0.5, 0.95, 0.1**2, 0.05**2, 0.0)
    met = meet_stop(stop, before, 1.5, 0.05**2)

    assert met.friction == pytest.approx(mean_N, abs=0.01)
    assert np.sqrt(met.variance) == pytest.approx(np.sqrt(variance_N2), rel=0.05)


@pytest.mark.parametrize("model_error_N", [0.03, 0.1, 0.3])
@pytest.mark.parametrize("at_rest_N", [0.45, 0.48, 0.5])
def test_a_tip_without_force_has_a_deviation_that_covers_it(model_error_N, at_rest_N):
    """All of the force is friction, and the stop shows it better than the model."""
    posterior = ShaftPosterior(
        in_contact=True,
        depth_mm=20.0,
        noise_variance=1e-6,
        model_error_variance=model_error_N**2,
        shaft=Friction(coulomb=0.5, viscous=0.5 / 3.0, coulomb_variance=0.01),
        stop=NeedleStop(
            speed_mm_s=3.0,
            depth_mm=20.0,
            force=1.0,
            friction=1.0,
            friction_variance=1e-4,
            kept_friction=0.5,
            kept_friction_variance=1e-3,
            kept_tip=0.95,
            kept_tip_variance=0.02,
        ),
    )
    outputs = split_at_rest(posterior, at_rest_N)

    assert outputs[TIP_STD] > 1e-3
    assert 0.0 <= outputs[TIP] <= 2.0 * outputs[TIP_STD]
    assert abs(outputs[SHAFT] - at_rest_N) <= 2.0 * outputs[TIP_STD]
