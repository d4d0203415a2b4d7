"""Errors of the `residual` package: one base, each leaf also a standard exception."""

from collections.abc import Iterable

from residual.estimate import SensorWarning


def named_joints(indices: Iterable[int]) -> str:
    """Return joints as messages name them, ``joints 2, 4``, counted from 1.

    The columns of a log count likewise.
    """
    numbers = [str(int(i) + 1) for i in indices]
    return f"{'joint' if len(numbers) == 1 else 'joints'} {', '.join(numbers)}"


class ResidualError(Exception):
    """Base of every error that `residual` raises."""


class ConfigurationError(ResidualError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


class SampleError(ResidualError, ValueError):
    """A sample that must not be used: wrong shape, not finite, or time not advancing.

    The state of the object that raises it is as before the call.

    Attributes:
        warning: Of valid numbers that are no measurement, why: a spike, a frozen or a
            saturated torque.
    """

    def __init__(
        self, message: str, warning: SensorWarning = SensorWarning.NONE
    ) -> None:
        super().__init__(message)
        self.warning = warning


class TareError(ResidualError, RuntimeError):
    """A tare that would be wrong.

    There are no data, a contact is in sight, or velocities are not rates of positions.
    """


class VelocityError(TareError):
    """A tare with measured velocities that are not the rate of the positions."""


class SnapshotError(ResidualError, ValueError):
    """A snapshot that cannot be restored here: the message says what it is of."""
