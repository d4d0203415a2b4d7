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


class ArmSample(NamedTuple):
    """What an arm reports in one cycle."""

    dt_s: float  # since the previous sample
    q_rad: Array  # joint positions, shape (n,)
    dq_rad_s: Array | None  # joint velocities, shape (n,); None where the interface has none
    tau_Nm: Array  # measured link-side joint torques, shape (n,)


class Arm(Protocol):
    """An arm that takes joint velocities."""

    @property
    def robot(self) -> Robot:
        """The arm as its user knows it."""
        ...

    def __iter__(self) -> Iterator[ArmSample]:
        """Samples, one per cycle; ends with the connection."""
        ...

    def send(self, dq_rad_s: Array) -> bool:
        """Velocity for the coming cycle, which the arm integrates; False if it refuses it."""
        ...


class MasterSample(NamedTuple):
    """What a haptic device reports."""

    t_s: float  # on the device's own clock
    position_m: Array  # of its handle, shape (3,)
    velocity_m_s: Array  # shape (3,)
    clutch: bool  # True while the hand moves the needle


class HapticDevice(Protocol):
    """An impedance device: it reports where its handle is and takes a force to show."""

    def read(self) -> MasterSample | None:
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
