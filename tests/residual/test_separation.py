"""What a tare says of how well it told hysteresis from friction."""

import copy
from functools import cache
from itertools import islice

import numpy as np
import pytest

from needleforce import InsertionSession
from residual import SensorConfig, advise_motion
from tests.insertion_run import samples, short_run, tare_index

RUN = short_run()
AT_REST = 600
"""Samples before the needle moves."""


@cache
def _tared_after(count):
    session = InsertionSession(RUN.robot)
    for _, sample in islice(samples(RUN), count):
        session.update(*sample)
    session.tare()
    return session


def tared_after(count):
    """A session that has been tared on the first samples of the short run."""
    return copy.deepcopy(_tared_after(count))


@pytest.mark.slow
def test_a_stroke_tells_more_than_a_rest():
    rest = tared_after(AT_REST).tare_separation
    stroke = tared_after(tare_index(RUN)).tare_separation

    assert [item.joint for item in stroke] == list(RUN.robot.joint_names)
    for at_rest, moved in zip(rest, stroke, strict=True):
        assert at_rest.prior_std_Nm == pytest.approx(moved.prior_std_Nm)
        assert at_rest.hysteresis_std_Nm > moved.hysteresis_std_Nm
    assert not any(item.is_separated for item in rest)


def test_the_deviations_are_those_of_the_tare():
    """With the parameters drawn from the tare's covariance the sums scatter so."""
    session = tared_after(tare_index(RUN))
    tare = session.snapshot().sensor.offset.tare
    joints = RUN.robot.nv
    links = 4 * joints
    loops = slice(joints + links + 1, joints + links + 1 + 3 * joints, joints)
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(tare.mean, tare.covariance, 4000)
    sums_Nm = draws[:, loops].sum(axis=1)
    after_loops = 4 * joints + links + 1
    elements = slice(after_loops, after_loops + 3 * joints, joints)
    frictions_Nm = draws[:, elements].sum(axis=1)

    second = session.tare_separation[1]
    assert second.hysteresis_Nm == pytest.approx(np.mean(sums_Nm), abs=2e-3)
    assert second.hysteresis_std_Nm == pytest.approx(np.std(sums_Nm), rel=0.05)
    assert second.friction_Nm == pytest.approx(np.mean(frictions_Nm), abs=2e-3)
    assert second.friction_std_Nm == pytest.approx(np.std(frictions_Nm), rel=0.05)
    correlation = np.corrcoef(sums_Nm, frictions_Nm)[0, 1]
    assert second.correlation == pytest.approx(correlation, abs=0.03)


def test_the_advice_names_the_joints_that_the_motion_left_undecided():
    advice = advise_motion(tared_after(AT_REST).tare_separation)

    assert all(name in advice for name in RUN.robot.joint_names)
    assert "elbow" in advice


def test_there_is_no_separation_without_a_model_or_a_tare():
    assert InsertionSession(RUN.robot).tare_separation == ()

    session = InsertionSession(RUN.robot, SensorConfig(tare="constant"))
    for _, sample in islice(samples(RUN), AT_REST):
        session.update(*sample)
    session.tare()
    assert session.tare_separation == ()
    assert advise_motion(session.tare_separation) == ""
