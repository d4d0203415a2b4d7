"""Commands of five arms about an entry, shortened: within what each arm accepts."""

import numpy as np
import pytest

from benchmarks.control import limits
from benchmarks.control.limits import ConeRun, count_excess
from benchmarks.jobs import Job
from needleforce.devices.arm_limits import FR3


@pytest.mark.parametrize("arm", ["lwr", "fr3", "fer", "ur5e", "iiwa14"])
def test_no_command_is_above_what_the_arm_accepts(monkeypatch, arm):
    monkeypatch.setattr(limits, "DURATION_s", 0.4)
    job = Job(benchmark="control-limits", case=f"{arm} 10ms quick", plant="clean")
    figures = limits.run(job)
    values = {item.metric: item.value for item in figures}

    for limit in ("position", "speed", "acceleration", "jerk"):
        assert values[f"ticks_above_{limit}_limit"] == 0
    assert values["rcm_error_max_mm"] < 0.2


def test_cycles_above_a_limit_are_counted():
    commands_rad_s = np.zeros((20, 7))
    commands_rad_s[5:9, 2] = 3.0  # 0.38 rad/s too fast, reached and left in one cycle
    robot = limits.ARMS["lwr"].load()
    positions_rad = np.zeros((20, 7))
    positions_rad[3, 1] = robot.position_upper_rad[1] + 1e-3
    run = ConeRun(
        robot,
        positions_rad,
        commands_rad_s,
        errors_m=np.zeros(20),
        taken_us=np.ones(20),
        is_limited=np.zeros(20, bool),
    )

    assert count_excess(run, FR3) == {
        "speed": 4,
        "acceleration": 2,
        "jerk": 4,
        "position": 1,
    }
