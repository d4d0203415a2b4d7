"""A tare that is fitted beside the ticks of a loop."""

import copy
import pickle
from functools import cache
from itertools import islice

import numpy as np
import pytest

from needleforce import InsertionSession, read_snapshot, write_snapshot
from residual import ConfigurationError, Status, TareError
from tests.insertion_run import samples, short_run, tare_index
from tests.residual.residual_signals import external_torque_of, pose_of

RUN = short_run()
TARE = tare_index(RUN)
FOLLOWING = [sample for _, sample in islice(samples(RUN), TARE, TARE + 1500)]


@cache
def _moved():
    session = InsertionSession(RUN.robot)
    for _, sample in islice(samples(RUN), TARE):
        session.update(*sample)
    return session


def moved():
    """A session that has followed the free motion of the short run."""
    return copy.deepcopy(_moved())


def updated_while_taring(session, following):
    """Update a session until its tare has ended; returns the estimates."""
    estimates = []
    for sample in following:
        estimates.append(session.update(*sample))
        if not session.taring:
            return estimates
    raise AssertionError("still taring")


def tare_of(session):
    return session.snapshot().sensor.offset.tare


def same(one, other):
    return all(map(np.array_equal, one, other))


@pytest.mark.slow
def test_a_tare_in_steps_is_the_same_bit_for_bit():
    at_once = moved()
    at_once.tare()
    session = moved()
    session.start_tare()

    assert session.taring
    assert not session.tared

    estimates = updated_while_taring(session, FOLLOWING)

    assert session.tared
    assert same(tare_of(session), tare_of(at_once))
    for estimate in estimates:
        assert estimate.status is Status.NOT_TARED
        assert "being fitted" in estimate.wrench.message
        assert not estimate.used_for_identification

    for sample in FOLLOWING[: len(estimates)]:
        at_once.update(*sample)
    after = [each.update(*FOLLOWING[len(estimates)]) for each in (session, at_once)]

    assert after[0].status is Status.OK
    # The insertion begins where the tip was when the tare was complete.
    assert abs(after[0].depth_m) < 1e-4

    # Both renew the bias at the same ticks, every 20 ms, from the next one on.
    for sample in FOLLOWING[len(estimates) + 1 : len(estimates) + 22]:
        after = [each.update(*sample) for each in (session, at_once)]

    assert np.array_equal(after[0].wrench.residual, after[1].wrench.residual)


@pytest.mark.parametrize("how", ["file", "copy", "pickle"])
def test_a_session_that_is_taring_goes_on_bit_for_bit(how, tmp_path):
    session = moved()
    session.start_tare(steps_per_tick=4)
    for sample in FOLLOWING[:100]:
        session.update(*sample)
    if how == "file":
        other = InsertionSession(RUN.robot)
        write_snapshot(session.snapshot(), tmp_path / "taring.snapshot")
        other.restore(read_snapshot(tmp_path / "taring.snapshot"))
    else:
        other = (
            copy.deepcopy(session)
            if how == "copy"
            else pickle.loads(pickle.dumps(session))
        )

    assert other.taring

    counts = [
        len(updated_while_taring(each, FOLLOWING[100:])) for each in (session, other)
    ]

    assert counts[0] == counts[1]
    assert same(tare_of(session), tare_of(other))


@pytest.mark.slow
def test_a_refused_tare_in_steps_says_why_and_changes_nothing():
    session = moved()
    q_rad = FOLLOWING[0][0]
    needle = pose_of(RUN.robot, q_rad).rotation[:, 2]
    push_Nm = 2.0 * external_torque_of(RUN.robot, q_rad, needle)
    for k, (q, dq, tau, dt_s) in enumerate(FOLLOWING[:800]):
        # A contact that begins and stays.
        session.update(q, dq, tau + min(k / 300, 1.0) * push_Nm, dt_s)
    with pytest.raises(TareError) as refused:
        copy.deepcopy(session).tare()
    session.start_tare(steps_per_tick=200)
    for q, dq, tau, dt_s in FOLLOWING[800:1000]:
        estimate = session.update(q, dq, tau + push_Nm, dt_s)

    assert not session.taring
    assert not session.tared
    assert str(session.tare_refusal) == str(refused.value)
    assert str(refused.value) in estimate.wrench.message

    session.start_tare_recording()

    assert session.tare_refusal is None


def test_what_cannot_be_tared_is_refused_at_once():
    session = InsertionSession(RUN.robot)
    with pytest.raises(TareError, match="no settled free motion"):
        session.start_tare()
    with pytest.raises(ConfigurationError, match="steps_per_tick"):
        moved().start_tare(steps_per_tick=0)

    assert not session.taring


def test_a_second_start_does_nothing_and_a_new_recording_ends_a_tare():
    session = moved()
    session.start_tare()
    for sample in FOLLOWING[:300]:
        session.update(*sample)
    session.start_tare()

    assert len(updated_while_taring(session, FOLLOWING[300:])) < 900

    session = moved()
    session.start_tare()
    session.start_tare_recording()

    assert not session.taring


@pytest.mark.slow
def test_torques_that_are_all_zero_are_refused_beside_the_ticks():
    session = InsertionSession(RUN.robot)
    no_torque_Nm = np.zeros(RUN.robot.nv)
    for _, (q, dq, _, dt_s) in islice(samples(RUN), TARE):
        session.update(q, dq, no_torque_Nm, dt_s)
    session.start_tare(steps_per_tick=200)
    for q, dq, _, dt_s in FOLLOWING[:200]:
        session.update(q, dq, no_torque_Nm, dt_s)

    assert not session.taring
    assert not session.tared
    assert "has not changed" in str(session.tare_refusal)
