"""A force in free air, where nothing acts on the needle, is an error that is said."""

from itertools import islice

import numpy as np
import pytest

from identification import MIXTURE, PUBLISHED
from needleforce import InsertionSession, SensorWarning
from needleforce.zero_watch import AirWatch
from tests.insertion_run import samples, short_run, tare_index
from tests.residual.residual_signals import jacobian_of

STD_N = 0.02


def watched(forces_N):
    """The doubt after each force, 1 ms apart."""
    watch = AirWatch()
    doubts_N = []
    for force_N in forces_N:
        watch = watch.with_force(float(force_N), STD_N, 1e-3)
        doubts_N.append(watch.doubt_N)
    return np.array(doubts_N)


def test_a_slow_error_within_its_deviation_is_no_force():
    rng = np.random.default_rng(1)
    assert not watched(2.5 * STD_N + STD_N * rng.standard_normal(20_000)).any()


def test_a_force_that_resists_may_be_a_contact_for_a_second():
    doubts_N = watched(np.full(3_000, 0.2))

    assert 1_000 < np.argmax(doubts_N > 0.0) < 1_200
    assert doubts_N[-1] == pytest.approx(0.2, abs=0.01)


def test_a_force_that_pulls_is_none_and_ends_when_it_is_gone():
    doubts_N = watched(np.concatenate((np.full(1_000, -0.2), np.zeros(2_000))))

    assert 0 < np.argmax(doubts_N > 0.0) < 150
    assert doubts_N[1_000] > 0.1
    assert doubts_N[-1] == 0.0


def insertion(weight_kg=0.0, config=MIXTURE):
    """Estimates of 5 s in tissue, whose payload is gripped anew after the tare, the
    first sample in tissue, and the doubt of the force."""
    run = short_run()
    tare = tare_index(run)
    touched = int(np.searchsorted(run.signals.t_s, run.truth.contact_s))
    session = InsertionSession(run.robot, identifier_config=config)
    estimates = []
    for k, (q, dq, tau, dt_s) in islice(samples(run), touched + 5_001):
        if k == tare:
            session.tare()
        if k % 20 == 0:
            jacobian = jacobian_of(run.robot, q)
        onset = min(max((k - tare - 200) / 300.0, 0.0), 1.0)
        heavier = tau + jacobian[2] * weight_kg * 9.81 * onset
        estimates.append(session.update(q, dq, heavier, dt_s))
    return estimates, touched, session.snapshot().air.doubt_N


@pytest.mark.slow
def test_a_payload_gripped_anew_after_the_tare_is_said_before_the_entry():
    estimates, touched, doubt_N = insertion(weight_kg=0.03)
    axial_N, std_N = np.array(
        [(e.wrench.axial, e.wrench.axial_std) for e in estimates[touched:]]
    ).T
    error_N = axial_N - short_run().truth.axial_N[touched : len(estimates)]

    assert SensorWarning.UNEXPLAINED in estimates[touched - 50].warnings
    assert np.mean(np.abs(error_N) < 2.0 * std_N) > 0.95
    assert doubt_N > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
def test_nothing_is_unexplained_in_an_undisturbed_insertion(config):
    estimates, *_ = insertion(config=config)

    assert not any(SensorWarning.UNEXPLAINED in e.wrench.warnings for e in estimates)
