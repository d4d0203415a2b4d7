"""Errors of `identification`: one base, and leaves that refine a built-in kind."""

from foundation.errors import CodedError, ErrorCode, StateCode


class IdentificationCode(ErrorCode):
    """Kinds of errors and of suspicions about the identification."""

    SETTING = (
        "NF-IDENTIFICATION-SETTING",
        "A setting of the identification is outside its range.",
        "Correct the field of `MultilayerConfig` or `PublishedConfig` that the message "
        "names.",
    )
    LOG = (
        "NF-IDENTIFICATION-LOG",
        "The columns of a recording cannot be identified.",
        "Give vectors of finite numbers, one value a row, with times that increase.",
    )
    SPANS = (
        "NF-IDENTIFICATION-SPANS",
        "The span of a layer cannot be.",
        "Give each `LayerSpan` a rupture after its start and a positive thickness.",
    )
    DEPTH_UNIT = (
        "NF-IDENTIFICATION-DEPTH-UNIT",
        "The depths span more than any needle is long.",
        "Give `depth_m` in metres.",
    )
    NO_TRAVEL = (
        "NF-IDENTIFICATION-NO-TRAVEL",
        "The needle hardly moves, so that there is nothing to identify.",
        "Give `depth_m` in metres, of a recording that has an insertion.",
    )
    FORCE_SIGN = (
        "NF-IDENTIFICATION-FORCE-SIGN",
        "The force is negative while the needle goes in.",
        "Negate `force_N`.",
    )
    DEPTH_SIGN = (
        "NF-IDENTIFICATION-DEPTH-SIGN",
        "Depth falls before it rises.",
        "Negate `depth_m`, unless the recording begins with a withdrawal.",
    )
    SPEED_SIGN = (
        "NF-IDENTIFICATION-SPEED-SIGN",
        "Speed and the change of depth have opposite signs.",
        "Negate `speed_m_s` or `depth_m`, or leave the speed out.",
    )


class IdentificationError(CodedError):
    """Base of every error raised by `identification`."""

    usual_code = IdentificationCode.SETTING


class InvalidConfigError(IdentificationError, ValueError):
    """A configuration value is outside its physical or numerical range."""


class InvalidLogError(IdentificationError, ValueError):
    """A recording cannot be identified: empty, ragged, not finite or not in order."""

    usual_code = IdentificationCode.LOG


class InvalidSnapshotError(IdentificationError, ValueError):
    """A snapshot of another identifier than the one to restore, or a damaged one."""

    usual_code = StateCode.DAMAGED
