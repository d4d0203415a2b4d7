"""What a tare has shown of the torques of a log, for summaries and for `check`."""

from collections.abc import Iterable

from foundation.errors import Alternative
from needleforce.cli.advice import advise_causes
from needleforce.cli.logs.log_session import LogSession
from needleforce.cli.logs.torque_columns import with_option
from residual.bias.torque_diagnosis import TorqueDiagnosis

MAX_LISTED_STD_KG = 1.0
"""A payload that is known less well is not listed."""


def describe_torques(diagnosis: TorqueDiagnosis | None, *, is_external: bool) -> str:
    """Return scale, payload and unchecked joints in one line.

    Args:
        diagnosis: Of the tare; None where it had none.
        is_external: Whether the robot estimates the external torque itself.
    """
    if is_external:
        return "not checked: the robot estimates the external torque itself"
    if diagnosis is None:
        return "not checked: no tare, or one that ignores contact"
    parts = [describe_scale(diagnosis), describe_missing_mass(diagnosis)]
    return "; ".join(filter(None, (*parts, diagnosis.describe_unchecked())))


def describe_scale(diagnosis: TorqueDiagnosis) -> str:
    """Return torque over that of the model, with its deviation."""
    return (
        f"{diagnosis.scale:.3g} +/- {diagnosis.scale_std:.2g} times what gravity asks "
        "for"
    )


def describe_missing_mass(diagnosis: TorqueDiagnosis) -> str:
    """Return the mass that the model lacks; empty where the motion shows nothing."""
    if diagnosis.payload_std_kg > MAX_LISTED_STD_KG:
        return ""
    return (
        f"missing mass {diagnosis.payload_kg + 0.0:.2f} +/- "
        f"{diagnosis.payload_std_kg:.2f} kg"
    )


def describe_doubt(diagnosis: TorqueDiagnosis | None, log: LogSession) -> str:
    """Return what is doubtful about the torques, with advice; empty if nothing is."""
    if diagnosis is None or not diagnosis.findings:
        return ""
    return f"{diagnosis.describe()}. {advise_findings(diagnosis, log)}"


def advise_findings(diagnosis: TorqueDiagnosis, log: LogSession) -> str:
    """Return what may be done about the findings of a tare that was taken."""
    causes: Iterable[Alternative] = (
        Alternative(one.cause.code, with_option(one.cause.places, log))
        for one in diagnosis.findings
    )
    return advise_causes(causes, keeps_tare=True)
