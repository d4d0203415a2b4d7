"""A needle that outruns the force of the virtual sensor."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.insertion_course import InsertionCourse, InsertionProgress
from needleforce.tip_travel import TravelZero

LAG_S = 1.0 / 70.0  # of the default gain


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


@pytest.mark.parametrize(
    ("speed_mm_s", "depth_mm", "is_too_fast"),
    [(27.5, 20.0, False), (28.5, 20.0, True), (28.5, 5.0, False), (-40.0, 20.0, False)],
)
def test_a_needle_is_too_fast_where_it_outruns_the_force(
    speed_mm_s, depth_mm, is_too_fast
):
    needle = course(1e-3 * speed_mm_s, 1e-3 * depth_mm)

    InsertionCourse.judge_speed(needle, LAG_S)

    assert needle.insertion.is_too_fast is is_too_fast


def test_it_stays_too_fast_for_the_insertion():
    needle = course(40e-3)
    InsertionCourse.judge_speed(needle, LAG_S)
    needle.travel.speed_m_s = 5e-3
    InsertionCourse.judge_speed(needle, LAG_S)

    assert needle.insertion.is_too_fast
