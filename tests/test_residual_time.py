"""Neither the rounding of time stamps nor a clock that is set spoils an estimate unseen."""

import numpy as np
import pytest
from guarded_sensor import signals

from residual import VirtualForceSensor


def run(robot, stamps_s, *, with_velocity=True):
    """Estimates of a sensor that is tared after two seconds."""
    q, dq, tau = signals(robot, 3.0)
    steps = np.diff(stamps_s, prepend=stamps_s[0] - 1e-3).tolist()
    sensor, found = VirtualForceSensor(robot), []
    for k, dt_s in enumerate(steps):
        if k == 2000:
            sensor.tare()
        found.append(sensor.update(q[k], dq[k] if with_velocity else None, tau[k], dt_s))
    return found


@pytest.mark.parametrize("with_velocity", [True, False])
def test_rounding_of_time_stamps_decides_nothing(lwr, with_velocity):
    ticks = np.arange(3000)
    exact = run(lwr, ticks / 1000, with_velocity=with_velocity)
    for stamps_s in (ticks * 1e-3, np.cumsum(np.full(3000, 1e-3)), 1.7e9 + ticks / 1000):
        rounded = run(lwr, stamps_s, with_velocity=with_velocity)
        assert [e.status for e in rounded] == [e.status for e in exact]
        axial = np.array([(a.axial, b.axial) for a, b in zip(rounded, exact, strict=True)])
        assert np.abs(np.diff(axial[2000:])).max() < 1e-4
