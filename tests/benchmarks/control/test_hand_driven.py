"""A hand that drives the needle: its strokes, and what it feels at a rupture."""

import numpy as np
import pytest

from benchmarks.control.hand_driven import (
    BACK_S,
    HAND_STROKE_M,
    HandPlan,
    Teleinsertion,
    ruptures_felt,
)
from groundtruth import Rupture


def test_the_hand_reaches_the_travel_in_strokes():
    """The hand reaches its travel in strokes, and goes back with the pedal up."""
    hand = HandPlan(needle_speed_m_s=4e-3, needle_travel_m=0.1, scale=0.4)

    assert hand.strokes == 2

    t_s = np.arange(0.0, hand.duration_s + 0.5, 1e-3)
    wish, pedal = map(np.array, zip(*(hand.at(t) for t in t_s), strict=True))

    assert wish.max() <= HAND_STROKE_M

    moved = np.diff(wish) * pedal[1:]

    assert hand.scale * moved[moved > 0.0].sum() == pytest.approx(0.1, rel=1e-3)
    assert (~pedal).sum() == pytest.approx(1e3 * BACK_S, abs=2)


def test_felt_rupture_is_the_fall_of_each_force():
    rupture = Rupture(
        onset_s=1.0,
        end_s=1.1,
        onset_m=0.03,
        layer=1,
        drop_N=1.0,
        visible_drop_N=1.0,
        layer_friction_N=1.0,
        friction_N=3.0,
    )
    run = Teleinsertion(
        t_s=1e-3 * np.arange(2000),
        tip_N=np.repeat((1.0, 0.0), 1000),
        shown_N=np.repeat((1.1, 0.1), 1000),
        raw_N=np.repeat((4.0, 3.0), 1000),
        alarms_s=np.array([1.05]),
        ruptures=(rupture,),
    )
    (felt,) = ruptures_felt(run)

    assert felt == pytest.approx((1.0 / 1.1, 0.25, 0.1, 0.05), rel=1e-6)
