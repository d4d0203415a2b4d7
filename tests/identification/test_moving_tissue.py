"""Tissue that moves with heart and breath, or faster than the needle."""

from dataclasses import replace

import numpy as np
import pytest

from groundtruth import TissueMotion as TrueMotion
from groundtruth import Wave, constant_motion, insert_needle, random_stack, scenario
from identification import Identifier, SampleStatus, TissueWarning, replay
from identification.mixture.block import Block
from identification.mixture.motion_fit import Fit, displacement, turned
from identification.mixture.tissue_doubt import TissuePull
from tests.identification.worlds import (
    follow,
    kept_ruptures,
    noisy,
    rows_of,
    run,
    samples_of,
    straight,
    values_of,
)

HEART = ((0.2e-3, 1.3, 0.4), (0.08e-3, 2.6, 1.0))
BREATH = ((1.2e-3, 0.28, 2.0), (0.3e-3, 0.56, 0.5))
BEATS = np.array([[0.3, 1.0, -0.5, 0.2, 0.1], [1.2, 0.2, 0.1, -0.1, 0.05]])


def moving(waves, name="gel-25-constant", seed=5):
    """An insertion of the simulator into tissue that moves."""
    motion = TrueMotion(waves=waves) if waves else None
    chosen = replace(scenario(name, 0), tissue_motion=motion)
    return insert_needle(chosen, seed=seed, rate_hz=250.0)


def test_speed_is_the_rate_of_the_place_whenever_phases_begin():
    times_s = np.linspace(0.0, 5.0, 50_001)
    place_mm, speed_mm_s = displacement(BEATS, times_s)
    beats = turned(Fit(BEATS, 0.0), 1.7).beats
    rate_mm_s = np.gradient(place_mm, times_s)

    assert np.allclose(rate_mm_s[1:-1], speed_mm_s[1:-1], atol=1e-5)
    assert np.allclose(displacement(beats, times_s - 1.7)[0], place_mm)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("waves", "hz"), [(HEART, 1.3), (BREATH, 0.28), (HEART + BREATH, 0.28)]
)
def test_motion_and_ruptures_are_found_in_tissue_that_moves(waves, hz):
    simulated = moving(waves)
    rupture_s = simulated.truth.ruptures[0].onset_s
    _, samples = samples_of(simulated)
    cut = sum(time_s < rupture_s for *_, time_s in samples)
    identifier, before = run(samples[:cut])
    fit = identifier.snapshot().state.learner.tissue.fit
    _, after = run(samples[cut:], identifier)
    times_s = np.linspace(0.0, 1.0 / hz, 50)
    place_mm, _ = displacement(fit.beats, times_s)
    begin_s = samples[0][-1] - 1e-3 + fit.at_s
    true_mm = 1e3 * TrueMotion(waves=waves).at(begin_s + times_s)[0]
    late_s = [r.alarm_s - rupture_s for r in values_of(before + after, "rupture")]
    (near_s,) = (delay_s for delay_s in late_s if abs(delay_s) < 3.0)

    assert fit.beats[0, 0] == pytest.approx(hz, abs=0.01)
    assert np.std(place_mm - true_mm) < 0.3 * np.std(place_mm)
    assert len(late_s) <= 4  # not one at every beat
    assert 0.0 < near_s < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gel-25-constant", "abdomen-sinusoidal"])
def test_tissue_at_rest_stays_at_rest(name):
    identifier, estimates, _ = follow(moving((), name))

    assert not identifier.snapshot().state.learner.tissue.is_known
    assert not any(estimate.warnings for estimate in estimates)


@pytest.mark.slow
@pytest.mark.parametrize("end_s", [99.0, 6.0])
def test_a_heartbeat_and_one_that_ends_hide_no_rupture(end_s):
    def beat_m(t_s):
        return 0.2e-3 * np.sin(2.0 * np.pi * 1.2 * min(t_s, end_s))

    identifier, estimates = run(straight(3, motion_m=beat_m))

    assert len(kept_ruptures(estimates)) == len(identifier.layers) == 2


@pytest.mark.slow
def test_an_insertion_resumes_in_moving_tissue():
    _, rows = samples_of(moving(HEART, seed=7))
    first, _ = run(rows[:4_000])
    second = Identifier()
    second.restore(first.snapshot())

    assert first.snapshot().state.learner.tissue.is_known
    later = rows[4_000:4_500]
    assert run(later, second)[1] == run(later, first)[1]


@pytest.mark.slow
def test_tissue_that_draws_back_beyond_the_tip_ends_the_search_for_its_motion():
    """The window of the search empties while a part of its work is still due."""
    waves = (Wave(10.4e-3, 0.2212, 3.795), Wave(3.754e-3, 0.4424, 1.3926))
    breathing = moving(waves, seed=105)
    columns = (breathing.t_s, breathing.depth_m, breathing.force_N, breathing.speed_m_s)

    assert replay(*columns).estimates[-1].status is SampleStatus.OK


@pytest.mark.parametrize("dt_s", [0.1, 0.2, 0.24])
def test_a_log_too_slow_for_a_heartbeat_is_identified(dt_s):
    t_s = np.arange(0.0, 40.0, dt_s)
    depth_m = 1e-3 * t_s - 3e-3
    breath_N = 0.2 * np.sin(2.0 * np.pi * 0.25 * t_s) * (depth_m > 0.0)
    force_N = noisy(30.0 * np.maximum(depth_m, 0.0) + breath_N, 5e-3, 1)
    _, estimates = run(rows_of(depth_m, 1e-3, force_N, dt_s))

    assert estimates[-1].status is SampleStatus.OK


