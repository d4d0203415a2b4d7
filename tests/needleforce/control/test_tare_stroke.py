"""The stroke with a swivel of the elbow before a tare."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from groundtruth.rig_arm import SimulatedArm
from needleforce import InsertionSession
from needleforce.control import ControlError, Limits, SettingError
from needleforce.control.tare_stroke import (
    StrokeState,
    TareMotion,
    TareStroke,
    tare_with_stroke,
)
from needleforce.control.tasks import ToolState
from residual import TareError
from urdf import NeedleTool, load_example, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = np.array([0.2, 0.5, 0.3, -1.5, -0.2, 1.0, 0.1])
QUICK = TareMotion(stroke_m=0.03, leg_s=1.5, swivel_rad=math.radians(12.0), swings=2)
DT_s = 2e-3


class IdealArm:
    """An arm whose joints do what they are sent; it reports no contact.

    Args:
        robot: Its model.
        home_rad: Where it begins.
        held_from: Sample from which on it does not move any more.
        refuses_from: Sample from which on it refuses commands.
        waits_until: Sample until which it refuses them.
    """

    def __init__(
        self, robot, home_rad, *, held_from=10**9, refuses_from=10**9, waits_until=0
    ):
        self.robot = robot
        self.positions_rad = [np.array(home_rad)]
        self._held_from = held_from
        self._refuses_from = refuses_from
        self._waits_until = waits_until
        self._command_rad_s = np.zeros(robot.nv)

    def __iter__(self):
        rng = np.random.default_rng(0)
        for count in range(20_000):
            self._count = count
            yield SimpleNamespace(
                q_rad=self.positions_rad[-1],
                dq_rad_s=self._command_rad_s,
                tau_Nm=0.02 * rng.standard_normal(self.robot.nv),
                dt_s=DT_s,
            )

    def send(self, dq_rad_s):
        is_accepted = self._waits_until <= self._count < self._refuses_from
        is_moving = is_accepted and self._count < self._held_from
        self._command_rad_s = np.array(dq_rad_s) * is_moving
        self.positions_rad.append(self.positions_rad[-1] + DT_s * self._command_rad_s)
        return is_accepted


def make_stroke(arm, motion=QUICK, limits=None):
    """Run the motion on an arm to its end, and return it."""
    stroke = TareStroke(arm.robot, limits or Limits(arm.robot), motion)
    for sample in arm:
        command = stroke.update(sample)
        stroke.note_sent(command, is_accepted=arm.send(command.dq_rad_s))
        if stroke.is_over and not command.dq_rad_s.any():
            break
    return stroke


def tip_course(arm):
    """Return the tip's way along and across the needle, relative to its start."""
    tool = ToolState(arm.robot)
    tool.update(arm.positions_rad[0])
    start_m = tool.tip_m
    axis = tool.axis
    along_m = []
    across_m = []
    for q_rad in arm.positions_rad:
        tool.update(q_rad)
        moved_m = tool.tip_m - start_m
        along_m.append(axis @ moved_m)
        across_m.append(np.linalg.norm(moved_m - along_m[-1] * axis))
    return np.array(along_m), np.array(across_m)


def test_the_tip_strokes_back_on_its_line_while_the_elbow_swings():
    arm = IdealArm(ROBOT, HOME_rad)

    stroke = make_stroke(arm)

    assert stroke.state is StrokeState.DONE
    along_m, across_m = tip_course(arm)
    assert along_m.min() == pytest.approx(-0.03, abs=5e-4)
    assert along_m.max() < 1e-4  # it never goes further in than it was
    assert along_m[-1] == pytest.approx(0.0, abs=1e-4)
    assert across_m.max() < 2e-4
    plain = IdealArm(ROBOT, HOME_rad)
    make_stroke(plain, QUICK._replace(swings=0))
    swung_rad = np.array(arm.positions_rad)
    beside_rad = np.ptp(swung_rad, axis=0) - np.ptp(plain.positions_rad, axis=0)
    assert beside_rad.max() == pytest.approx(math.radians(12.0), rel=0.2)
    assert np.abs(swung_rad[-1] - HOME_rad).max() < 5e-3


