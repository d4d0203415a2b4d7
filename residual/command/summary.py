"""The table a user reads at the end: what was used, what was done, what came out."""

import numpy as np

from residual.command.joint_signals import JointSignals
from residual.command.replay import Replay
from residual.sensor_config import SensorConfig
from residual.wrench_estimate import Status
from urdf import Robot

Rows = list[tuple[str, str]]


def summary_rows(robot: Robot, config: SensorConfig, signals: JointSignals, result: Replay) -> Rows:
    """Return label and text of every line of the summary."""
    return [
        ("robot", _robot(robot)),
        ("sensor", sensor_line(robot, config, signals)),
        ("samples", _samples(result)),
        ("skipped", _skipped(result)),
        ("gaps", _gaps(result, config)),
        ("tare", _tare(result)),
        ("axial force", _force(result)),
        ("lag", _lag(result, signals)),
    ]


def format_rows(rows: Rows) -> str:
    """Return the lines with their texts below each other."""
    width = max(len(label) for label, _ in rows)
    return "".join(f"{label:<{width}}  {text}\n" for label, text in rows)


def _robot(robot: Robot) -> str:
    mass_kg = robot.payload.mass_kg if robot.payload is not None else 0.0
    return f"{robot.model.name}, {robot.nv} joints, payload {mass_kg:.3g} kg"


def sensor_line(robot: Robot, config: SensorConfig, signals: JointSignals) -> str:
    """Return in one line what is estimated from what."""
    frame = config.frame if config.frame is not None else robot.tool_frame
    where = f"{config.mode} force at {frame}" if config.mode != "full" else f"wrench at {frame}"
    if signals.is_external:
        return f"{where}, from the robot's own external torque"
    velocity = "velocity from the log" if signals.dq_rad_s is not None else "velocity estimated"
    return f"{where}, K = {config.gain_per_s:g} 1/s, {velocity}"


def _samples(result: Replay) -> str:
    duration_s = float(result.t_s.max() - result.t_s.min())
    rate_hz = 1.0 / float(np.median(np.diff(np.unique(result.t_s))))
    counts = [
        f"{int(result.has_status(status).sum())} {status.value}"
        for status in Status
        if result.has_status(status).any()
    ]
    return f"{len(result.t_s)} in {duration_s:.4g} s at {rate_hz:.4g} Hz: {', '.join(counts)}"


def _skipped(result: Replay) -> str:
    if not result.skipped:
        return "none"
    reasons = "; ".join(f"{count} x {reason}" for reason, count in result.skipped.most_common(4))
    more = len(result.skipped) - 4
    return f"{result.skipped.total()}: {reasons}" + (f"; {more} other reasons" if more > 0 else "")


def _gaps(result: Replay, config: SensorConfig) -> str:
    if not result.gaps_s:
        return f"none longer than {config.max_gap_s:g} s"
    return (
        f"{len(result.gaps_s)} longer than {config.max_gap_s:g} s (longest "
        f"{max(result.gaps_s):.3g} s), after which the filters started anew"
    )


def _tare(result: Replay) -> str:
    done = result.tare
    if done is None:
        return "none: forces carry the errors of the model and of the torque sensors"
    return (
        f"{done.window.start_s:.6g} to {done.window.end_s:.6g} s of the log, kind "
        f"{done.tare.basis.kind!r}, offsets up to {done.largest_offset_Nm:.2g} Nm"
    )


def _force(result: Replay) -> str:
    rows = result.has_status(Status.OK)
    note = ""
    if not rows.any():
        rows, note = result.has_status(Status.NOT_TARED), ", not tared"
    if not rows.any():
        return "none: no sample was sound and settled"
    axial, std = result.axial_N[rows], result.axial_std_N[rows]
    return (
        f"{axial.min():.3f} to {axial.max():.3f} N, standard deviation {np.median(std):.3f} N "
        f"(median){note}"
    )


def _lag(result: Replay, signals: JointSignals) -> str:
    if signals.is_external:
        return "that of the robot's own estimate"
    return f"{1e3 * result.lag_s:.1f} ms"
