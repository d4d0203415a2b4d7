"""A snapshot is taken back only by a sensor that would have made the same one."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from guarded_sensor import feed, tared

from residual import DEFAULT, JointFriction, SnapshotError, VirtualForceSensor
from residual.snapshot import robot_digest, settings_text
from urdf import SerialJoint, build_serial_robot

LINK = np.array([1.0, 0.0, 0.0, 0.1, 0.02, 0.0, 0.02, 0.0, 0.0, 0.02])


def arm(axis=(0.0, 0.0, 1.0)):
    """Two links, the second joint about the given axis."""
    placement = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
    joints = [
        SerialJoint(name=f"joint_{i}", placement=placement, axis=np.asarray(about), inertia=LINK)
        for i, about in enumerate(((0.0, 1.0, 0.0), axis))
    ]
    return build_serial_robot(joints)


class Rubbing:
    """A friction model of somebody else's, without a text of its own."""

    def __init__(self, viscous):
        self.viscous = viscous

    def torque(self, dq):
        return self.viscous * dq


def with_friction(viscous_7):
    """Settings whose friction differs in the tenth digit of one number among many."""
    viscous = np.full(7, 0.1)
    viscous[6] = viscous_7
    friction = JointFriction(viscous_Nms=viscous, coulomb_Nm=np.full(7, 0.2), offset_Nm=np.zeros(7))
    return replace(DEFAULT, friction=friction)


def test_robots_differ_by_the_axis_of_a_joint_alone():
    assert robot_digest(arm()) == robot_digest(arm())
    digests = {robot_digest(arm(axis)) for axis in ((0, 0, 1), (0, 0, -1), (1, 0, 0), (1, 1e-6, 0))}
    assert len(digests) == 4


def test_a_snapshot_of_an_arm_with_another_axis_is_refused():
    sensor, other = VirtualForceSensor(arm()), VirtualForceSensor(arm((1.0, 0.0, 0.0)))
    with pytest.raises(SnapshotError, match="another robot"):
        other.restore(sensor.snapshot())


@pytest.mark.parametrize(
    ("mine", "equal", "different"),
    [
        (with_friction(0.1), with_friction(0.1), with_friction(0.1 + 1e-10)),
        (
            replace(DEFAULT, friction=Rubbing(0.1)),
            replace(DEFAULT, friction=Rubbing(0.1)),
            replace(DEFAULT, friction=Rubbing(0.2)),
        ),
        (
            replace(DEFAULT, insertion_axis=np.array([0.0, 1e-10, 1.0])),
            replace(DEFAULT, insertion_axis=(0.0, 1e-10, 1.0)),
            replace(DEFAULT, insertion_axis=np.array([0.0, 2e-10, 1.0])),
        ),
    ],
)
def test_settings_are_compared_by_what_they_do_and_in_all_digits(lwr, mine, equal, different):
    kept = VirtualForceSensor(lwr, mine).snapshot()
    VirtualForceSensor(lwr, equal).restore(kept)
    with pytest.raises(SnapshotError, match="other settings"):
        VirtualForceSensor(lwr, different).restore(kept)


def test_every_setting_is_named():
    text = settings_text(DEFAULT, 7)
    assert all(f"{name}=" in text for name in DEFAULT.__slots__)
    assert "friction=None" in text


def test_a_damaged_snapshot_leaves_a_running_sensor_as_it_was(lwr):
    (sensor, rows), (twin, _) = tared(lwr, more=0.2), tared(lwr, more=0.2)
    state = sensor.snapshot()
    for damaged in (
        state._replace(offset=replace(state.offset, recorder=None)),
        state._replace(weights=state.weights._replace(variance_N2=-1.0)),
        state._replace(torque_covariance=-np.eye(7)),
        state._replace(monitor=None),
    ):
        with pytest.raises(SnapshotError, match="damaged"):
            sensor.restore(damaged)
    for ours, theirs in zip(feed(sensor, rows), feed(twin, rows), strict=True):
        assert (ours.axial, ours.axial_std, ours.status) == (theirs.axial, theirs.axial_std, "ok")