def test_an_arm_of_six_joints_makes_the_plain_stroke():
    robot = load_example("ur10e")
    home_rad = np.array([0.0, -1.2, 1.6, -1.9, -1.57, 0.0])
    arm = IdealArm(robot, home_rad)

    assert make_stroke(arm).state is StrokeState.DONE

    along_m, across_m = tip_course(arm)
    assert along_m.min() == pytest.approx(-0.03, abs=5e-4)
    assert across_m.max() < 2e-4


def test_the_elbow_swings_to_the_side_with_more_room():
    upper = ROBOT.position_upper_rad[2]
    lower = ROBOT.position_lower_rad[2]
    near_upper = HOME_rad.copy()
    near_upper[2] = upper - 0.1
    near_lower = HOME_rad.copy()
    near_lower[2] = lower + 0.1
    for home_rad in (near_upper, near_lower):
        arm = IdealArm(ROBOT, home_rad)
        assert make_stroke(arm).state is StrokeState.DONE
        third_rad = np.array(arm.positions_rad)[:, 2]
        assert third_rad.max() < upper
        assert third_rad.min() > lower


def test_the_limits_of_the_joints_hold():
    limits = Limits(ROBOT, velocity_rad_s=0.2, acceleration_rad_s2=1.0)
    arm = IdealArm(ROBOT, HOME_rad)

    make_stroke(arm, limits=limits)

    speeds_rad_s = np.diff(arm.positions_rad, axis=0) / DT_s
    assert 0.1 < np.abs(speeds_rad_s).max() <= 0.2 + 1e-6


@pytest.mark.parametrize(
    ("how", "match"),
    [
        ({"held_from": 600}, "off its course"),
        ({"refuses_from": 600}, "refused a command"),
        ({"waits_until": 10**9}, "took no command in 30 s"),
    ],
)
def test_a_motion_that_fails_says_why_and_ends_at_rest(how, match):
    arm = IdealArm(ROBOT, HOME_rad, **how)

    stroke = make_stroke(arm)

    assert stroke.state is StrokeState.FAILED
    assert match in stroke.reason
    assert len(arm.positions_rad) < 20_000


def test_a_swivel_without_room_names_the_joint():
    home_rad = HOME_rad.copy()
    home_rad[3] = ROBOT.position_lower_rad[3] + 0.03
    stroke = make_stroke(IdealArm(ROBOT, home_rad))

    assert stroke.state is StrokeState.FAILED
    assert ROBOT.joint_names[3] in stroke.reason


@pytest.mark.parametrize(
    "change",
    [{"stroke_m": 0.0}, {"leg_s": -1.0}, {"swings": -1}, {"swings": 2.5}],
)
def test_a_motion_that_cannot_be_is_refused(change):
    with pytest.raises(SettingError, match=next(iter(change))):
        TareStroke(ROBOT, Limits(ROBOT), QUICK._replace(**change))


@pytest.mark.slow
def test_one_call_moves_the_arm_and_tares():
    arm = SimulatedArm(plant="clean", seed=3, duration_s=20.0)
    session = InsertionSession(arm.robot)
    statuses = []

    tare_with_stroke(
        arm,
        session,
        Limits(arm.robot),
        QUICK,
        watch=lambda estimate: statuses.append(estimate.status),
    )

    assert session.tared
    assert len(statuses) > 3000
    estimate = None
    for _, sample in zip(range(200), arm, strict=False):
        arm.send(np.zeros(7))
        estimate = session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
    assert abs(estimate.wrench.axial) < 2.0 * estimate.wrench.axial_std
    assert estimate.wrench.axial_std < 0.5


@pytest.mark.slow
def test_a_motion_that_is_refused_raises_and_tares_nothing():
    arm = IdealArm(ROBOT, HOME_rad)  # reports no torques, though gravity acts
    session = InsertionSession(ROBOT)
    with pytest.raises(TareError, match="N along the needle"):
        tare_with_stroke(arm, session, Limits(ROBOT), QUICK)
    assert not session.tared

    arm = IdealArm(ROBOT, HOME_rad, held_from=600)
    with pytest.raises(ControlError, match="no tare: the tip is"):
        tare_with_stroke(arm, InsertionSession(ROBOT), Limits(ROBOT), QUICK)
