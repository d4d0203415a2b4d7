"""Errors of `identification`: one base, and leaves that refine a built-in kind."""

from foundation.errors import NeedleforceError

RIGHT_SPANS = (
    "Give each `LayerSpan` a rupture after its start and a positive thickness."
)


class IdentificationError(NeedleforceError):
    """Base of every error raised by `identification`."""

    usual_advice = (
        "Correct the field of `MixtureConfig` or `PublishedConfig` that the "
        "message names."
    )


class InvalidConfigError(IdentificationError, ValueError):
    """A configuration value is outside its physical or numerical range."""


class InvalidLogError(IdentificationError, ValueError):
    """A recording cannot be identified: empty, ragged, not finite or not in order."""

    usual_advice = (
        "Give vectors of finite numbers, one value a row, with times that increase."
    )


class InvalidSnapshotError(IdentificationError, ValueError):
    """A snapshot of another identifier than the one to restore, or a damaged one."""

    usual_advice = "Take an older snapshot, or start and tare anew."
