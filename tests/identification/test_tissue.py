"""Motion of the tissue found in the force, and ruptures found in tissue that moves."""

from dataclasses import replace

import numpy as np
import pytest

from groundtruth import insert_needle, scenario
from groundtruth.scenarios import TissueMotion as TrueMotion
from identification import Identifier
from identification.multilayer.force_split import contact_along
from identification.multilayer.mixture import Place
from identification.multilayer.tissue_motion import (
    Fit,
    TissueMotion,
    displacement,
    turned,
)

HEART = ((0.2e-3, 1.3, 0.4), (0.08e-3, 2.6, 1.0))
BREATH = ((1.2e-3, 0.28, 2.0), (0.3e-3, 0.56, 0.5))
CLOCK_S = -25.0


def insertion(waves, name="gel-25-constant", seed=5):
    """Estimates of an insertion in tissue that moves, its truth, and the motion in use.

    The caller's clock begins below zero; that of the motion is the time since the first
    sample.
    """
    chosen = replace(
        scenario(name, 0), tissue_motion=TrueMotion(waves=waves) if waves else None
    )
    run = insert_needle(chosen, seed=seed)
    found = []
    motions = []
    identifier = Identifier()
    samples = zip(
        run.depth_m.tolist(), run.speed_m_s.tolist(), run.force_N.tolist(), strict=True
    )
    for k, sample in enumerate(samples):
        if run.tare_end_s < run.t_s[k] < run.scenario.motion.withdrawal_start_s:
            found.append(identifier.update(*sample, 1e-3, CLOCK_S + float(run.t_s[k])))
            motions.append(identifier.snapshot().state.tissue if k % 500 == 0 else None)
    return run, found, [motion for motion in motions if motion is not None]


def test_speed_is_the_rate_of_the_place():
    beats = np.array([[0.3, 1.0, -0.5, 0.2, 0.1], [1.2, 0.2, 0.1, -0.1, 0.05]])
    times = np.linspace(0.0, 5.0, 50_001)
    place, speed = displacement(beats, times)
    assert np.allclose(np.gradient(place, times)[1:-1], speed[1:-1], atol=1e-5)
    fit = turned(Fit(beats, 0.0), 1.7)
    assert np.allclose(displacement(fit.beats, times - 1.7)[0], place)


@pytest.mark.parametrize(
    ("waves", "hz"), [(HEART, 1.3), (BREATH, 0.28), (HEART + BREATH, 0.28)]
)
def test_ruptures_are_found_in_tissue_that_moves(waves, hz):
    run, found, motions = insertion(waves)
    known = [motion for motion in motions if motion.is_known]
    assert known
    assert known[-1].fit.beats[0, 0] == pytest.approx(hz, abs=0.01)
    true = TrueMotion(waves=waves)
    rupture_s = run.truth.ruptures[0].onset_s
    begin_s = found[0].time_s - CLOCK_S - 1e-3
    last = [motion for motion in known if motion.fit.at_s + begin_s < rupture_s][-1]
    times = np.linspace(0.0, 1.0 / hz, 50)
    place = displacement(last.fit.beats, times)[0]
    error = place - 1e3 * true.at(begin_s + last.fit.at_s + times)[0]
    assert np.std(error) < 0.3 * np.std(place)
    alarms_s = [
        each.rupture.alarm_s - CLOCK_S for each in found if each.rupture is not None
    ]
    near = [each for each in alarms_s if abs(each - rupture_s) < 3.0]
    assert len(near) == 1
    assert len(alarms_s) <= 3  # not one at every beat
    assert 0.0 < near[0] - rupture_s < 0.2


@pytest.mark.parametrize("name", ["gel-25-constant", "abdomen-sinusoidal"])
def test_tissue_at_rest_stays_at_rest(name):
    _, _, motions = insertion((), name)
    assert not any(motion.is_known for motion in motions)


def test_a_motion_that_has_ended_is_given_up():
    times = np.arange(1, 800) * 0.05
    moving = 0.2 * np.cos(2.0 * np.pi * 1.3 * np.minimum(times, 15.0))
    depths = 3.0 * times
    speeds = np.gradient(depths - moving, times)
    deflections, left = (course[0] for course in contact_along((depths - moving)[None]))
    noise = np.random.default_rng(0)
    forces = (0.1 + 0.02 * depths) * deflections + (5e-3 + 2e-3 * depths) * speeds
    forces += (0.2 + 0.03 * depths) * left + noise.normal(0.0, 0.01, len(times))
    motion = TissueMotion()
    known = []
    for time_s, depth, force in zip(
        times.tolist(), depths.tolist(), forces.tolist(), strict=True
    ):
        place, speed = motion.at(time_s)
        block = Place(time_s, 0.05, depth - place, 3.0 - speed, 1.0, force, 3.0, 0.01)
        motion = motion.with_block(block, is_met=True)
        for _ in range(5):
            motion = motion.worked(time_s) if motion.is_due(time_s) else motion
        known.append(motion.is_known)
    assert known[int(14.0 / 0.05)]
    assert not any(known[int(32.0 / 0.05) :])


def test_a_motion_that_a_second_rupture_contradicts_is_forgotten():
    fit = Fit(np.array([[1.2, 0.2, 0.0, 0.0, 0.0]]), 1.0, 5.0)
    motion = TissueMotion(window=np.ones((100, 4)), fit=fit)
    assert motion.is_known
    assert motion.restarted(5.0).is_known
    assert not motion.restarted(5.0).restarted(6.0).is_known


def test_a_fit_that_has_become_bad_is_noise_only_once_it_stays_so():
    window = np.column_stack(
        (np.arange(256) * 0.05, np.arange(256) * 0.15, np.full(256, 3.0))
    )
    window = np.column_stack((window, np.random.default_rng(0).normal(1.0, 0.3, 256)))
    fit = Fit(np.array([[1.2, 0.2, 0.0, 0.0, 0.0]]), 12.8, 5.0, rms_N=0.01)
    motion = TissueMotion(window=window, fit=fit)
    left_N = []
    for k in range(8):
        motion = motion.worked(12.8 + 0.2 * k)
        left_N.append(motion.fit.rms_N)
    assert left_N[:7] == [0.01] * 7
    assert left_N[7] > 0.2


@pytest.mark.parametrize("force", [0.0, 1e3, -1e3])
@pytest.mark.parametrize("speed", [0.0, 1.0, 1e6])
def test_whatever_the_window_holds_work_never_fails(force, speed):
    motion = TissueMotion(unit=0)
    for k in range(400):
        sign = 1.0 if k % 7 else -1.0
        block = Place(
            0.05 * k, 0.05, 0.05 * speed * k, speed, 1.0, sign * force, speed, 0.01
        )
        motion = motion.with_block(block, is_met=True)
        motion = motion.worked(0.05 * k) if motion.is_due(0.05 * k) else motion
        assert np.isfinite(motion.at(0.05 * k)).all()


def test_an_insertion_goes_on_from_a_snapshot_in_moving_tissue():
    chosen = replace(
        scenario("gel-25-constant", 0), tissue_motion=TrueMotion(waves=HEART)
    )
    run = insert_needle(chosen, seed=5)
    first = Identifier()
    second = Identifier()
    rows = np.column_stack((run.depth_m, run.speed_m_s, run.force_N))[
        13_000:26_000
    ].tolist()
    for k, row in enumerate(rows):
        if k == 11_000:
            second.restore(first.snapshot())
            assert first.snapshot().state.tissue.is_known
        estimate = first.update(*row, 1e-3)
        if k >= 11_000:
            assert second.update(*row, 1e-3) == estimate
