"""Manual guidance: the dead zone, the lag, rejected samples and an arm that a hand leads."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from needleforce.control import Guidance, SettingError
from needleforce.control.guidance import LIGHT
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
SIGMA = np.full(7, 0.01)


def velocity(guidance, torque, ticks=1, **how):
    for _ in range(ticks):
        task = guidance.update(np.full(7, torque), SIGMA, 1e-3, **how)
    return task.wish


def test_below_the_dead_zone_it_rests_exactly_and_above_it_is_viscous():
    assert not velocity(Guidance(ROBOT), 0.1, 1000).any()
    expected = (5.0 - 0.002 * ROBOT.effort_limit_Nm - 4.0 * SIGMA) / 10.0
    guidance = Guidance(ROBOT, np.full(7, 10.0))
    assert velocity(guidance, 5.0, 60) == pytest.approx(expected, rel=0.2)
    assert velocity(guidance, 5.0, 3000) == pytest.approx(expected / LIGHT, rel=1e-2)


def test_what_swings_is_damped_and_what_is_led_is_not():
    guidance, speeds = Guidance(ROBOT, np.full(7, 10.0)), []
    for k in range(3000):
        torque = 5.0 * np.sin(2.0 * np.pi * 5e-3 * k)  # 5 Hz
        speeds.append(np.abs(velocity(guidance, torque)).max())
    assert max(speeds[1500:]) < 0.5  # 5 Nm on 10 Nms


def test_it_comes_to_an_exact_rest_when_let_go_also_through_rejected_samples():
    for how in ({}, {"is_valid": False}):
        guidance = Guidance(ROBOT)
        assert velocity(guidance, 5.0, 300).all()
        assert velocity(guidance, np.nan if how else 0.0, 10, **how).all()
        guidance_rest = velocity(guidance, 0.0, 2000)
        assert not guidance_rest.any()


def test_a_sigma_that_grows_under_the_hand_does_not_stop_it():
    guidance = Guidance(ROBOT)
    before = velocity(guidance, 5.0, 300)
    after = guidance.update(np.full(7, 5.0), 100.0 * SIGMA, 1e-3).wish
    assert after == pytest.approx(before, rel=0.05)


@pytest.mark.parametrize("damping", [[1.0] * 6, [0.0] * 7, [np.nan] * 7])
def test_a_damping_that_cannot_work_is_refused(damping):
    with pytest.raises(SettingError, match="damping"):
        Guidance(ROBOT, damping)


def test_the_example_moves_where_it_is_pushed(capsys):
    runpy.run_path(str(Path(__file__).parents[1] / "examples" / "hand_guidance.py"))
    moved_mm = float(capsys.readouterr().out.split()[-2])
    assert 20.0 < moved_mm < 400.0
