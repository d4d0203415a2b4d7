"""The delay from command to motion, and the gain that it allows."""

from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.control import ControlError, Limits, SettingError
from needleforce.control.lag import (
    ChirpSettings,
    Delay,
    LagProbe,
    ProbeState,
    find_safe_gain,
)
from urdf import NeedleTool, load_lwr

ROBOT = load_lwr(payload=NeedleTool())
HOME_rad = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0])
DT_s = 1e-3
QUICK = ChirpSettings(duration_s=2.0, rest_s=0.35)


def probe_plant(
    cycles, noise_rad=1e-5, home_rad=HOME_rad, lost=0.0, refused_from=10_000, push=0.0
):
    """Probe an arm whose positions follow the commanded ones so many cycles late."""
    rng = np.random.default_rng(1000)
    probe = LagProbe(ROBOT, Limits(ROBOT), QUICK)
    commanded_rad = home_rad.copy()
    line = deque([home_rad] * (cycles + 1), maxlen=cycles + 1)
    step_s = DT_s
    for tick in range(10_000):
        line.append(commanded_rad)
        q_rad = line[0] + noise_rad * rng.standard_normal(7) + push * (tick > 1000)
        sample = SimpleNamespace(q_rad=q_rad, dq_rad_s=None, tau_Nm=None, dt_s=step_s)
        step_s = DT_s
        command = probe.update(sample)
        probe.note_sent(command, is_accepted=tick < refused_from)
        commanded_rad = commanded_rad + DT_s * command.dq_rad_s
        while rng.random() < lost:  # the arm goes on at its last command
            commanded_rad = commanded_rad + DT_s * command.dq_rad_s
            line.append(commanded_rad)
            step_s += DT_s
        if probe.state in (ProbeState.DONE, ProbeState.FAILED):
            break
    return probe


@pytest.mark.parametrize("cycles", [0, 2, 10, 37])
@pytest.mark.parametrize("lost", [0.0, 0.02])
def test_an_injected_delay_is_measured(cycles, lost):
    delays = probe_plant(cycles, lost=lost).measure()

    for delay in delays:
        assert delay.delay_s == pytest.approx(cycles * DT_s, abs=1e-3)
        assert delay.std_s < 1e-3
        assert delay.followed == pytest.approx(1.0, abs=0.02)


def test_the_tip_and_the_joints_stay_near_their_start():
    probe = LagProbe(ROBOT, Limits(ROBOT), QUICK)
    tool = probe._controller.tool
    q_rad = HOME_rad.copy()
    moved_m = []
    moved_rad = []
    for _ in range(2800):
        sample = SimpleNamespace(q_rad=q_rad, dq_rad_s=None, tau_Nm=None, dt_s=DT_s)
        command = probe.update(sample)
        probe.note_sent(command, is_accepted=True)
        moved_m.append(tool.tip_m)
        moved_rad.append(q_rad - HOME_rad)
        q_rad = q_rad + DT_s * command.dq_rad_s
    aside_m = np.linalg.norm(np.array(moved_m) - moved_m[0], axis=1)

    assert 0.5e-3 < aside_m.max() < 5e-3
    assert np.abs(moved_rad).max() < 5e-3
    assert probe.state is ProbeState.DONE
    assert not command.dq_rad_s.any()


def is_stable(gain_per_s, cycles):
    """Return whether q' = -K q, with held commands and a delay, decays."""
    positions = [1.0] * (cycles + 1)
    for _ in range(20_000):
        positions.append(positions[-1] - DT_s * gain_per_s * positions[-1 - cycles])
        if abs(positions[-1]) > 1e3:
            return False
    return abs(positions[-1]) < 1e-2


@pytest.mark.parametrize("cycles", [2, 5, 10, 40])
def test_the_gain_of_instability_is_that_of_the_loop(cycles):
    gain = find_safe_gain(Delay(cycles * DT_s, 0.0, 1.0), DT_s)

    assert is_stable(0.98 * gain.unstable_per_s, cycles)
    assert not is_stable(1.02 * gain.unstable_per_s, cycles)
    assert gain.safe_per_s == pytest.approx(gain.unstable_per_s * 35.0 / 90.0)


def test_a_delay_in_doubt_lowers_the_gain():
    sure = find_safe_gain(Delay(0.01, 0.0, 1.0), DT_s)
    doubtful = find_safe_gain(Delay(0.01, 0.005, 1.0), DT_s)

    assert doubtful.safe_per_s == pytest.approx(sure.safe_per_s * 10.5 / 20.5)


def test_a_margin_out_of_range_is_refused():
    with pytest.raises(SettingError, match="between 0 and 90"):
        find_safe_gain(Delay(0.01, 0.0, 1.0), DT_s, 90.0)


@pytest.mark.parametrize(
    ("how", "match"),
    [
        ({"refused_from": 500}, "refused a command"),
        ({"push": 0.1}, r"lwr_joint_\d is .* off its start"),
        ({"noise_rad": 1e-3}, r"lwr_joint_\d moved by .* of its commands"),
        ({"home_rad": np.array([0.0, 0.5, 0.0, -2.09, 0.0, 1.0, 0.0])}, "from its lim"),
    ],
)
def test_what_cannot_be_measured_says_why(how, match):
    with pytest.raises(ControlError, match=match):
        probe_plant(5, **how).measure()
