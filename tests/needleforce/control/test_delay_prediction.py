"""Positions predicted over the delay of an arm."""

from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.control import (
    Controller,
    Limits,
    Posture,
    RemoteCentre,
    SettingError,
    TipVelocity,
)
from needleforce.control.delay_prediction import DelayPrediction
from needleforce.control.tasks import ToolState
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
    cycles = np.arange(1)
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

        predicted_rad = measured_rad + prediction.find_motion_ahead()
        assert predicted_rad == pytest.approx(commanded_rad[-1], abs=1e-12)

        velocity = rng.standard_normal(2)

    prediction.reset()

    assert not prediction.find_motion_ahead().any()


def test_commands_are_remembered_while_nobody_asks():
    """As while the measured positions are not finite."""
    prediction = DelayPrediction(1, 3.0 * CYCLE_s)
    for cycle in range(1000):
        prediction.note_command(np.array([float(cycle)]), CYCLE_s)

    ahead_rad = prediction.find_motion_ahead()

    assert ahead_rad == pytest.approx((997.0 + 998.0 + 999.0) * CYCLE_s)


def test_a_long_pause_leaves_the_last_command_only():
    prediction = DelayPrediction(1, 0.01)
    prediction.note_command(np.array([0.2]), 1e300)

    assert prediction.find_motion_ahead() == pytest.approx(0.002)


def turn_about_entry(delay_s, delay_cycles, gain_per_s=30.0):
    """Tilt the needle in 0.5 s about an entry 10 mm behind its tip; return the error
    of its axis [m] and its tilt [rad], of every cycle."""
    limits = Limits.of_arm(ROBOT, "lwr", speed_rad_s=10.0, tip_m_s=None)
    control = Controller(ROBOT, limits, delay_s=delay_s)
    truth = ToolState(ROBOT)
    q_rad = HOME_rad.copy()
    truth.update(q_rad)
    axes = truth.rotation
    entry_m = truth.tip_m - 0.01 * truth.axis
    tip = TipVelocity((0.0, 0.0, 0.0), truth.tip_m, gain_per_s=10.0)
    tasks = [RemoteCentre(entry_m, gain_per_s), tip, Posture(HOME_rad)]
    waiting = [np.zeros(7)] * delay_cycles
    errors_m = []
    tilts_rad = []
    for k in range(1500):
        tilt_rad = 0.35 * min(k / 500, 1.0)
        tip.goal_m = entry_m + 0.01 * axes @ (np.sin(tilt_rad), 0.0, np.cos(tilt_rad))
        sample = SimpleNamespace(q_rad=q_rad, dt_s=CYCLE_s)
        waiting.append(control.update(sample, tasks).dq_rad_s)
        q_rad = q_rad + CYCLE_s * waiting.pop(0)
        truth.update(q_rad)
        errors_m.append(np.linalg.norm(np.cross(truth.axis, entry_m - truth.tip_m)))
        tilts_rad.append(np.arccos(min(truth.axis @ axes[:, 2], 1.0)))
    return np.array(errors_m), np.array(tilts_rad)


@pytest.mark.slow
def test_a_known_delay_costs_the_entry_nothing():
    late_m, _ = turn_about_entry(None, 20)
    predicted_m, tilts_rad = turn_about_entry(0.02, 20)

    assert predicted_m.max() < 0.25 * late_m.max()
    # So close behind its tip a needle turns slower than asked: joints have far to go.
    assert 0.2 < tilts_rad[-1] < 0.4


@pytest.mark.parametrize("delay_s", [None, 0.02])
def test_a_wrong_delay_does_not_swing(delay_s):
    """The arm is 10 ms late."""
    errors_m, tilts_rad = turn_about_entry(delay_s, 10)

    assert errors_m[-300:].max() < 5e-6
    assert (np.diff(tilts_rad[-300:]) > -1e-6).all()  # it only comes nearer


def test_a_delay_in_milliseconds_is_refused():
    with pytest.raises(SettingError, match=r"delay_s is 10, expected at most 0\.3"):
        Controller(ROBOT, Limits(ROBOT), delay_s=10)
