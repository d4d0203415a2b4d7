"""The delay from command to motion, and the gain that it allows."""

import numpy as np
import pytest

from needleforce.control import ControlError, Delay, Limits, find_safe_gain, measure_lag
from tests.needleforce.control.late_arm import DT_s, LateArm
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = [0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]


def measure(cycles, **faults):
    """Return an arm that was probed, and its delays."""
    arm = LateArm(ROBOT, HOME_rad, cycles, **{"noise_rad": 1e-5} | faults)
    return arm, measure_lag(arm, ROBOT, Limits(ROBOT), 2.0)


@pytest.mark.parametrize("cycles", [0, 2, 10, 37])
@pytest.mark.parametrize("lost", [0.0, 0.02])
def test_an_injected_delay_is_measured(cycles, lost):
    arm, delays = measure(cycles, lost=lost, refused=range(200))
    for delay in delays:
        assert delay.cycle_s == pytest.approx(DT_s)
        assert delay.delay_s == pytest.approx(cycles * DT_s, abs=1e-3)
        assert 0.0 < delay.std_s < 1e-3
        assert delay.followed == pytest.approx(1.0, abs=0.02)

    aside_m = np.linalg.norm(np.array(arm.tips_m) - arm.tips_m[0], axis=1)
    assert 0.1e-3 < aside_m.max() < 5e-3
    assert not arm.sent[-1].any()


def test_the_tip_of_a_long_needle_moves_by_no_more_than_5_mm():
    """By the sum of what the single joints move it."""
    robot = load_lwr(payload=NeedleTool(needle_length_m=2.5))
    arm = LateArm(robot, HOME_rad, 5)
    reach_m_per_rad = np.linalg.norm(arm.tool.jacobian[:3], axis=0).sum()
    measure_lag(arm, robot, Limits(robot), 2.0)
    turned_rad = np.abs(np.array(arm.positions_rad) - HOME_rad).max()

    assert turned_rad * reach_m_per_rad == pytest.approx(5e-3, rel=0.05)


@pytest.mark.parametrize(
    ("faults", "match"),
    [
        ({"refused": range(500, 40_000)}, "refused"),
        ({"refused": range(40_000)}, "30 s"),
        ({"push_rad": 0.1}, "not commanded"),
        ({"noise_rad": 1e-3}, "follow"),
        ({"ends_at": 1000}, "ended"),
    ],
)
def test_what_cannot_be_measured_says_why(faults, match):
    with pytest.raises(ControlError, match=match):
        measure(5, **faults)


def is_stable(gain_per_s, cycles):
    """Return whether q' = -K q, with held commands and a delay, decays."""
    positions = [1.0] * (cycles + 1)
    for _ in range(20_000):
        positions.append(positions[-1] - DT_s * gain_per_s * positions[-1 - cycles])
    return abs(positions[-1]) < 1e-2


@pytest.mark.parametrize("cycles", [2, 40])
def test_the_gain_of_instability_is_that_of_the_loop(cycles):
    gain = find_safe_gain(Delay(cycles * DT_s, 0.0, 1.0, DT_s))
    doubtful = find_safe_gain(Delay(cycles * DT_s, 0.5 * cycles * DT_s, 1.0, DT_s))

    assert is_stable(0.98 * gain.unstable_per_s, cycles)
    assert not is_stable(1.02 * gain.unstable_per_s, cycles)
    assert gain.safe_per_s == pytest.approx(gain.unstable_per_s * 35.0 / 90.0)
    late = (2.0 * cycles + 0.5) / (cycles + 0.5)
    assert doubtful.safe_per_s == pytest.approx(gain.safe_per_s / late)
