"""The delay from command to motion, and the gain that it allows."""

import numpy as np
import pytest

from needleforce.control import ControlError, Limits
from needleforce.control.lag import Delay, find_safe_gain, measure_lag
from tests.needleforce.control.late_arm import DT_s, LateArm
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = [0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0]


class ProbedArm(LateArm):
    """An arm that is late, noisy, loses samples, or does not do what it should.

    Args:
        late_cycles: From a command to the motion.
        home_rad: Where it begins.
        noise_rad: Of its positions.
        lost: Fraction of samples that are lost.
        refused: Which commands it refuses.
        push_rad: By so much something moves it after a second.
        ends_at: After so many samples the connection ends.
    """

    def __init__(
        self,
        late_cycles,
        *,
        home_rad=HOME_rad,
        noise_rad=1e-5,
        lost=0.0,
        refused=(),
        push_rad=0.0,
        ends_at=40_000,
    ):
        super().__init__(ROBOT, home_rad, late_cycles)
        self.tips_m = []
        self._noise_rad = noise_rad
        self._lost = lost
        self._refused = refused
        self._push_rad = push_rad
        self._ends_at = ends_at

    def __iter__(self):
        rng = np.random.default_rng(1000)
        self.dq_rad_s = np.zeros(7)
        dt_s = DT_s
        for count in range(self._ends_at):
            self._count = count
            if count:
                self.move(self.dq_rad_s)
            if rng.random() < self._lost:
                dt_s += DT_s
                continue
            sample = self.sample(dt_s)
            noise_rad = self._noise_rad * rng.standard_normal(7)
            sample.q_rad = self.q_rad + noise_rad + self._push_rad * (count > 1000)
            yield sample
            dt_s = DT_s

    def send(self, dq_rad_s):
        is_accepted = self._count not in self._refused
        self.dq_rad_s = is_accepted * np.array(dq_rad_s)
        self.tips_m.append(self.tool.tip_m)
        return is_accepted


@pytest.mark.parametrize("cycles", [0, 2, 10, 37])
@pytest.mark.parametrize("lost", [0.0, 0.02])
def test_an_injected_delay_is_measured(cycles, lost):
    arm = ProbedArm(cycles, lost=lost, refused=range(200))
    for delay in measure_lag(arm, ROBOT, Limits(ROBOT), 2.0):
        assert delay.cycle_s == pytest.approx(DT_s)
        assert delay.delay_s == pytest.approx(cycles * DT_s, abs=1e-3)
        assert 0.0 < delay.std_s < 1e-3
        assert delay.followed == pytest.approx(1.0, abs=0.02)

    aside_m = np.linalg.norm(np.array(arm.tips_m) - arm.tips_m[0], axis=1)
    assert 0.1e-3 < aside_m.max() < 5e-3
    assert not arm.dq_rad_s.any()


@pytest.mark.parametrize(
    ("how", "match"),
    [
        ({"refused": range(500, 40_000)}, "refused"),
        ({"refused": range(40_000)}, "30 s"),
        ({"push_rad": 0.1}, "not commanded"),
        ({"noise_rad": 1e-3}, "follow"),
        ({"ends_at": 1000}, "ended"),
    ],
)
def test_what_cannot_be_measured_says_why(how, match):
    arm = ProbedArm(5, **how)
    with pytest.raises(ControlError, match=match):
        measure_lag(arm, ROBOT, Limits(ROBOT), 2.0)
    assert not arm.dq_rad_s.any() or "ends_at" in how


def is_stable(gain_per_s, cycles):
    """Return whether q' = -K q, with held commands and a delay, decays."""
    positions = [1.0] * (cycles + 1)
    for _ in range(20_000):
        positions.append(positions[-1] - DT_s * gain_per_s * positions[-1 - cycles])
        if abs(positions[-1]) > 1e3:
            return False
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
