"""Errors of the `residual` package: one base, each leaf also a standard exception."""


class ResidualError(Exception):
    """Base of every error that `residual` raises."""


class ConfigurationError(ResidualError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


class SampleError(ResidualError, ValueError):
    """A sample that must not be absorbed: wrong shape, not finite, or time not advancing.

    Whoever raises it has left its state as it was before the call.
    """


class TareError(ResidualError, RuntimeError):
    """A tare that was asked for where it would be wrong: no data, or contact in sight."""
