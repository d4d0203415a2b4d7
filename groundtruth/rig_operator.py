"""A person at a haptic device: the emulated operator and master of teleoperation.

The hand is a mass on a spring and damper whose other end, the *wish*, moves as the
person wants; it holds the handle of an impedance device, which reports where that is
and shows a force:

    (m_hand + m_device) x'' = k (wish - x) - b x' + f.

Position noise is that of the device's encoders: quantisation.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from foundation.arrays import Array
from groundtruth.plant_model import TICK_s


class MasterSample(NamedTuple):
    """Report of the haptic device in one cycle.

    Attributes:
        t_s: Time by the device's clock.
        position_m: Measured position of the handle, shape (3,).
        velocity_m_s: Measured velocity, shape (3,).
        clutch: True while the hand moves the needle.
    """

    t_s: float
    position_m: Array
    velocity_m_s: Array
    clutch: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class Operator:
    """A person's hand.

    Attributes:
        wish_m: Position that the person wants for the handle over time [s], device
            axes, shape (3,).
        stiffness_N_per_m: Stiffness of the hand about that; a loose grip has 150, a
            firm one 600.
        mass_kg: Mass of hand and forearm as far as they move along, 1 to 2.
        damping_Ns_per_m: Damping of the hand.
    """

    wish_m: Callable[[float], Iterable[float]]
    stiffness_N_per_m: float = 300.0
    mass_kg: float = 1.5
    damping_Ns_per_m: float = 8.0


def random_operator(
    wish_m: Callable[[float], Iterable[float]], rng: np.random.Generator
) -> Operator:
    """Draw a hand of 150 to 600 N/m, equal chance per octave, and 1 to 2 kg."""
    stiffness = float(np.exp(rng.uniform(np.log(150.0), np.log(600.0))))
    return Operator(
        wish_m=wish_m, stiffness_N_per_m=stiffness, mass_kg=float(rng.uniform(1.0, 2.0))
    )


class HapticMaster:
    """An impedance device in an operator's hand, at 1 kHz.

    One `read` is one of its cycles.

    Attributes:
        position_m: Where the handle truly is, shape (3,).
        velocity_m_s: Its true velocity, shape (3,).
        port_energy_J: What the operator has put into the device by now, less what came
            back: the sum of -f dx, exact for a force held over each cycle. A passive
            device keeps it from falling below zero.
        least_energy_J: The least of that so far.
        clutch: Whether the hand's motion counts; set it as the person would press the
            pedal.
    """

    def __init__(
        self,
        operator: Operator,
        *,
        mass_kg: float = 0.25,
        position_step_m: float = 1e-5,
        speed_filter_s: float = 2e-3,
    ) -> None:
        """Put the device into a hand, at rest where the person wants it at time zero.

        Args:
            operator: The hand.
            mass_kg: Apparent mass of the device at its handle.
            position_step_m: Resolution of its encoders at the handle, zero for none.
            speed_filter_s: Time constant of the low-pass that turns positions into
                velocities.
        """
        self._operator = operator
        self._position_step_m = position_step_m
        mass = operator.mass_kg + mass_kg
        k = operator.stiffness_N_per_m / mass
        b = operator.damping_Ns_per_m / mass
        # Exact over a cycle for a held force: state x, v and input (k wish + f) / m.
        step = expm(
            np.array([[0.0, 1.0, 0.0], [-k, -b, 1.0], [0.0, 0.0, 0.0]]) * TICK_s
        )
        self._step = step[:2]
        self._mass_kg = mass
        self._pole = float(np.exp(-TICK_s / speed_filter_s))
        self.position_m = np.array(tuple(operator.wish_m(0.0)), dtype=np.float64)
        self.velocity_m_s = np.zeros(3)
        self._measured_m = self._measured()
        self._measured_m_s = np.zeros(3)
        self._force_N = np.zeros(3)
        self.port_energy_J = 0.0
        self.least_energy_J = 0.0
        self.clutch = True
        self._cycle = 0
        self._gone_until = 0

    @property
    def time_s(self) -> float:
        """Time of the last cycle, by the device's clock."""
        return self._cycle * TICK_s

    def read(self) -> MasterSample | None:
        """Let a cycle pass and return its end; None while the device is gone."""
        wish = np.array(tuple(self._operator.wish_m(self.time_s)), dtype=np.float64)
        drive = (
            self._operator.stiffness_N_per_m * wish + self._force_N
        ) / self._mass_kg
        state = np.array((self.position_m, self.velocity_m_s, drive))
        start_m = self.position_m
        self.position_m, self.velocity_m_s = self._step @ state
        self.port_energy_J -= float(self._force_N.dot(self.position_m - start_m))
        self.least_energy_J = min(self.least_energy_J, self.port_energy_J)
        self._cycle += 1
        measured_m = self._measured()
        difference_m_s = (measured_m - self._measured_m) / TICK_s
        self._measured_m = measured_m
        self._measured_m_s = difference_m_s + self._pole * (
            self._measured_m_s - difference_m_s
        )
        if self._cycle < self._gone_until:
            self._force_N = np.zeros(3)
            return None
        return MasterSample(
            self.time_s, measured_m.copy(), self._measured_m_s.copy(), self.clutch
        )

    def render(self, force_N: ArrayLike) -> None:
        """Set the force on the hand from now on, device axes, shape (3,), N.

        There is none while the device is gone.

        A force that is not finite switches the motors off.
        """
        force = np.array(force_N, dtype=np.float64)
        is_usable = self._cycle >= self._gone_until and bool(np.isfinite(force).all())
        self._force_N = force if is_usable else np.zeros(3)

    def disconnect(self, seconds: float) -> None:
        """Let the device be gone for some time: no samples, no force."""
        self._gone_until = self._cycle + 1 + round(seconds / TICK_s)

    def _measured(self) -> Array:
        """Return the position as the encoders report it, shape (3,)."""
        step = self._position_step_m
        return (
            np.round(self.position_m / step) * step
            if step > 0.0
            else self.position_m.copy()
        )
