"""Errors of the `residual` package: one base, each leaf also a standard exception."""

from collections.abc import Iterable
from typing import Any

from foundation.errors import NeedleforceError
from residual.estimate import SensorWarning


def named_joints(indices: Iterable[int]) -> str:
    """Return joints as messages name them, ``joints 2, 4``, counted from 1.

    The columns of a log count likewise.
    """
    numbers = [str(int(i) + 1) for i in indices]
    return f"{'joint' if len(numbers) == 1 else 'joints'} {', '.join(numbers)}"


FRICTION_OF_JOINTS = (
    "Give `SensorConfig` a `friction` with one finite number for each joint."
)
NEXT_TIME_STEP = (
    "Skip the sample and go on with the next time step; if it recurs, repair the clock."
)


class ResidualError(NeedleforceError):
    """Base of every error that `residual` raises."""

    usual_advice = (
        "Correct the field of `SensorConfig`, or the argument, that the message names."
    )


class ConfigurationError(ResidualError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


class SampleError(ResidualError, ValueError):
    """A sample that must not be used: wrong shape, not finite, or time not advancing.

    The state of the object that raises it is as before the call.

    Attributes:
        warning: Of valid numbers that are no measurement, why: a spike, a frozen or a
            saturated torque.
    """

    usual_advice = "Skip the sample and go on; the state has not changed."

    def __init__(
        self,
        message: str,
        advice: str = "",
        warning: SensorWarning = SensorWarning.NONE,
    ) -> None:
        super().__init__(message, advice)
        self.warning = warning


class TareError(ResidualError, RuntimeError):
    """A tare that would be wrong.

    There are no data, a contact is in sight, torques are of another kind, or velocities
    are not rates of positions.

    Args:
        message: As of `NeedleforceError`, like ``advice``.
        advice: What a caller may do.
        diagnosis: What the motion shows of the torques, a `TorqueDiagnosis`; None where
            they were not looked at.
    """

    usual_advice = (
        "Move in free air, then call `tare` again; `tare(ignore_contact=True)` "
        "takes it as it is."
    )

    def __init__(
        self,
        message: str = "",
        advice: str = "",
        *,
        diagnosis: Any = None,
    ) -> None:
        self.diagnosis = diagnosis
        super().__init__(message, advice)


class SnapshotError(ResidualError, ValueError):
    """A snapshot that cannot be restored here: the message says what it is of."""

    usual_advice = "Take an older snapshot, or start and tare anew."