@pytest.mark.parametrize("force_N", [0.0, 190.0, -190.0])
@pytest.mark.parametrize("speed_m_s", [0.0, 1e-3, 0.9])
def test_absurd_forces_and_speeds_leave_every_number_finite(force_N, speed_m_s):
    k = np.arange(400)
    forces_N = np.where(k % 7, force_N, -force_N)
    _, estimates = run(rows_of(0.05 * k * speed_m_s, speed_m_s, forces_N, 0.05))

    assert np.isfinite([v for e in estimates for v in e if isinstance(v, float)]).all()


def breathing(breath_m, hz, speed_m_s, seed):
    """An insertion into a stack that breathes by so much from peak to peak."""
    stack = random_stack(np.random.default_rng(seed))
    depth_m = min(sum(layer.thickness_m for layer in stack.layers) + 5e-3, 40e-3)
    motion = constant_motion(
        speed_m_s=speed_m_s, depth_m=depth_m, standoff_m=5e-3 + breath_m
    )
    tissue_motion = TrueMotion(waves=(Wave(0.5 * breath_m, hz, 1.0),))
    chosen = replace(stack, motion=motion, tissue_motion=tissue_motion)
    simulated = insert_needle(chosen, seed=seed, rate_hz=250.0)
    return *follow(simulated), simulated


@pytest.mark.parametrize(
    ("breath_m", "hz", "speed_m_s", "seed"),
    [(7e-3, 0.25, 2e-3, 2), (15e-3, 0.22, 3e-3, 7)],
)
def test_in_tissue_that_breathes_freely_nothing_is_stated_as_known(
    breath_m, hz, speed_m_s, seed
):
    identifier, estimates, rows, simulated = breathing(breath_m, hz, speed_m_s, seed)
    # The pull of the tissue is friction of the whole shaft, less what acts otherwise.
    friction_N = -simulated.truth.axial_N[rows].min()
    last = estimates[-1]
    known = {
        name: {getattr(layer, name) for layer in identifier.layers}
        for name in ("is_final", "friction_identified", "stiffness_identified")
    }

    assert TissueWarning.TISSUE_MOVES in last.warnings
    assert not last.friction_identified
    assert last.shaft_friction_std_N > 0.5 * friction_N
    assert not any(True in values for values in known.values())
    assert all(e.friction_std_N > 0.3 * friction_N for e in identifier.layers)


def pulled(*stretches, amplitude_mm=0.0, breathing_N=0.0, is_sliding=True):
    """Tissue after stretches of a force [N] and its seconds; the needle advances."""
    pull = TissuePull(is_met=True)
    forces_N = [n for force_N, s in stretches for n in [force_N] * round(s / 0.05)]
    for k, force_N in enumerate(forces_N, 1):
        block = Block(time_s=0.05 * k, duration_s=0.05, force_N=force_N)
        pull = pull.with_force(
            block, 1e-4, amplitude_mm, breathing_N**2, is_sliding=is_sliding
        )
    return pull, pull.is_moving(0.05 * len(forces_N))


@pytest.mark.parametrize(
    ("stretches", "settings", "is_moving"),
    [
        ([(0.5, 2.0), (-0.5, 0.3)], {}, True),
        ([(0.5, 2.0), (-0.5, 0.1)], {}, False),
        ([(0.5, 2.0), (-0.05, 5.0)], {}, False),  # the inertia of a needle pulls so
        (5 * [(-0.5, 0.1), (0.5, 1.0)], {}, False),  # friction that turns again
        ([(-0.5, 0.3), (0.5, 14.0)], {}, True),  # as long as two breaths later
        ([(-0.5, 0.3), (0.5, 16.0)], {}, False),
        ([(-0.5, 2.0)], {"is_sliding": False}, False),  # held, not pulled
        ([(0.5, 1.0)], {"amplitude_mm": 1.5}, False),  # it is followed
        ([(0.5, 1.0)], {"amplitude_mm": 3.0}, True),
        ([(1.0, 5.0)], {"breathing_N": 0.35}, True),
        ([(1.0, 3.0)], {"breathing_N": 0.35}, False),  # a layer that begins bends it
        ([(1.0, 5.0)], {"breathing_N": 0.1}, False),  # texture, the noise of an arm
        ([(0.2, 5.0)], {"breathing_N": 0.08}, False),  # of little force a large part
    ],
)
def test_when_tissue_counts_as_moving(stretches, settings, is_moving):
    assert pulled(*stretches, **settings)[1] == is_moving


def test_friction_is_known_no_better_than_half_the_swing_of_this_breath():
    doubt_N, drawn_back_N, never_N = (
        pulled(*stretches)[0].doubt_N
        for stretches in (
            [(0.8, 1.0), (-0.4, 1.0)],
            [(-5.0, 0.1), (0.5, 75.0), (-0.5, 1.0)],
            [(0.5, 75.0), (-0.5, 1.0)],
        )
    )

    assert (doubt_N, drawn_back_N) == pytest.approx((0.6, never_N), rel=0.1)
