"""Errors of `needleforce.anatomy`: one base; each of the others is also a standard exception."""


class AnatomyError(Exception):
    """Base of the errors of this package."""


class VolumeError(AnatomyError, ValueError):
    """A file, volume or point that cannot be used: what came, what was expected, what to do."""


class RefusedError(AnatomyError, ValueError):
    """Data from which no registration is made; the message begins with the fault's name."""
