"""Errors of `needleforce.control`: one base; each of the others is also a standard exception."""


class ControlError(Exception):
    """Base of the errors of this package; those of the estimators pass through."""


class SettingError(ControlError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


class RefusedError(ControlError, RuntimeError):
    """Something that must not be done now; the message says why, and what has to come first."""
