"""Errors of `identification`: one base, and leaves that refine a built-in kind."""


class IdentificationError(Exception):
    """Base of every error raised by `identification`."""


class InvalidConfigError(IdentificationError, ValueError):
    """A configuration value is outside its physical or numerical range."""


class InvalidLogError(IdentificationError, ValueError):
    """A recording cannot be identified: empty, ragged, not finite or not in order."""


class InvalidSnapshotError(IdentificationError, ValueError):
    """A snapshot of another identifier than the one to restore, or a damaged one."""
