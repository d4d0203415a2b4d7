"""What lies outside: arm, force sensor and haptic device, as protocols.

A driver of a real arm, the simulated rig and the tests implement them; nothing here knows which.
SI units; vectors in the axes of the robot's base unless said otherwise.
"""

from collections.abc import Iterator
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from urdf import Robot

Array = NDArray[np.float64]


class ArmReading(Protocol):
    """What an arm reports in one cycle; `ArmSample` is one, any object with these names is."""

    @property
    def dt_s(self) -> float:
        """Time since the previous sample."""
        ...

    @property
    def q_rad(self) -> Array:
        """Joint positions, shape (n,)."""
        ...

    @property
    def dq_rad_s(self) -> Array | None:
        """Joint velocities, shape (n,); None where the interface has none."""
        ...

    @property
    def tau_Nm(self) -> Array:
        """Measured link-side joint torques, shape (n,)."""
        ...


class ArmSample(NamedTuple):
    """The plainest `ArmReading`."""

    dt_s: float
    q_rad: Array
    dq_rad_s: Array | None
    tau_Nm: Array


class Arm(Protocol):
    """An arm that takes joint velocities."""

    @property
    def robot(self) -> Robot:
        """The arm as its user knows it."""
        ...

    def __iter__(self) -> Iterator[ArmReading]:
        """Samples, one per cycle; ends with the connection."""
        ...

    def send(self, dq_rad_s: Array) -> bool:
        """Velocity for the coming cycle, which the arm integrates; False if it refuses it."""
        ...


class MasterReading(Protocol):
    """What a haptic device reports; any object with these names is one."""

    @property
    def t_s(self) -> float:
        """Time on the device's own clock."""
        ...

    @property
    def position_m(self) -> Array:
        """Place of its handle, shape (3,), in the device's axes."""
        ...

    @property
    def velocity_m_s(self) -> Array:
        """Velocity of its handle, shape (3,)."""
        ...

    @property
    def clutch(self) -> bool:
        """True while the hand moves the needle."""
        ...


class MasterSample(NamedTuple):
    """The plainest `MasterReading`."""

    t_s: float
    position_m: Array
    velocity_m_s: Array
    clutch: bool


class HapticDevice(Protocol):
    """An impedance device: it reports where its handle is and takes a force to show."""

    def read(self) -> MasterReading | None:
        """The newest sample; None if there is nothing new or the device has gone."""
        ...

    def render(self, force_N: Array) -> None:
        """Force on the operator's hand from now on, shape (3,)."""
        ...


class ForceSensor(Protocol):
    """A force/torque sensor at the needle's base, in its own axes."""

    def read(self) -> Array | None:
        """Force [N] and torque [Nm] of the environment on the needle, shape (6,), or None."""
        ...
