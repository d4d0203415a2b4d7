"""What lies outside: an arm, and the samples of arm and haptic device, as protocols.

A driver of a real arm, the simulated rig and the tests implement them; nothing here
knows which. SI units; vectors in the axes of the robot's base unless said otherwise.
"""

from abc import abstractmethod
from collections.abc import Iterator
from typing import Protocol

from foundation.arrays import Array
from urdf import Robot


class ArmSample(Protocol):
    """What an arm reports in one cycle; any object with these names is one."""

    @property
    @abstractmethod
    def dt_s(self) -> float:
        """Time since the previous sample."""

    @property
    @abstractmethod
    def q_rad(self) -> Array:
        """Joint positions, shape (n,)."""

    @property
    @abstractmethod
    def dq_rad_s(self) -> Array | None:
        """Joint velocities, shape (n,); None where the interface has none."""

    @property
    @abstractmethod
    def tau_Nm(self) -> Array:
        """Measured link-side joint torques, shape (n,)."""


class Arm(Protocol):
    """An arm that takes joint velocities."""

    @property
    @abstractmethod
    def robot(self) -> Robot:
        """The arm as its user knows it."""

    @abstractmethod
    def __iter__(self) -> Iterator[ArmSample]:
        """Iterate over the samples, one per cycle, until the connection ends."""

    @abstractmethod
    def send(self, dq_rad_s: Array) -> bool:
        """Send the velocity of the coming cycle; return False if the arm refuses it.

        The arm integrates the velocity, shape (n,).
        """


class MasterSample(Protocol):
    """What a haptic device reports; any object with these names is one."""

    @property
    @abstractmethod
    def position_m(self) -> Array:
        """Position of its handle, shape (3,), in the device's axes."""

    @property
    @abstractmethod
    def velocity_m_s(self) -> Array:
        """Velocity of its handle, shape (3,)."""

    @property
    @abstractmethod
    def clutch(self) -> bool:
        """True while the hand moves the needle."""
