"""A needle that outruns the force of the virtual sensor."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from needleforce import InsertionSession
from needleforce.insertion_course import InsertionCourse, InsertionProgress
from needleforce.tip_travel import TravelZero
from residual import SensorWarning
from urdf import load_lwr

LAG_S = 24.3e-3  # of the default gain and estimated velocities


def course(speed_m_s: float, depth_m: float = 20e-3) -> SimpleNamespace:
    """A course whose tissue begins 10 mm deep."""
    line = TravelZero(
        start_in_base_m=np.zeros(3), axis_in_base=np.array([0.0, 0.0, 1.0])
    )
    return SimpleNamespace(
        travel=SimpleNamespace(speed_m_s=speed_m_s, depth_m=depth_m),
        insertion=InsertionProgress(line),
        _is_in_air=depth_m < 10e-3,
    )


def advance(needle: SimpleNamespace, seconds: float, dt_s: float = 1e-3) -> bool:
    """Whether the needle counts as too fast after so long."""
    for _ in range(round(seconds / dt_s)):
        InsertionCourse.judge_speed(cast(Any, needle), LAG_S, dt_s)
    return needle.insertion.is_too_fast


@pytest.mark.parametrize(
    ("speed_mm_s", "depth_mm", "is_too_fast"),
    [(12.2, 20.0, False), (12.5, 20.0, True), (12.5, 5.0, False), (-40.0, 20.0, False)],
)
def test_a_needle_is_too_fast_where_it_outruns_the_force(
    speed_mm_s, depth_mm, is_too_fast
):
    needle = course(1e-3 * speed_mm_s, 1e-3 * depth_mm)

    assert [advance(needle, 0.049), advance(needle, 0.1)] == [False, is_too_fast]


def test_it_stays_too_fast_for_the_insertion():
    needle = course(40e-3)
    advance(needle, 0.1)
    needle.travel.speed_m_s = 5e-3

    assert advance(needle, 1.0)


def test_noise_of_an_estimated_speed_makes_no_needle_too_fast():
    needle = course(0.0)
    rng = np.random.default_rng(0)
    for speed_mm_s in 10.0 + 1.5 * rng.standard_normal(1000):
        needle.travel.speed_m_s = 1e-3 * speed_mm_s
        advance(needle, 0.01)  # noise lasts as long as the lag of the estimate

    assert not needle.insertion.is_too_fast


def test_the_warning_says_how_fast_a_needle_may_be_where_the_lag_is_known():
    robot = load_lwr()
    session = InsertionSession(robot)
    still = np.zeros(robot.nv)
    needle = session._needle
    session.update(still, None, still, 1e-3)
    needle.insertion.is_too_fast = True

    own = session.update(still, None, still, 1e-3).wrench
    # The robot's own estimate of the torques: how late it is, nobody has said.
    robots = session.update_external_torque(still, None, still, 1e-3).wrench

    assert SensorWarning.TOO_FAST in own.warnings & robots.warnings
    assert "12 mm/s" in own.message
    assert "12 mm/s" not in robots.message
