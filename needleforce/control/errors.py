"""Errors of `needleforce.control`: one base, and one that is also a `ValueError`."""

from foundation.errors import NeedleforceError

RIGHT_LIMITS = (
    "Give `JointLimits` one number for each joint, the lower below the upper."
)


class ControlError(NeedleforceError):
    """Base of the errors of this package; those of the estimators pass through."""


class SettingError(ControlError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""
