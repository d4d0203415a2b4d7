"""The stroke before a tare."""

import numpy as np
import pytest

from needleforce.control import ControlError, Limits, SettingError, tare_with_stroke
from residual import TareError
from tests.needleforce.control.late_arm import LateArm
from tests.needleforce.control.managed_session import Sensor
from urdf import NeedleTool, load_example, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = np.array([0.2, 0.5, 0.3, -1.5, -0.2, 1.0, 0.1])
UR10E_rad = np.array([0.0, -1.2, 1.6, -1.9, -1.57, 0.0])
QUICK = {"stroke_m": 0.03, "leg_s": 1.5}
DT_s = 2e-3


def make_arm(robot=ROBOT, home_rad=HOME_rad, **faults):
    return LateArm(robot, home_rad, dt_s=DT_s, **faults)


def tare(arm, limits=None, *, refuses=False, **motion):
    session = Sensor()
    session.refuses = refuses
    tare_with_stroke(arm, session, limits or Limits(arm.robot), **QUICK | motion)
    return session.tared


@pytest.mark.parametrize(
    ("robot", "home_rad"),
    [(ROBOT, HOME_rad), (load_example("ur10e", payload=NeedleTool()), UR10E_rad)],
)
def test_the_tip_strokes_back_on_its_line_and_returns(robot, home_rad):
    arm = make_arm(robot, home_rad)
    axis = arm.tool.axis
    assert tare(arm)

    moved_m = np.array(arm.tips_m) - arm.tips_m[0]
    along_m = moved_m @ axis
    across_m = np.linalg.norm(moved_m - np.outer(along_m, axis), axis=1)
    assert DT_s * len(along_m) == pytest.approx(3.0 + 2 * 0.5, abs=0.02)
    assert along_m.min() == pytest.approx(-0.03, abs=5e-4)
    assert DT_s * np.argmin(along_m) == pytest.approx(0.5 + 1.5, abs=0.05)
    assert along_m.max() < 1e-4  # it never goes further in than it was
    assert along_m[-1] == pytest.approx(0.0, abs=1e-4)
    assert across_m.max() < 2e-4
    assert np.abs(arm.positions_rad[-1] - home_rad).max() < 5e-3


def test_the_limits_of_the_joints_hold():
    arm = make_arm()
    tare(arm, Limits(ROBOT, velocity_rad_s=0.02, acceleration_rad_s2=1.0))

    speeds_rad_s = np.diff(arm.positions_rad, axis=0) / DT_s
    assert 0.015 < np.abs(speeds_rad_s).max() <= 0.02 + 1e-6


@pytest.mark.parametrize(
    ("faults", "match"),
    [
        ({"held_from": 600}, "commanded|follow"),
        ({"refused": range(600, 40_000)}, "refused"),
        ({"refused": range(40_000)}, "30 s"),
        ({"ends_at": 600}, "ended"),
    ],
)
def test_a_motion_that_fails_says_why_and_ends_at_rest(faults, match):
    arm = make_arm(**faults)
    with pytest.raises(ControlError, match=match):
        tare(arm)
    assert not arm.sent[-1].any() or "held_from" not in faults


def test_an_arm_may_take_its_time_to_accept_commands():
    assert tare(make_arm(refused=range(2000)))


@pytest.mark.parametrize("change", [{"stroke_m": 0.0}, {"leg_s": -1.0}])
def test_a_motion_that_cannot_be_is_refused(change):
    with pytest.raises(SettingError, match=next(iter(change))):
        tare(make_arm(), **change)


def test_a_tare_that_is_refused_raises():
    arm = make_arm()
    with pytest.raises(TareError, match="contact"):
        tare(arm, refuses=True)
    assert not arm.sent[-1].any()
