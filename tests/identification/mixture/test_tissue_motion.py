"""Motion of the tissue found in the force, and ruptures found in tissue that moves."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from groundtruth import insert_needle, scenario
from groundtruth.scenarios import TissueMotion as TrueMotion
from groundtruth.scenarios import Wave
from identification import MIXTURE, Identifier, SampleStatus, replay
from identification.mixture.block import Block
from identification.mixture.motion_fit import Fit, displacement, turned
from identification.mixture.needle_contact import contact_along
from identification.mixture.tissue_motion import TissueMotion

HEART = ((0.2e-3, 1.3, 0.4), (0.08e-3, 2.6, 1.0))
BREATH = ((1.2e-3, 0.28, 2.0), (0.3e-3, 0.56, 0.5))
CLOCK_S = -25.0


class Insertion(NamedTuple):
    """An insertion in tissue that moves: its run, estimates, and the motions in use."""

    run: Any
    estimates: list
    motions: list


def insertion(waves, name="gel-25-constant", seed=5):
    """An insertion and what is made of it.

    The caller's clock begins below zero; that of the motion is the time since the first
    sample.
    """
    motion = TrueMotion(waves=waves) if waves else None
    run = insert_needle(replace(scenario(name, 0), tissue_motion=motion), seed=seed)
    estimates = []
    motions = []
    identifier = Identifier()
    end_s = run.scenario.motion.withdrawal_start_s
    times_s = run.t_s.tolist()
    columns = (run.depth_m.tolist(), run.speed_m_s.tolist(), run.force_N.tolist())
    for k, sample in enumerate(zip(*columns, strict=True)):
        if run.tare_end_s < times_s[k] < end_s:
            estimates.append(identifier.update(*sample, 1e-3, CLOCK_S + times_s[k]))
            if k % 500 == 0:
                motions.append(identifier.snapshot().state.learner.tissue)
    return Insertion(run, estimates, motions)


def test_speed_is_the_rate_of_the_place():
    beats = np.array([[0.3, 1.0, -0.5, 0.2, 0.1], [1.2, 0.2, 0.1, -0.1, 0.05]])
    times_s = np.linspace(0.0, 5.0, 50_001)
    place_mm, speed_mm_s = displacement(beats, times_s)
    gradient_mm_s = np.gradient(place_mm, times_s)

    assert np.allclose(gradient_mm_s[1:-1], speed_mm_s[1:-1], atol=1e-5)


def test_turned_beats_are_the_same_motion():
    beats = np.array([[0.3, 1.0, -0.5, 0.2, 0.1], [1.2, 0.2, 0.1, -0.1, 0.05]])
    times_s = np.linspace(0.0, 5.0, 501)
    fit = turned(Fit(beats, 0.0), 1.7)
    place_mm, _ = displacement(beats, times_s)

    assert np.allclose(displacement(fit.beats, times_s - 1.7)[0], place_mm)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("waves", "hz"), [(HEART, 1.3), (BREATH, 0.28), (HEART + BREATH, 0.28)]
)
def test_ruptures_are_found_in_tissue_that_moves(waves, hz):
    run, estimates, motions = insertion(waves)
    known = [motion for motion in motions if motion.is_known]

    assert known
    assert known[-1].fit.beats[0, 0] == pytest.approx(hz, abs=0.01)

    rupture_s = run.truth.ruptures[0].onset_s
    begin_s = estimates[0].time_s - CLOCK_S - 1e-3
    fits = [motion.fit for motion in known if motion.fit.at_s + begin_s < rupture_s]
    times_s = np.linspace(0.0, 1.0 / hz, 50)
    place_mm, _ = displacement(fits[-1].beats, times_s)
    true_times_s = begin_s + fits[-1].at_s + times_s
    error_mm = place_mm - 1e3 * TrueMotion(waves=waves).at(true_times_s)[0]

    assert np.std(error_mm) < 0.3 * np.std(place_mm)

    ruptures = [estimate.rupture for estimate in estimates if estimate.rupture]

    assert len(ruptures) <= 4  # not one at every beat

    delays_s = [rupture.alarm_s - CLOCK_S - rupture_s for rupture in ruptures]
    near_s = [delay_s for delay_s in delays_s if abs(delay_s) < 3.0]

    assert len(near_s) == 1
    assert 0.0 < near_s[0] < 0.2


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gel-25-constant", "abdomen-sinusoidal"])
def test_tissue_at_rest_stays_at_rest(name):
    motions = insertion((), name).motions
    assert not any(motion.is_known for motion in motions)


def test_a_motion_that_has_ended_is_given_up():
    times_s = np.arange(1, 800) * 0.05
    moving_mm = 0.2 * np.cos(2.0 * np.pi * 1.3 * np.minimum(times_s, 15.0))
    depths_mm = 3.0 * times_s
    speeds = np.gradient(depths_mm - moving_mm, times_s)
    courses = contact_along((depths_mm - moving_mm)[None])
    deflections, remaining = (course[0] for course in courses)
    noise_N = np.random.default_rng(0).normal(0.0, 0.01, len(times_s))
    forces_N = (0.1 + 0.02 * depths_mm) * deflections
    forces_N += (5e-3 + 2e-3 * depths_mm) * speeds
    forces_N += (0.2 + 0.03 * depths_mm) * remaining + noise_N
    motion = TissueMotion()
    is_known = []
    columns = (times_s.tolist(), depths_mm.tolist(), forces_N.tolist())
    for time_s, depth_mm, force_N in zip(*columns, strict=True):
        tissue = motion.motion_at(time_s)
        block = Block(
            time_s=time_s,
            duration_s=0.05,
            depth_mm=depth_mm - tissue.place_mm,
            speed_mm_s=3.0 - tissue.speed_mm_s,
            force_N=force_N,
        )
        motion = motion.with_block(block, is_met=True)
        for _ in range(5):
            motion = motion.worked(time_s) if motion.is_due(time_s) else motion
        is_known.append(motion.is_known)

    assert is_known[int(14.0 / 0.05)]
    assert not any(is_known[int(32.0 / 0.05) :])


HEARTBEAT = np.array([[1.2, 0.2, 0.0, 0.0, 0.0]])


def test_a_second_rupture_makes_a_motion_forgotten():
    motion = TissueMotion(window=np.ones((100, 4)), fit=Fit(HEARTBEAT, 1.0, 5.0))

    assert motion.is_known
    assert motion.restarted(5.0).is_known
    assert not motion.restarted(5.0).restarted(6.0).is_known


def test_a_bad_fit_is_noise_only_once_it_stays():
    times_s = np.arange(256) * 0.05
    forces_N = np.random.default_rng(0).normal(1.0, 0.3, 256)
    columns = (times_s, 3.0 * times_s, np.full(256, 3.0), forces_N)
    fit = Fit(HEARTBEAT, 12.8, 5.0, rms_N=0.01)
    motion = TissueMotion(window=np.column_stack(columns), fit=fit)
    unexplained_N = []
    for k in range(8):
        motion = motion.worked(12.8 + 0.2 * k)
        unexplained_N.append(motion.fit.rms_N)

    assert unexplained_N[:7] == [0.01] * 7
    assert unexplained_N[7] > 0.2


@pytest.mark.parametrize("force_N", [0.0, 1e3, -1e3])
@pytest.mark.parametrize("speed_mm_s", [0.0, 1.0, 1e6])
def test_work_never_fails(force_N, speed_mm_s):
    motion = TissueMotion(unit=0)
    for k in range(400):
        time_s = 0.05 * k
        block = Block(
            time_s=time_s,
            duration_s=0.05,
            depth_mm=speed_mm_s * time_s,
            speed_mm_s=speed_mm_s,
            force_N=force_N if k % 7 else -force_N,
        )
        motion = motion.with_block(block, is_met=True)
        motion = motion.worked(time_s) if motion.is_due(time_s) else motion
        assert np.isfinite(motion.motion_at(time_s)).all()


@pytest.mark.slow
def test_an_insertion_resumes_in_moving_tissue():
    motion = TrueMotion(waves=HEART)
    chosen = replace(scenario("gel-25-constant", 0), tissue_motion=motion)
    run = insert_needle(chosen, seed=7)
    columns = np.column_stack((run.depth_m, run.speed_m_s, run.force_N))
    rows = columns[13_000:27_000].tolist()
    first = Identifier()
    second = Identifier()
    for row in rows[:12_000]:
        first.update(*row, 1e-3)
    second.restore(first.snapshot())

    assert first.snapshot().state.learner.tissue.is_known

    for row in rows[12_000:]:
        assert second.update(*row, 1e-3) == first.update(*row, 1e-3)


@pytest.mark.slow
def test_tissue_that_draws_back_beyond_the_tip_ends_the_search_for_its_motion():
    """The window of the search empties while a part of its work is still due."""
    waves = (Wave(10.4e-3, 0.2212, 3.795), Wave(3.754e-3, 0.4424, 1.3926))
    breathing = replace(
        scenario("gel-25-constant"), tissue_motion=TrueMotion(waves=waves)
    )
    run = insert_needle(breathing, seed=105, rate_hz=250.0)
    result = replay(run.t_s, run.depth_m, run.force_N, run.speed_m_s)

    assert len(result.estimates) == run.t_s.size
    assert result.estimates[-1].status is SampleStatus.OK


@pytest.mark.parametrize("dt_s", [0.1, 0.2, 0.24])
def test_a_log_too_slow_for_a_heartbeat_is_identified(dt_s):
    identifier = Identifier(MIXTURE)
    rng = np.random.default_rng(1)
    for tick in range(round(40.0 / dt_s)):
        depth_m = 1e-3 * tick * dt_s - 3e-3
        breath_N = 0.2 * np.sin(2.0 * np.pi * 0.25 * tick * dt_s)
        force_N = 30.0 * max(depth_m, 0.0) + breath_N * (depth_m > 0.0)
        noise_N = 5e-3 * float(rng.standard_normal())
        estimate = identifier.update(depth_m, 1e-3, force_N + noise_N, dt_s)

    assert estimate.status is SampleStatus.OK
