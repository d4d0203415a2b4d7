"""The comparison with orocos KDL: one robot in both libraries."""

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.insertion.signals import JointSignals
from benchmarks.performance.kdl import (
    KdlAbsentError,
    KdlEstimator,
    PlainEstimator,
    kdl_library,
)
from urdf import NeedleTool, load_lwr

GAIN_per_s = 70.0
PERIOD_s = 1e-3


def pushed(robot, samples=600):
    """Slow motion with an exact model, and a push of 2 N against the needle; its
    true force."""
    t = PERIOD_s * np.arange(samples)
    middle = np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])
    q = middle + 0.1 * np.sin(np.outer(t, np.arange(1.0, 8.0)))
    dq = np.gradient(q, PERIOD_s, axis=0)
    ddq = np.gradient(dq, PERIOD_s, axis=0)
    force_N = np.where(t > 0.1, 2.0, 0.0)
    place = (robot.tool_frame_id, pin.ReferenceFrame.LOCAL)
    data = robot.create_data()
    tau = [
        pin.rnea(robot.model, data, *row)
        + force * pin.computeFrameJacobian(robot.model, data, row[0], *place)[2]
        for *row, force in zip(q, dq, ddq, force_N, strict=True)
    ]
    return JointSignals(t_s=t, q_rad=q, dq_rad_s=dq, tau_Nm=np.array(tau)), force_N


@pytest.mark.slow
def test_both_libraries_see_the_same_robot():
    try:
        library = kdl_library()
    except KdlAbsentError as error:
        pytest.skip(str(error))
    robot = load_lwr(payload=NeedleTool())
    signals, force_N = pushed(robot)
    kdl = KdlEstimator(library, robot, signals, GAIN_per_s)
    ours = PlainEstimator(robot, signals, GAIN_per_s)
    for k in range(len(force_N)):
        kdl(k)
        ours(k)
        if k >= 300:
            assert ours.axial_N == pytest.approx(force_N[k], abs=0.02)
            assert kdl.axial_N == pytest.approx(force_N[k], abs=0.1)


def test_without_a_compiler_there_is_no_comparison(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(KdlAbsentError, match="liborocos-kdl-dev"):
        kdl_library()
