"""A push aside is no rupture, although it looks like one before its misfit has stayed."""

from itertools import islice

import numpy as np
import pytest
from insertion_run import same, samples, short_run, tare_index

from groundtruth import Run
from needleforce import InsertionSession
from residual import SensorWarning, Status
from residual.tool_kinematics import ToolKinematics

DEPTH_M = 15e-3
PUSHED = 200
ROUND = 400


@pytest.fixture(scope="module")
def inside():
    """A session in the middle of the gel, and the samples that follow."""
    run: Run = short_run()
    session, feed = InsertionSession(run.robot), samples(run)
    at = int(np.argmax(run.truth.depth_m > DEPTH_M))
    for k, sample in islice(feed, at):
        if k == tare_index(run):
            session.tare()
        session.update(*sample)
    return session.snapshot(), [sample for _, sample in islice(feed, 12000)]


def pushed(rows, force_in_base_N, first, samples):
    """Samples with a force on the needle's tip beside that of the tissue."""
    kinematics, rows = ToolKinematics(short_run().robot), list(rows)
    for k in range(first, first + samples):
        q, dq, tau, dt_s = rows[k]
        kinematics.update(q)
        force_in_tool = kinematics.rotation_tool_to_base.T @ force_in_base_N
        rows[k] = (q, dq, tau - kinematics.jacobian[:3].T @ force_in_tool, dt_s)
    return rows


def follow(snapshot, rows):
    session = InsertionSession(short_run().robot)
    session.restore(snapshot)
    return session, [session.update(*row) for row in rows]


def ruptures(found):
    return [k for k, e in enumerate(found) if e.identification.rupture is not None]


@pytest.mark.parametrize("force_in_base_N", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.3, 0.0, 0.0)])
@pytest.mark.parametrize("first", [100, 106, 112, 118])
def test_a_push_aside_raises_no_rupture(inside, force_in_base_N, first):
    snapshot, rows = inside
    rows = pushed(rows[:ROUND], np.array(force_in_base_N), first, ROUND - first)
    _, found = follow(snapshot, rows)
    assert ruptures(found) == []
    told = [k for k, e in enumerate(found) if SensorWarning.MODEL_MISMATCH in e.warnings]
    assert first < told[0] < first + 100
    assert "do not fit" in found[told[0]].wrench.message
    assert not any(found[k].used_for_identification for k in told)
    assert all(e.status is Status.OK for e in found)


def test_the_rupture_after_a_push_aside_is_found_when_it_comes(inside):
    snapshot, rows = inside
    session, found = follow(snapshot, pushed(rows, np.array([1.0, 0.0, 0.0]), 100, PUSHED))
    other, undisturbed = follow(snapshot, rows)
    assert len(ruptures(undisturbed)) == 1
    # Blocks of the identifier begin elsewhere after the pause.
    assert ruptures(found) == pytest.approx(ruptures(undisturbed), abs=10)
    assert len(session.layers) == len(other.layers) == 1


def test_an_alarm_of_a_force_along_the_needle_is_passed_on_at_once(inside):
    snapshot, rows = inside
    _, found = follow(snapshot, rows)
    session = InsertionSession(short_run().robot)
    session.restore(snapshot)
    session._sensor.recheck = lambda last: last
    unchecked = [session.update(*row) for row in rows]
    assert len(ruptures(found)) == 1
    assert same(tuple(found), tuple(unchecked))
