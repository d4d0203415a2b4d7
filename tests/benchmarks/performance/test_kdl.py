"""The comparison with orocos KDL: one robot in both libraries."""

import numpy as np
import pytest

from benchmarks.insertion.signals import JointSignals
from benchmarks.performance.kdl import (
    KdlAbsentError,
    KdlEstimator,
    PlainEstimator,
    kdl_library,
)
from tests.residual.residual_signals import pose_of, swing

GAIN_per_s = 70.0


@pytest.mark.slow
def test_both_libraries_see_the_same_robot(lwr):
    try:
        library = kdl_library()
    except KdlAbsentError as error:
        pytest.skip(str(error))
    push_N = np.array([0.5, 0.0, 2.0])
    t_s, q, dq, tau = swing(lwr, seconds=0.5, force_at_tip_in_base=push_N)
    signals = JointSignals(t_s=t_s, q_rad=q, dq_rad_s=dq, tau_Nm=tau)
    kdl = KdlEstimator(library, lwr, signals, GAIN_per_s)
    ours = PlainEstimator(lwr, signals, GAIN_per_s)
    for k in range(len(t_s)):
        kdl(k)
        ours(k)
    axial_N = -push_N @ pose_of(lwr, q[-1]).rotation[:, 2]

    assert ours.axial_N == pytest.approx(axial_N, abs=0.02)
    assert kdl.axial_N == pytest.approx(axial_N, abs=0.1)


def test_without_a_compiler_there_is_no_comparison(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(KdlAbsentError, match="liborocos-kdl-dev"):
        kdl_library()
