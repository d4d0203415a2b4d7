"""The stroke before a tare."""

import numpy as np
import pytest

from groundtruth.rig_arm import SimulatedArm
from needleforce import InsertionSession
from needleforce.control import ControlError, Limits, SettingError, tare_with_stroke
from residual import TareError
from tests.needleforce.control.late_arm import LateArm
from tests.needleforce.control.managed_session import Sensor
from urdf import NeedleTool, load_example, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = np.array([0.2, 0.5, 0.3, -1.5, -0.2, 1.0, 0.1])
QUICK = {"stroke_m": 0.03, "leg_s": 1.5}
DT_s = 2e-3


class FreeArm(LateArm):
    """An arm in free air, whose joints do what they are sent.

    Args:
        robot: Its model.
        home_rad: Where it begins.
        held_from: Sample from which on it does not move any more.
        refuses_from: Sample from which on it refuses commands.
        waits_until: Sample until which it refuses them.
        ends_at: Sample at which the connection ends.
    """

    def __init__(
        self,
        robot=ROBOT,
        home_rad=HOME_rad,
        *,
        held_from=10**9,
        refuses_from=10**9,
        waits_until=0,
        ends_at=20_000,
    ):
        super().__init__(robot, home_rad, dt_s=DT_s)
        self.robot = robot
        self.positions_rad = [self.q_rad]
        self.tips_m = [self.tool.tip_m]
        self.is_still = False
        self._axis = self.tool.axis
        self._limits = (held_from, refuses_from, waits_until)
        self._ends_at = ends_at

    def __iter__(self):
        for count in range(self._ends_at):
            self._count = count
            yield self.sample()

    def send(self, dq_rad_s):
        held_from, refuses_from, waits_until = self._limits
        is_accepted = waits_until <= self._count < refuses_from
        self.is_still = not np.any(dq_rad_s) or not is_accepted
        self.move(np.array(dq_rad_s) * (is_accepted and self._count < held_from))
        self.positions_rad.append(self.q_rad)
        self.tips_m.append(self.tool.tip_m)
        return is_accepted

    def tare(self, limits=None, *, refuses=False, **motion):
        session = Sensor()
        session.refuses = refuses
        limits = limits or Limits(self.robot)
        tare_with_stroke(self, session, limits, **QUICK | motion)
        return session


@pytest.mark.parametrize(
    ("robot", "home_rad"),
    [
        (ROBOT, HOME_rad),
        (
            load_example("ur10e", payload=NeedleTool()),
            np.array([0.0, -1.2, 1.6, -1.9, -1.57, 0.0]),
        ),
    ],
)
def test_the_tip_strokes_back_on_its_line_and_returns(robot, home_rad):
    arm = FreeArm(robot, home_rad)
    assert arm.tare().tared

    moved_m = np.array(arm.tips_m) - arm.tips_m[0]
    along_m = moved_m @ arm._axis
    across_m = np.linalg.norm(moved_m - np.outer(along_m, arm._axis), axis=1)
    assert DT_s * len(along_m) == pytest.approx(3.0 + 2 * 0.5, abs=0.02)
    assert along_m.min() == pytest.approx(-0.03, abs=5e-4)
    assert DT_s * np.argmin(along_m) == pytest.approx(0.5 + 1.5, abs=0.05)
    assert along_m.max() < 1e-4  # it never goes further in than it was
    assert along_m[-1] == pytest.approx(0.0, abs=1e-4)
    assert across_m.max() < 2e-4
    assert np.abs(arm.positions_rad[-1] - home_rad).max() < 5e-3


def test_the_limits_of_the_joints_hold():
    arm = FreeArm()
    arm.tare(Limits(ROBOT, velocity_rad_s=0.02, acceleration_rad_s2=1.0))

    speeds_rad_s = np.diff(arm.positions_rad, axis=0) / DT_s
    assert 0.015 < np.abs(speeds_rad_s).max() <= 0.02 + 1e-6


@pytest.mark.parametrize(
    ("how", "match"),
    [
        ({"held_from": 600}, "commanded|follow"),
        ({"refuses_from": 600}, "refused"),
        ({"waits_until": 10**9}, "30 s"),
        ({"ends_at": 600}, "ended"),
    ],
)
def test_a_motion_that_fails_says_why_and_ends_at_rest(how, match):
    arm = FreeArm(**how)
    with pytest.raises(ControlError, match=match):
        arm.tare()
    if "ends_at" not in how:
        assert arm.is_still


def test_an_arm_may_take_its_time_to_accept_commands():
    assert FreeArm(waits_until=2000).tare().tared


@pytest.mark.parametrize("change", [{"stroke_m": 0.0}, {"leg_s": -1.0}])
def test_a_motion_that_cannot_be_is_refused(change):
    with pytest.raises(SettingError, match=next(iter(change))):
        FreeArm().tare(**change)


def test_a_tare_that_is_refused_raises():
    arm = FreeArm()
    with pytest.raises(TareError, match="contact"):
        arm.tare(refuses=True)
    assert arm.is_still


@pytest.mark.slow
def test_one_call_moves_the_arm_and_tares():
    arm = SimulatedArm(plant="clean", seed=3, duration_s=20.0)
    session = InsertionSession(arm.robot)
    tare_with_stroke(arm, session, Limits(arm.robot), **QUICK)

    assert session.tared
    for _, sample in zip(range(200), arm, strict=False):
        arm.send(np.zeros(7))
        estimate = session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
    assert abs(estimate.wrench.axial) < 2.0 * estimate.wrench.axial_std
    assert estimate.wrench.axial_std < 0.5
