"""Positions predicted over the delay of an arm."""

import numpy as np
import pytest

from needleforce.control import Controller, DelayPrediction, Limits, SettingError
from tests.needleforce.control.late_arm import LateArm, turn_about_entry
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = np.array([0.0, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0])
CYCLE_s = 1e-3


@pytest.mark.parametrize("cycles_late", [0.0, 1.0, 4.0, 2.5])
def test_the_prediction_is_where_a_late_arm_gets_to(cycles_late):
    """Cycles are lost: a command then holds until the next sample."""
    rng = np.random.default_rng(3)
    prediction = DelayPrediction(2, cycles_late * CYCLE_s)
    commanded_rad = [np.zeros(2)]  # at every cycle, if nothing were late
    velocity = np.zeros(2)
    for _ in range(200):
        held = int(rng.integers(1, 5))
        for _ in range(held):
            commanded_rad.append(commanded_rad[-1] + CYCLE_s * velocity)
        cycles = np.arange(len(commanded_rad))
        measured_rad = [
            np.interp(cycles[-1] - cycles_late, cycles, joint)
            for joint in np.transpose(commanded_rad)
        ]
        prediction.note_command(velocity, held * CYCLE_s)

        predicted_rad = measured_rad + prediction.motion_ahead_rad
        assert predicted_rad == pytest.approx(commanded_rad[-1], abs=1e-12)

        velocity = rng.standard_normal(2)


@pytest.mark.parametrize("dt_s", [1e300, np.nan, np.inf, -1.0])
def test_of_a_pause_the_last_command_counts_only(dt_s):
    prediction = DelayPrediction(1, 0.01)
    prediction.note_command(np.array([0.5]), 0.01)
    prediction.note_command(np.array([0.2]), dt_s)

    ahead_rad = 0.2 * 0.01 if dt_s == 1e300 else 0.5 * 0.01

    assert prediction.motion_ahead_rad == pytest.approx(ahead_rad)


def turn(delay_s, late_cycles):
    """Tilt the needle by 0.35 rad in 0.5 s about an entry 10 mm behind its tip."""
    limits = Limits.of_arm(ROBOT, "lwr", speed_rad_s=10.0, tip_m_s=None)
    return turn_about_entry(
        Controller(ROBOT, limits, delay_s=delay_s),
        LateArm(ROBOT, HOME_rad, late_cycles),
        lambda k: (0.35 * min(k / 500, 1.0), 0.0),
        cycles=1500,
        depth_m=0.01,
    )


def test_a_known_delay_costs_the_entry_nothing():
    predicted = turn(0.02, 20)

    assert predicted.errors_m.max() < 0.25 * turn(None, 20).errors_m.max()
    # So close behind its tip a needle turns slower than asked: joints have far to go.
    assert 0.2 < predicted.tilts_rad[-1] < 0.4


@pytest.mark.parametrize("delay_s", [None, 0.02])
def test_a_wrong_delay_does_not_swing(delay_s):
    """The arm is 10 ms late."""
    turned = turn(delay_s, 10)

    assert turned.errors_m[-300:].max() < 5e-6
    assert (np.diff(turned.tilts_rad[-300:]) > -1e-6).all()  # it only comes nearer


@pytest.mark.parametrize("delay_s", [10, -1e-3, np.nan, "x"])
def test_a_delay_that_is_none_is_refused(delay_s):
    with pytest.raises(SettingError, match="delay_s"):
        Controller(ROBOT, Limits(ROBOT), delay_s=delay_s)
