"""The motion protocol: its order, its smoothness, and what it refuses."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth.errors import MotionError
from groundtruth.motion import (
    TARE_STROKE_M,
    Motion,
    Stroke,
    chain_strokes,
    constant_motion,
    free_motion,
    sinusoidal_motion,
)

CONSTANT = constant_motion(speed_m_s=2.3e-3, depth_m=45e-3, standoff_m=5e-3)
SINE = sinusoidal_motion(stroke_m=70e-3, frequency_hz=0.016, standoff_m=20e-3)
FREE = free_motion(height_m=20e-3, stroke_m=120e-3, frequency_hz=0.05)
MOTIONS = pytest.mark.parametrize(
    "motion", [CONSTANT, SINE, FREE], ids=["constant", "sine", "free"]
)


INSERTIONS = pytest.mark.parametrize("motion", [CONSTANT, SINE], ids=["constant", "sine"])


@MOTIONS
def test_speed_is_the_rate_of_position_bounded_in_its_change_and_zero_at_rest(motion):
    t = np.linspace(-1.0, motion.duration_s + 1.0, 20_001)
    h = 1e-5
    rate = (motion.position_m(t + h) - motion.position_m(t - h)) / (2.0 * h)
    assert motion.speed_m_s(t) == pytest.approx(rate, abs=2e-6)
    t = np.linspace(0.0, motion.duration_s, 200_001)
    acceleration = np.diff(motion.speed_m_s(t)) / (t[1] - t[0])
    assert np.abs(acceleration).max() < 0.05
    for t in (0.0, 0.5, 1.0, motion.duration_s - 0.25, motion.duration_s, motion.duration_s + 9.0):
        assert motion.speed_m_s(t) == 0.0


@INSERTIONS
def test_no_contact_before_the_end_of_the_tare_stroke_nor_after_the_withdrawal(motion):
    before = np.linspace(0.0, motion.tare_end_s, 5000)
    after = np.linspace(motion.withdrawal_end_s, motion.duration_s + 1.0, 100)
    assert (motion.position_m(before) < 0.0).all()
    assert (motion.position_m(after) < 0.0).all()
    assert np.ptp(motion.position_m(before)) == pytest.approx(TARE_STROKE_M)
    signs = np.sign(motion.speed_m_s(before))
    assert [s for last, s in pairwise(signs) if s and s != last] == [1, -1, 1]


@INSERTIONS
def test_withdrawal_mirrors_the_insertion_after_two_seconds_of_rest(motion):
    assert motion.withdrawal_start_s - motion.insertion_end_s == pytest.approx(2.0)
    s = np.linspace(0.0, motion.insertion_end_s - motion.tare_end_s, 1000)
    inward = motion.position_m(motion.insertion_end_s - s)
    outward = motion.position_m(motion.withdrawal_start_s + s)
    assert outward == pytest.approx(inward, abs=1e-12)


def test_constant_insertion_holds_its_speed_from_before_contact_to_after_the_target():
    t = np.linspace(CONSTANT.tare_end_s, CONSTANT.insertion_end_s, 20_000)
    z, v = CONSTANT.position_m(t), CONSTANT.speed_m_s(t)
    assert v[(z > -3e-3) & (z < 43e-3)] == pytest.approx(2.3e-3, rel=1e-9)
    assert v.max() == pytest.approx(2.3e-3)
    assert CONSTANT.deepest_m == pytest.approx(45e-3)


def test_sinusoidal_insertion_is_the_papers_and_free_motion_stays_above_the_surface():
    s = np.linspace(0.0, 0.5 / 0.016, 500)
    expected = 0.035 * (1.0 - np.cos(2.0 * np.pi * 0.016 * s)) - 20e-3
    assert SINE.position_m(SINE.tare_end_s + s) == pytest.approx(expected, abs=1e-12)
    contact = SINE.tare_end_s + s[np.searchsorted(expected, 0.0)]
    assert SINE.speed_m_s(contact) > 2e-3
    t = np.linspace(0.0, FREE.duration_s, 1000)
    assert FREE.position_m(t).max() == pytest.approx(-20e-3)


def test_scalars_and_arrays_agree():
    t = np.linspace(0.0, CONSTANT.duration_s, 37)
    assert CONSTANT.position_m(t) == pytest.approx([CONSTANT.position_m(float(x)) for x in t])
    assert isinstance(CONSTANT.position_m(3.0), float)
    assert isinstance(CONSTANT.speed_m_s(3.0), float)
    assert CONSTANT.start_m == CONSTANT.position_m(0.0)


@given(ramp=st.floats(0.01, 0.5), travel=st.floats(-0.2, 0.2), duration=st.floats(0.1, 100.0))
def test_every_cruise_covers_its_travel_and_stops(ramp, travel, duration):
    (stroke,) = chain_strokes(0.0, [("cruise", duration, travel)], ramp_fraction=ramp)
    position, speed = stroke.evaluate(np.array([0.0, duration / 2, duration]))
    assert position == pytest.approx([0.0, travel / 2, travel], abs=1e-12)
    assert speed[[0, 2]] == pytest.approx([0.0, 0.0], abs=1e-12)


GOOD = {
    constant_motion: {"speed_m_s": 2e-3, "depth_m": 0.05, "standoff_m": 5e-3},
    sinusoidal_motion: {"stroke_m": 0.07, "frequency_hz": 0.016, "standoff_m": 0.02},
    free_motion: {"height_m": 0.02, "stroke_m": 0.1, "frequency_hz": 0.05},
}


@pytest.mark.parametrize("make", GOOD)
@pytest.mark.parametrize("value", [0.0, -1e-3, float("nan")])
def test_a_motion_refuses_a_value_by_name(make, value):
    for field in GOOD[make]:
        with pytest.raises(MotionError, match=field):
            make(**{**GOOD[make], field: value})


REST = {"profile": "rest", "start_s": 0.0, "duration_s": 1.0, "start_m": 0.0, "travel_m": 0.0}


def test_motions_and_strokes_that_cannot_be_carried_out_are_refused():
    with pytest.raises(MotionError, match="too short"):
        constant_motion(speed_m_s=0.1, depth_m=0.01, standoff_m=0.01)
    with pytest.raises(MotionError, match="above the surface"):
        sinusoidal_motion(stroke_m=0.02, frequency_hz=0.016, standoff_m=0.02)
    with pytest.raises(MotionError, match="not finite"):
        CONSTANT.position_m(float("nan"))
    for field, value in (("duration_s", 0.0), ("ramp_fraction", 0.6)):
        with pytest.raises(MotionError, match=field):
            Stroke(**{**REST, field: value})
    names = ("tare_end_s", "insertion_end_s", "withdrawal_start_s", "withdrawal_end_s")
    instants = dict.fromkeys(names, 1.0)
    with pytest.raises(MotionError, match="follow each other"):
        Motion(strokes=(Stroke(**REST), Stroke(**{**REST, "start_s": 2.0})), **instants)
    with pytest.raises(MotionError, match="at least one"):
        Motion(strokes=(), **instants)
