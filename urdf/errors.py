"""Errors of the robot package: one base, and a leaf for each thing a caller can put right."""


class UrdfError(Exception):
    """Base of every error raised by `urdf`."""


class UrdfFileError(UrdfError, ValueError):
    """A robot description is missing, unreadable or malformed."""


class UnknownNameError(UrdfError, LookupError):
    """A frame, joint or robot of that name does not exist; the message lists those that do."""


class InertiaError(UrdfError, ValueError):
    """Inertial parameters that no rigid body can have."""


class UnsupportedJointError(UrdfError, ValueError):
    """A joint whose position and velocity do not have one number each."""


class InputError(UrdfError, ValueError):
    """An argument of the wrong shape, not finite, or out of its range."""


class MissingPackageError(UrdfError, ImportError):
    """An optional data package is not installed; the message says how to install it."""
