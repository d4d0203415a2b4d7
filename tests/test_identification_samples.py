"""Bad samples are reported and skipped; good ones that follow are not harmed."""

import math

import numpy as np
import pytest

from identification.errors import InvalidConfigError, InvalidSnapshotError
from identification.identifier import Identifier
from identification.paper_config import PAPER, PAPER_KV
from identification.sample_check import CheckConfig, CheckState, SampleStatus, check_step

GOOD = (0.001, 0.002, 0.1, 1e-3)


@pytest.mark.parametrize(
    ("values", "status"),
    [
        ((math.nan, 0.002, 0.1, 1e-3), SampleStatus.NOT_FINITE),
        ((0.001, math.inf, 0.1, 1e-3), SampleStatus.NOT_FINITE),
        ((0.001, 0.002, math.nan, 1e-3), SampleStatus.NOT_FINITE),
        ((0.001, 0.002, 0.1, math.nan), SampleStatus.NOT_FINITE),
        ((0.001, 0.002, 0.1, 0.0), SampleStatus.TIME_NOT_FORWARD),
        ((0.001, 0.002, 0.1, -1e-3), SampleStatus.TIME_NOT_FORWARD),
        ((0.001, 0.002, [0.1], 1e-3), SampleStatus.NOT_A_SCALAR),
        ((0.001, np.zeros(3), 0.1, 1e-3), SampleStatus.NOT_A_SCALAR),
        ((0.001, None, 0.1, 1e-3), SampleStatus.NOT_A_SCALAR),
        ((0.001, "fast", 0.1, 1e-3), SampleStatus.NOT_A_SCALAR),
        ((0.001, 0.002, 1000.0, 1e-3), SampleStatus.FORCE_RANGE),
        ((0.1, 0.002, 0.1, 1e-3), SampleStatus.DEPTH_JUMP),
    ],
)
def test_bad_sample_is_reported_and_not_absorbed(values, status):
    identifier = Identifier(PAPER)
    before = identifier.update(*GOOD)
    state = identifier.snapshot().state
    after = identifier.update(*values)
    assert after.status is status
    assert identifier.snapshot().state == state
    assert after.enhanced_force_N == before.enhanced_force_N
    assert math.isfinite(after.time_s)


def test_numpy_scalars_and_integers_are_welcome():
    estimate = Identifier(PAPER).update(np.float32(0.0), np.float64(0.002), 0, np.array(1e-3))
    assert estimate.status is SampleStatus.OK


def test_clock_runs_on_over_bad_forces_and_motion_is_not_called_a_jump():
    identifier = Identifier(PAPER)
    depth, speed = 0.0, 5e-3
    for k in range(1500):
        force = math.nan if 200 <= k < 1200 else 0.1
        place = math.nan if 200 <= k < 1200 else depth
        estimate = identifier.update(place, speed, force, 1e-3)
        depth += speed * 1e-3
        if k == 1200:
            assert estimate.status is SampleStatus.TIME_GAP
    assert estimate.status is SampleStatus.OK
    assert estimate.time_s == pytest.approx(1.5)


def test_a_jump_of_depth_is_removed_for_good():
    check, _, _ = check_step(CheckState(), (0.0, 0.001, 0.0, 1e-3), CheckConfig())
    check, sample, status = check_step(check, (0.05, 0.001, 0.0, 1e-3), CheckConfig())
    assert status is SampleStatus.DEPTH_JUMP
    assert sample is None
    check, sample, status = check_step(check, (0.050001, 0.001, 0.0, 1e-3), CheckConfig())
    assert status is SampleStatus.OK
    assert sample.depth_m == pytest.approx(2e-6)


def test_speed_of_the_wrong_sign_is_called_out():
    check, seen = CheckState(), set()
    for k in range(400):
        check, _, status = check_step(check, (2e-6 * k, -0.002, 0.0, 1e-3), CheckConfig())
        seen.add(status)
    assert status is SampleStatus.SPEED_SIGN
    assert SampleStatus.DEPTH_JUMP not in seen


@pytest.mark.parametrize("before", [0, 400])
def test_one_speed_says_nothing_of_the_way_through_a_gap(before):
    """13 s of a tare, then a needle that sets out: 0.1 mm/s of noise are no way back of 1.3 mm."""
    check, depth = CheckState(), 0.0
    for _ in range(before):
        check, _, _ = check_step(check, (depth, 0.0, 0.0, 1e-3), CheckConfig())
    for _ in range(13000):
        check, _, _ = check_step(check, (depth, 0.0, math.nan, 1e-3), CheckConfig())
    seen, absorbed_s = [], 0.0
    for k in range(400):
        speed = -1e-4 if k == 0 else 2e-3
        depth += 2e-6
        check, sample, status = check_step(check, (depth, speed, 0.0, 1e-3), CheckConfig())
        seen.append(status)
        absorbed_s += sample.dt_s if sample else 0.0
    assert set(seen[1:]) == {SampleStatus.OK}
    assert seen[0] is (SampleStatus.TIME_GAP if before else SampleStatus.OK)
    assert absorbed_s == pytest.approx(13.4)


def test_check_limits_must_be_positive():
    with pytest.raises(InvalidConfigError, match="gap_s"):
        CheckConfig(gap_s=0.0)


def test_unknown_configuration_and_foreign_snapshots_are_refused():
    with pytest.raises(InvalidConfigError, match="PaperConfig"):
        Identifier(object())
    with pytest.raises(InvalidSnapshotError, match="Snapshot"):
        Identifier(PAPER).restore(Identifier(PAPER_KV).snapshot())
