"""The whole chain on arms that are not the LWR: free motion, tare, a force at the tool."""

from dataclasses import replace

import numpy as np
import pytest
from residual_signals import BIAS, swing

from residual import DEFAULT, Status, VirtualForceSensor
from urdf import MissingPackageError, example_robot_path, load_urdf

ROBOTS = {
    "panda": (
        "panda_hand_tcp",
        ("panda_finger_joint1", "panda_finger_joint2"),
        [0.1, -0.5, 0.2, -1.8, 0.1, 1.6, 0.3],
    ),
    "ur10": ("tool0", (), [0.2, -1.2, 1.4, -0.5, 1.1, 0.4]),
}


@pytest.fixture(params=ROBOTS)
def arm_and_posture(request):
    tool, locked, posture = ROBOTS[request.param]
    try:
        path = example_robot_path(request.param)
    except MissingPackageError as error:
        pytest.skip(str(error))
    return load_urdf(path, tool_frame=tool, locked_joints=locked), np.array(posture)


@pytest.mark.parametrize("with_velocity", [True, False])
def test_force_is_read_through_a_sensor_bias(arm_and_posture, with_velocity):
    arm, posture = arm_and_posture
    sensor = VirtualForceSensor(arm, replace(DEFAULT, mode="point"))
    force = np.array([2.0, -1.0, 3.0])
    for start, pushed in ((0.0, 0.0 * force), (2.0, force)):
        _, q, dq, tau = swing(
            arm,
            seconds=2.0,
            start=start,
            amplitude=0.03,
            middle=posture,
            force_at_tip_in_base=pushed,
        )
        for k in range(len(q)):
            velocity = dq[k] if with_velocity else None
            estimate = sensor.update(q[k], velocity, tau[k] - BIAS[: arm.nv], 1e-3)
        if not sensor.tared:
            sensor.tare()
    assert estimate.status is Status.OK
    np.testing.assert_allclose(estimate.force, force, atol=0.05)
