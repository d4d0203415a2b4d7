"""Models of joint friction between the torque sensor and the link."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from foundation.arrays import Array
from residual.checks.input import check_positive
from residual.errors import FRICTION_OF_JOINTS, ConfigurationError
from urdf.errors import InputError, finite_array


class FrictionModel(Protocol):
    """Any object that gives the friction torque of every joint at a velocity."""

    def torque(self, dq: Array) -> Array:
        """Return the torque that opposes the motion [Nm], shape (n,).

        Args:
            dq: Joint velocities [rad/s], shape (n,).
        """
        ...


def _freeze_vectors(owner: object, names: tuple[str, ...]) -> None:
    """Store each named field as a read-only float copy; all of one length."""
    sizes = {np.size(getattr(owner, name)) for name in names}
    for name in names:
        try:
            array = finite_array(np.atleast_1d(getattr(owner, name)), (-1,), name)
        except (InputError, ValueError) as error:
            raise ConfigurationError(str(error), FRICTION_OF_JOINTS) from error
        object.__setattr__(owner, name, array)
    if len(sizes) > 1:
        raise ConfigurationError(
            f"{', '.join(names)} differ in length: {sorted(sizes)}", FRICTION_OF_JOINTS
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointFriction:
    """Viscous and Coulomb friction with a smooth reversal, plus a constant offset.

    ``tau_f = viscous * dq + coulomb * tanh(dq / reversal_speed) + offset``

    Attributes:
        viscous_Nms: Viscous coefficient per joint [Nm s/rad].
        coulomb_Nm: Coulomb level per joint [Nm].
        offset_Nm: Constant per joint [Nm].
        reversal_speed_rad_s: Speed over which Coulomb friction changes sign [rad/s].

    Raises:
        ConfigurationError: If lengths differ, a number is not finite, a viscous or
            Coulomb coefficient is negative, or the reversal speed is not positive.
    """

    viscous_Nms: Array
    coulomb_Nm: Array
    offset_Nm: Array
    reversal_speed_rad_s: float = 0.01

    def __post_init__(self) -> None:
        _freeze_vectors(self, ("viscous_Nms", "coulomb_Nm", "offset_Nm"))
        if (self.viscous_Nms < 0).any() or (self.coulomb_Nm < 0).any():
            raise ConfigurationError(
                "viscous_Nms and coulomb_Nm must not be negative", FRICTION_OF_JOINTS
            )
        check_positive("reversal_speed_rad_s", self.reversal_speed_rad_s)

    def torque(self, dq: Array) -> Array:
        """Return the torque that opposes the motion [Nm], shape (n,)."""
        smooth_sign = np.tanh(dq / self.reversal_speed_rad_s)
        return self.viscous_Nms * dq + self.coulomb_Nm * smooth_sign + self.offset_Nm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SigmoidFriction:
    """The Franka Panda's friction as identified by Gaz et al., RA-L 2019.

    ``tau_f = A / (1 + exp(-alpha (dq + s))) - A / (1 + exp(-alpha s))``: zero at rest,
    with a level that may differ between the two directions.

    Attributes:
        amplitude_Nm: A per joint [Nm].
        slope_s_rad: alpha per joint [s/rad].
        shift_rad_s: s per joint [rad/s].

    Raises:
        ConfigurationError: If lengths differ or a number is not finite.
    """

    amplitude_Nm: Array
    slope_s_rad: Array
    shift_rad_s: Array

    def __post_init__(self) -> None:
        _freeze_vectors(self, ("amplitude_Nm", "slope_s_rad", "shift_rad_s"))

    def torque(self, dq: Array) -> Array:
        """Return the torque that opposes the motion [Nm], shape (n,)."""
        level_at_rest = self._sigmoid(self.shift_rad_s)
        return self.amplitude_Nm * (
            self._sigmoid(dq + self.shift_rad_s) - level_at_rest
        )

    def _sigmoid(self, speed: Array) -> Array:
        # The exponential of more is no float; the sigmoid is zero there.
        exponent = np.minimum(-self.slope_s_rad * speed, 700.0)
        return 1.0 / (1.0 + np.exp(exponent))


def check_friction(friction: FrictionModel, joints: int) -> None:
    """Refuse a friction model that does not fit so many joints.

    Raises:
        ConfigurationError: If its torques are not finite numbers, one per joint.
    """
    for speed_rad_s in (0.0, 0.1, -0.1):  # at rest and both ways
        try:
            torque = friction.torque(np.full(joints, speed_rad_s))
        except ValueError:  # as numpy's, for vectors of another length
            torque = np.zeros(0)
        if np.shape(torque) != (joints,) or not np.isfinite(torque).all():
            raise ConfigurationError(
                f"friction gives {torque!r}, expected {joints} finite numbers",
                FRICTION_OF_JOINTS,
            )
