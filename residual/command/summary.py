"""The table a user reads at the end: what was used, what was done, what came out."""

from residual.command.force_result import ForceResult
from residual.command.force_statistics import ForceStatistics
from residual.command.replay import Replay
from residual.sensor_config import SensorConfig
from residual.wrench_estimate import Status
from urdf import Robot

Rows = list[tuple[str, str]]


def summary_rows(result: ForceResult) -> Rows:
    """Return label and text of every line of the summary."""
    replay, forces = result.replay, result.statistics
    own_lag = "that of the robot's own estimate"
    return [
        ("robot", _robot(result.robot)),
        ("sensor", result.sensor_line),
        ("samples", _samples(forces)),
        ("skipped", _skipped(replay)),
        ("gaps", _gaps(replay, result.config)),
        ("cautions", _cautions(forces)),
        *([("velocity", replay.velocity_fault)] if replay.velocity_fault else []),
        ("tare", _tare(replay)),
        ("axial force", _force(forces)),
        ("lag", own_lag if result.is_external else f"{1e3 * replay.lag_s:.1f} ms"),
    ]


def format_rows(rows: Rows) -> str:
    """Return the lines with their texts below each other."""
    width = max(len(label) for label, _ in rows)
    return "".join(f"{label:<{width}}  {text}\n" for label, text in rows)


def _robot(robot: Robot) -> str:
    mass_kg = robot.payload.mass_kg if robot.payload is not None else 0.0
    return f"{robot.model.name}, {robot.nv} joints, payload {mass_kg:.3g} kg"


def _samples(forces: ForceStatistics) -> str:
    duration_s = forces.last_s - forces.first_s
    counts = [f"{forces[status].count} {status.value}" for status in Status if forces[status].count]
    rate_hz = 1.0 / forces.step_s
    return f"{forces.rows} in {duration_s:.4g} s at {rate_hz:.4g} Hz: {', '.join(counts)}"


def _skipped(replay: Replay) -> str:
    if not replay.skipped:
        return "none"
    reasons = "; ".join(f"{count} x {reason}" for reason, count in replay.skipped.most_common(4))
    more = len(replay.skipped) - 4
    return f"{replay.skipped.total()}: {reasons}" + (f"; {more} other reasons" if more > 0 else "")


def _gaps(replay: Replay, config: SensorConfig) -> str:
    if not replay.gaps:
        return f"none longer than {config.max_gap_s:g} s"
    return (
        f"{replay.gaps} longer than {config.max_gap_s:g} s (longest "
        f"{replay.longest_gap_s:.3g} s), after which the filters started anew"
    )


def _cautions(forces: ForceStatistics) -> str:
    told = [
        f"{count} x {str(caution.name).lower().replace('_', ' ')}"
        for caution, count in forces.cautions.most_common()
        if count
    ]
    return ", ".join(told) or "none"


def _tare(replay: Replay) -> str:
    done = replay.tare
    if done is None:
        return "none: forces carry the errors of the model and of the torque sensors"
    return (
        f"{done.window} of the log, kind {done.tare.basis.kind!r}, "
        f"offsets up to {done.largest_offset_Nm:.2g} Nm"
    )


def _force(forces: ForceStatistics) -> str:
    shown, note = forces[Status.OK], ""
    if not shown.count:
        shown, note = forces[Status.NOT_TARED], ", not tared"
    if not shown.count:
        return "none: no sample was sound and settled"
    return (
        f"{shown.least_N:.3f} to {shown.largest_N:.3f} N, standard deviation {shown.std_N:.3f} N "
        f"(median){note}"
    )
