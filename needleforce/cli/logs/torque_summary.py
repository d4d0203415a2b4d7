"""What a tare has shown of the torques of a log, for summaries and for `check`."""

from residual.bias.torque_diagnosis import TorqueDiagnosis


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
    max_listed_std_kg = 1.0  # A payload that is known less well is not listed
    if diagnosis.payload_std_kg > max_listed_std_kg:
        return ""
    return (
        f"missing mass {diagnosis.payload_kg + 0.0:.2f} +/- "
        f"{diagnosis.payload_std_kg:.2f} kg"
    )


def describe_doubt(diagnosis: TorqueDiagnosis | None) -> str:
    """Return what is doubtful about the torques of a tare; empty if nothing is."""
    if diagnosis is None:
        return ""
    one_joint = diagnosis.describe_one_joint()
    if not (diagnosis.scale_deviates or one_joint):
        return ""
    seen = one_joint or f"tau is {describe_scale(diagnosis)}"
    return (
        f"{seen}: units, the sensors' scale, or masses of the model, are off; the "
        "force's deviation has that in it"
    )
