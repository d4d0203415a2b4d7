"""Errors of `needleforce.control`: one base, and one that is also a `ValueError`."""


class ControlError(Exception):
    """Base of the errors of this package; those of the estimators pass through."""


class SettingError(ControlError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""
