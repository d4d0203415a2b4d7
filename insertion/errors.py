"""Errors of the `insertion` package: one base, each leaf also a standard exception."""


class InsertionError(Exception):
    """Base of every error that `insertion` raises; what its parts raise passes through."""


class SettingError(InsertionError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


class SnapshotMismatchError(InsertionError, ValueError):
    """A snapshot that cannot be restored here; nothing has changed."""


class SnapshotFileError(InsertionError, ValueError):
    """A file that is no snapshot, or one of a version that cannot be read."""
