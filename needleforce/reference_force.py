"""A force/torque sensor beside a session: the axial force it reads, and how far the two differ."""

import math
from collections import deque
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual import Status, WrenchEstimate
from residual.tool_kinematics import unit_axis

ZERO_READINGS = 500
"""The zero is the mean of so many readings before it: half a second at 1 kHz."""
LOST_TICKS = 100  # Without a reading: the last one is then too old to be shown


class ForceSensor(Protocol):
    """A sensor between flange and tool, as `needleforce.devices.NetFT`."""

    def read(self) -> NDArray[np.float64] | None:
        """The newest force [N] and torque [Nm], shape (6,), in its axes; None if nothing came."""
        ...


class ReferenceForce:
    """What a sensor between flange and tool says of the force that a session estimates.

    Its zero is set once, with the tare. The weight of the tool is part of that: a needle that leans
    more or less afterwards reads otherwise. The estimate is some hundredths of a second late (the
    observer's lag); that counts as difference.

    Args:
        sensor: Read once per tick.
        axis: Direction of insertion in the sensor's axes, shape (3,).

    Attributes:
        axial_N: Resistance to insertion that it reads, positive where tissue pushes back; NaN
            before `zero`, and where nothing has come for 100 ticks.
        count: Ticks that were compared: those with a reading and a valid estimate.

    Raises:
        residual.ConfigurationError: For an axis that is none.
    """

    def __init__(self, sensor: ForceSensor, axis: ArrayLike = (0.0, 0.0, 1.0)) -> None:
        self._sensor, self._axis = sensor, unit_axis(axis)
        self._readings = deque[float](maxlen=ZERO_READINGS)
        self._zero_N = self.axial_N = math.nan
        self._squares_N2, self.count, self._silent = 0.0, 0, 0

    @property
    def is_zeroed(self) -> bool:
        """Whether there is a zero."""
        return not math.isnan(self._zero_N)

    @property
    def rms_N(self) -> float:
        """Root mean square of estimate less reading since the zero [N]; NaN before any."""
        return math.sqrt(self._squares_N2 / self.count) if self.count else math.nan

    def zero(self) -> None:
        """Take the mean of the latest readings for no force; nothing is compared yet."""
        if self._readings:
            self._zero_N = float(np.mean(self._readings))
            self._squares_N2, self.count = 0.0, 0

    def update(self, wrench: WrenchEstimate) -> None:
        """Read the sensor, and compare with the session's estimate of the same tick."""
        reading = self._sensor.read()
        if reading is None:
            self._silent += 1
            if self._silent >= LOST_TICKS:
                self.axial_N = math.nan
            return
        self._silent = 0
        resistance_N = -float(self._axis.dot(reading[:3]))
        self._readings.append(resistance_N)
        self.axial_N = resistance_N - self._zero_N
        if self.is_zeroed and wrench.status is Status.OK:
            self._squares_N2 += (wrench.axial - self.axial_N) ** 2
            self.count += 1
