"""What a tare has shown of the torques of a log, for summaries and for `check`."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

from foundation.errors import NeedleforceError
from needleforce.cli.logs.log_session import LogSession
from needleforce.cli.logs.torque_columns import correcting_options
from residual import TareError, VirtualForceSensor
from residual.bias.model import TareBlocks
from residual.bias.torque_diagnosis import CLEAR_LOG, TorqueDiagnosis
from urdf import Payload, load_example
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
    if diagnosis is None:
        return ""
    one_joint = diagnosis.describe_one_joint()
    if not (diagnosis.advice or diagnosis.scale_deviates or one_joint):
        return ""
    if cure := _name_cure(diagnosis, log, replay):
        text = "" if diagnosis.advice is None else f"{diagnosis.advice.text}. "
        return f"{text}{cure}"
    seen = one_joint or f"tau is {describe_scale(diagnosis)}"
    return (
        f"{seen}: the sensors' scale, or masses of the model, are off; the force's "
        "deviation has that in it"
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
    own = replay.robot.model.name
    logs = {
        name: log
        for name, log in _judge_arms(diagnosis.motion, replay, replay.robot.payload)
        if name != own
    }
    return _clearly_best(logs, best_log)


def describe_needless_factor(
    diagnosis: TorqueDiagnosis | None, log: LogSession, replay: "SensorReplay"
) -> str:
    """Return why the factor of the torques is wrong; empty if it may be right.

    A factor and a payload may make up for a wrong arm in free motion. They do not in
    contact: the torques as they were recorded then fit a known arm far better.
    """
    factor = _factor_of_no_unit(log)
    if diagnosis is None or factor == 1.0:
        return ""
    motion = diagnosis.motion
    recorded = replace(
        motion,
        torque_Nm=motion.torque_Nm / factor,
        scatter_Nm2=motion.scatter_Nm2 / factor**2,
    )
    logs: dict[str, float] = {}
    for name, arm_log in _judge_arms(recorded, replay, replay.robot.payload):
        logs[f"--robot {name}"] = arm_log
    for name, arm_log in _judge_arms(recorded, replay, None):
        logs[f"--robot {name} and none of this payload"] = arm_log
    best = _clearly_best(logs, diagnosis.log_evidence)
    if not best:
        return ""
    return (
        f"tau times {factor:g} with {replay.robot.model.name} fits the free motion of "
        f"the tare by chance: as recorded, tau fits it far better with {best}"
    )


def _factor_of_no_unit(log: LogSession) -> float:
    """Return the mapping's factor of all torques where no unit explains it, else 1."""
    scales = [unit.scale for unit in log.units if unit.channel == "tau"]
    factor = scales[0] if scales else 1.0
    # Units and the ratios of gears differ by more than 10.
    if isinstance(factor, tuple) or not 0.1 < abs(factor) < 10.0:
        return 1.0
    return abs(factor)


def _judge_arms(
    motion: TareBlocks, replay: "SensorReplay", payload: Payload | None
) -> Iterator[tuple[str, float]]:
    """Yield the known arms whose motion it may be, and how probable it is of each."""
    for name in EXAMPLES:
        # A known arm may be missing, or not fit the settings: it is none that fits.
        with suppress(NeedleforceError):
            arm = load_example(
                name, payload=payload, gravity_m_s2=replay.robot.gravity_m_s2
            )
            if arm.nv != replay.robot.nv:
                continue
            log = VirtualForceSensor(arm, replay.config).judge_motion(motion)
            if log is not None:
                yield arm.model.name, log


def _clearly_best(logs: dict[str, float], best_log: float) -> str:
    """Return what alone has clearly the best logarithm; empty if nothing has."""
    near = [name for name in logs if logs[name] > max(logs.values()) - CLEAR_LOG]
    if len(near) != 1 or logs[near[0]] < best_log + CLEAR_LOG:
        return ""
    return near[0]
