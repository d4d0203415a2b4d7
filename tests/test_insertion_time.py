"""What time an insertion session counts when samples are missing or a clock is set."""

from itertools import islice

import numpy as np
import pytest
from insertion_run import samples, short_run, tare_index

from identification import MultilayerConfig, SampleStatus
from identification.input_validation import CheckConfig
from needleforce import InsertionSession
from residual import Status
from residual.tool_kinematics import ToolKinematics


def tared_session(**settings):
    """A session at the end of the free stroke, and the samples that follow."""
    run = short_run()
    session, tare = InsertionSession(run.robot, **settings), tare_index(run)
    feed = samples(run)
    for _, sample in islice(feed, tare):
        session.update(*sample)
    session.tare()
    return session, [sample for _, sample in islice(feed, 1200)]


@pytest.mark.parametrize("dt_s", [-10.0, 1.8e9, np.nan, None])
def test_a_clock_that_was_set_takes_no_time(dt_s):
    session, rows = tared_session()
    for row in rows[:50]:
        before = session.update(*row)
    assert before.used_for_identification
    set_back = session.update(*rows[50][:3], dt_s)
    assert set_back.status is Status.REJECTED
    assert not set_back.used_for_identification
    after = session.update(*rows[51])
    assert after.used_for_identification
    passed_s = after.identification.time_s - before.identification.time_s
    assert passed_s == pytest.approx(rows[51][3])


def test_time_of_skipped_samples_is_counted_once():
    session, rows = tared_session()
    for k, (q, dq, tau, dt_s) in enumerate(rows[:300]):
        last = session.update(q, dq, tau * np.nan if 100 <= k < 130 else tau, dt_s)
    assert last.used_for_identification
    assert last.identification.time_s == pytest.approx(0.3)


def test_speed_follows_over_the_true_time():
    (lost, rows), (whole, _) = (tared_session(speed_lag_s=0.02) for _ in range(2))
    for k, (q, dq, tau, dt_s) in enumerate(rows[:1000]):
        ours = lost.update(q, dq, tau * np.nan if k % 10 else tau, dt_s)
        theirs = whole.update(q, dq, tau, dt_s)
    for k, (q, dq, tau, dt_s) in enumerate(rows[1000:1100]):
        dq = dq * 3.0
        ours = lost.update(q, dq, tau * np.nan if k % 10 else tau, dt_s)
        theirs = whole.update(q, dq, tau, dt_s)
        if k % 10 == 0 and k >= 30:
            assert ours.speed_m_s == pytest.approx(theirs.speed_m_s, rel=0.2)


def test_a_force_that_the_identifier_refuses_was_not_fed():
    config = MultilayerConfig(check=CheckConfig(force_limit_N=1.0))
    session, rows = tared_session(identifier_config=config)
    robot = short_run().robot
    kinematics = ToolKinematics(robot)
    found = []
    for k, (q, dq, tau, dt_s) in enumerate(rows[:400]):
        kinematics.update(q)
        push = 3.0 * kinematics.axial_jacobian if k > 100 else 0.0
        found.append(session.update(q, dq, tau + push, dt_s))
    assert all(e.used_for_identification for e in found[:100])
    assert found[-1].status is Status.OK
    assert found[-1].wrench.axial > 1.0
    assert found[-1].identification.status is SampleStatus.FORCE_RANGE
    assert not found[-1].used_for_identification
