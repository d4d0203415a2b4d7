"""A force/torque sensor beside a session: its axial force, and the difference."""

import math
from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from residual import Status, WrenchEstimate
from residual.tool_kinematics import unit_axis

if TYPE_CHECKING:
    from needleforce.devices import NetFT


class ReferenceForce:
    """The force that a sensor between flange and tool reads, beside the estimated one.

    Its zero is set with the tare and holds the weight of the tool: a needle that leans
    more or less afterwards reads otherwise. The lag of the estimate counts as
    difference.

    Args:
        sensor: Read once per tick.
        axis: Direction of insertion in the sensor's axes, shape (3,), not all zero.

    Attributes:
        axial_N: Resistance to insertion that it reads, positive where tissue pushes
            back; NaN before `zero`, and where nothing has come for 100 ticks.
        count: Ticks that were compared: those with a reading and a valid estimate.
    """

    def __init__(self, sensor: "NetFT", axis: ArrayLike = (0.0, 0.0, 1.0)) -> None:
        # Number of readings whose mean is the zero: half a second at 1 kHz
        zero_readings = 500
        self._axis = unit_axis(axis)
        self._sensor = sensor
        self._readings = deque[float](maxlen=zero_readings)
        self._zero_N = math.nan
        self.axial_N = math.nan
        self._squares_N2 = 0.0
        self.count = 0
        self._silent_ticks = 0  # since the last reading

    @property
    def rms_N(self) -> float:
        """RMS of estimate less reading since the zero [N]; NaN before any."""
        return math.sqrt(self._squares_N2 / self.count) if self.count else math.nan

    def zero(self) -> bool:
        """Take the mean of the latest readings for no force; False without any."""
        self._zero_N = float(np.mean(self._readings)) if self._readings else math.nan
        self._squares_N2 = 0.0
        self.count = 0
        return bool(self._readings)

    def update(self, wrench: WrenchEstimate) -> None:
        """Read the sensor, and compare with the session's estimate of the same tick."""
        # Ticks without a reading after which the last one is too old to be shown
        max_silent_ticks = 100
        reading = self._sensor.read()
        self._silent_ticks = self._silent_ticks + 1 if reading is None else 0
        if reading is not None:
            resistance_N = -float(self._axis.dot(reading[:3]))
            self._readings.append(resistance_N)
            self.axial_N = resistance_N - self._zero_N
            difference_N = wrench.axial - self.axial_N
            if wrench.status is Status.OK and math.isfinite(difference_N):
                self._squares_N2 += difference_N**2
                self.count += 1
        elif self._silent_ticks >= max_silent_ticks:
            self.axial_N = math.nan
            self._readings.clear()  # the posture may have changed since
