"""Errors of `identification`: one base, leaves that are also the built-in kind they
refine.
"""


class IdentificationError(Exception):
    """Base of every error raised by `identification`."""


class InvalidConfigError(IdentificationError, ValueError):
    """A configuration value is outside its physical or numerical range."""


class InvalidLogError(IdentificationError, ValueError):
    """A recording cannot be identified: empty, wrong shapes, non-finite or
    unordered.
    """


class InvalidSnapshotError(IdentificationError, ValueError):
    """A snapshot does not belong to the identifier it is restored into, or is
    damaged.
    """
