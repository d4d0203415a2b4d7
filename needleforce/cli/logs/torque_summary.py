"""What a tare has shown of the torques of a log, for summaries and for `check`."""

from contextlib import suppress
from typing import TYPE_CHECKING

from foundation.errors import NeedleforceError
from needleforce.cli.logs.log_session import LogSession
from needleforce.cli.logs.torque_columns import correcting_options
from residual import TareError, VirtualForceSensor
from residual.bias.torque_diagnosis import CLEAR_LOG, TorqueDiagnosis
from urdf import load_example
from urdf.loading import EXAMPLES

if TYPE_CHECKING:
    from needleforce.sensor_replay import SensorReplay


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


def describe_doubt(
    diagnosis: TorqueDiagnosis | None, log: LogSession, replay: "SensorReplay"
) -> str:
    """Return what is doubtful about the torques of a tare; empty if nothing is."""
    if diagnosis is None or not (diagnosis.advice or diagnosis.scale_deviates):
        return ""
    if cure := _name_cure(diagnosis, log, replay):
        text = "" if diagnosis.advice is None else f"{diagnosis.advice.text}. "
        return f"{text}{cure}"
    return (
        f"tau is {describe_scale(diagnosis)}: the sensors' scale, or masses of the "
        "model, are off; the force's deviation has that in it"
    )


def with_cure(error: TareError, log: LogSession, replay: "SensorReplay") -> TareError:
    """Return a refused tare with the options that correct the log, if any do."""
    if not isinstance(error.diagnosis, TorqueDiagnosis):
        return error
    cure = _name_cure(error.diagnosis, log, replay)
    return error.reworded(f"{error}. {cure}") if cure else error


def _name_cure(
    diagnosis: TorqueDiagnosis, log: LogSession, replay: "SensorReplay"
) -> str:
    """Return the options that make a motion right; empty if none is known to."""
    advice = diagnosis.advice
    best_log = diagnosis.log_evidence if advice is None else advice.log
    if name := _fitting_arm(diagnosis, replay, best_log):
        return f"Of the known arms {name} alone fits this motion: give --robot {name}"
    return "" if advice is None else f"Give {correcting_options(advice, log)}"


def _fitting_arm(
    diagnosis: TorqueDiagnosis, replay: "SensorReplay", best_log: float
) -> str:
    """Return the known arm that explains a motion clearly best; empty if none does.

    Args:
        diagnosis: Of the motion.
        replay: The sensor with the arm that was given.
        best_log: Logarithm of the motion's probability with the best explanation yet.
    """
    robot = replay.robot
    logs: dict[str, float] = {}
    for name in EXAMPLES:
        # A known arm may be missing, or not fit the settings: it is none that fits.
        with suppress(NeedleforceError):
            arm = load_example(
                name, payload=robot.payload, gravity_m_s2=robot.gravity_m_s2
            )
            if arm.nv != robot.nv or arm.model.name == robot.model.name:
                continue
            log = VirtualForceSensor(arm, replay.config).judge_motion(diagnosis.motion)
            if log is not None:
                logs[name] = log
    near = [name for name in logs if logs[name] > max(logs.values()) - CLEAR_LOG]
    if len(near) != 1 or logs[near[0]] < best_log + CLEAR_LOG:
        return ""
    return near[0]
