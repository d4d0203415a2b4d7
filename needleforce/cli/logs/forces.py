"""Forces of a log: from options to the sensor's replay, and what it says in words."""

from collections import Counter
from collections.abc import Sequence
from functools import partial

import numpy as np

from needleforce import recordings
from needleforce.cli.logs import figures
from needleforce.cli.logs.columns import (
    mapping_from_options,
    name_log,
    parse_window,
    robot_of_log,
)
from needleforce.cli.logs.result import Result
from needleforce.cli.options import JointColumns, RobotOptions, SensorOptions
from needleforce.cli.robot import sensor_config, with_friction
from needleforce.cli.terminal import CHOOSE_TARE, CommandError, progress_bar, warn
from needleforce.session_replay import (
    STATUS_CODES,
    SensorReplay,
    replay_sensor,
)
from residual import SensorWarning, Status, TareError
from urdf import Robot
from urdf.robot import STANDARD_GRAVITY_M_S2

CAPTION = (
    "The force of the environment on the tool; the axial force is positive when tissue "
    "pushes back. The band is two standard deviations wide to either side. Grey lines "
    "are not tared: they carry the errors of the model and of the torque sensors."
)


def run_forces(
    source: Sequence[str],
    robot: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
) -> SensorReplay:
    """Estimate the forces of a log; what is wrong with it is said on stderr.

    Raises:
        CommandError: Options contradict each other, the log does not fit the robot, or
            the tare is refused; the message names the options.
    """
    if sensor.no_tare and (sensor.force_tare or sensor.tare is not None):
        raise CommandError(
            "--no-tare contradicts --tare and --force-tare, expected one of them"
        )
    mapping = mapping_from_options(columns)
    model = robot_of_log(source, mapping, robot, columns.mapping)
    model, friction = with_friction(model, sensor.friction)
    config = sensor_config(sensor, friction)
    log = recordings.read_log(
        source,
        mapping,
        required=("q", sensor.torque_channel),
        optional=("dq",),
        named=("force",),
        joints=model.joint_names,
    )
    warn(log.warnings)
    window = (
        parse_window("--tare", sensor.tare, float(log.t_s[0]))
        if sensor.tare is not None
        else None
    )
    try:
        with progress_bar(name_log(source)) as progress:
            replay = replay_sensor(
                log,
                model,
                config,
                is_tared=not sensor.no_tare,
                window=window,
                ignore_contact=sensor.force_tare,
                progress=progress,
            )
    except TareError as error:
        advice = f"{CHOOSE_TARE}; --force-tare keeps it"
        raise CommandError(str(error), advice) from error
    warn(find_doubts(replay))
    return replay


def add_forces(result: Result, replay: SensorReplay) -> None:
    """Add what is said of the forces of a log to its result."""
    log = replay.log
    flags = describe_warnings(replay)
    marked = [f"samples with {flags}"] if flags else []
    robot_warnings = replay.robot.warnings
    result.warnings += [*log.warnings, *find_doubts(replay), *robot_warnings, *marked]
    result.facts |= describe_forces(replay)
    result.units |= {unit.channel: str(unit) for unit in log.units}
    for over in ("time", "depth"):
        name = f"forces-over-{over}"
        result.figures[name] = partial(figures.draw_forces, replay, result.log, over)
        result.notes[name] = CAPTION
    result.settings["sensor"] = replay.config


def describe_forces(replay: SensorReplay) -> dict[str, str]:
    """Return what was used, done and estimated, by label."""
    config = replay.config
    log = replay.log
    most_first = replay.rejected.most_common(4)
    rejected = "; ".join(f"{count} x {text}" for text, count in most_first)
    estimated = "wrench" if config.mode == "full" else f"{config.mode} force"
    origin = "from the log" if "dq_rad_s" in log else "estimated"
    source = f"K = {config.slowest_gain_per_s:g} 1/s, velocity {origin}"
    lag = f"{1e3 * replay.sensor.lag_s:.1f} ms"
    if "tau_ext_Nm" in log:
        source = "from the robot's own external torque"
        lag = "that of the robot's own estimate"
    facts = {
        "robot": _describe_robot(replay.robot),
        "model": "; ".join(replay.robot.warnings),
        "sensor": f"{estimated} at {config.frame or replay.robot.tool_frame}, {source}",
        "samples": _describe_samples(replay),
        "rejected": f"{replay.rejected.total()}: {rejected}" if rejected else "none",
        "gaps": _describe_gaps(replay),
        "warnings": describe_warnings(replay) or "none",
        "signals": "; ".join(replay.doubts),
        "tare": _describe_tare(replay),
        "torque": _describe_torques(replay),
        "axial force": _describe_axial_force(replay),
        "force sensor": _compare_with_sensor(replay),
        "travel": "counts from the first row; identify and report count below first "
        "contact",
        "lag": lag,
    }
    return {label: text for label, text in facts.items() if text}


def _describe_robot(robot: Robot) -> str:
    """Return name, joints and payload, and gravity where the base is not upright."""
    mass_kg = robot.payload.mass_kg if robot.payload is not None else 0.0
    text = f"{robot.model.name}, {robot.nv} joints, payload {mass_kg:.3g} kg"
    if tuple(robot.gravity_m_s2) == STANDARD_GRAVITY_M_S2:
        return text
    shown = " ".join(f"{component:.4g}" for component in robot.gravity_m_s2)
    return f"{text}, gravity {shown} m/s^2 in base axes"


def _describe_samples(replay: SensorReplay) -> str:
    """Return how many rows there are of each status, and their rate."""
    log = replay.log
    rows = {status: replay.count_status(status) for status in STATUS_CODES}
    rows[Status.REJECTED] += log.left_out
    listed = [f"{count} {status.value}" for status, count in rows.items() if count]
    rate_hz = 1.0 / np.median(np.diff(log.t_s))
    return (
        f"{sum(rows.values())} in {log.t_s[-1] - log.t_s[0]:.4g} s at {rate_hz:.4g} Hz:"
        f" {', '.join(listed)}"
    )


def _describe_gaps(replay: SensorReplay) -> str:
    """Return how many gaps in time there are, and the longest."""
    limit = f"longer than {replay.config.max_gap_s:g} s"
    steps_s = replay.rows["t_s"].diff()[replay.rows["after_gap"]]
    if steps_s.empty:
        return f"none {limit}"
    longest = f"{len(steps_s)} {limit} (longest {steps_s.max():.6g} s)"
    return f"{longest}: filters restart after each"


def _count_warnings(replay: SensorReplay) -> Counter[SensorWarning]:
    """Return how many samples have which warning."""
    flags = replay.rows["force_warnings"].to_numpy()
    return Counter({each: np.count_nonzero(flags & each) for each in SensorWarning})


def describe_warnings(replay: SensorReplay) -> str:
    """Return how many samples have which warning, the most first; empty for none."""
    listed = _count_warnings(replay).most_common()
    return ", ".join(f"{count} x {warning}" for warning, count in listed if count)


def _describe_tare(replay: SensorReplay) -> str:
    """Return from where the tare is, and how large its offsets are."""
    tare = replay.tare
    if tare is None:
        return "none: forces carry the errors of the model and of the torque sensors"
    offset_Nm = float(np.abs(tare.mean[: len(tare.noise_Nm2)]).max())
    return (
        f"{replay.window} of the log, kind {tare.kind!r}, offsets up to "
        f"{offset_Nm:.2g} Nm"
    )


def _describe_torques(replay: SensorReplay) -> str:
    """Return scale, missing mass and unchecked joints as a tare has shown them."""
    max_listed_std_kg = 1.0  # a payload that is known less well is not listed
    diagnosis = replay.sensor.diagnosis
    if "tau_ext_Nm" in replay.log:
        return "not checked: the robot estimates the external torque itself"
    if diagnosis is None:
        reason = "no tare" if replay.tare is None else "the tare ignores contact"
        return f"not checked: {reason}"
    parts = [
        f"{diagnosis.scale:.3g} +/- {diagnosis.scale_std:.2g} times what gravity asks "
        "for"
    ]
    if diagnosis.payload_std_kg <= max_listed_std_kg:
        parts.append(
            f"missing mass {diagnosis.payload_kg:z.2f} +/- "
            f"{diagnosis.payload_std_kg:.2f} kg"
        )
    return "; ".join(filter(None, (*parts, diagnosis.describe_unchecked())))


def find_doubts(replay: SensorReplay) -> list[str]:
    """Return what the tare, and the rows after it, show to be wrong with torques."""
    doubts: list[str] = []
    diagnosis = replay.sensor.diagnosis
    # Several joints that deviate may have a common cause.
    if diagnosis is not None and (
        diagnosis.scale_deviates or len(diagnosis.deviating_joints) == 1
    ):
        doubts.append(
            f"torque: {diagnosis.describe()}: units, the sensors' scale, or masses of "
            "the model, are off; the force's deviation has that in it"
        )
    tared = replay.count_status(Status.OK)
    mismatched = _count_warnings(replay)[SensorWarning.MODEL_MISMATCH]
    # A knock mismatches for a moment; a wrong arm or payload does most of the time.
    if mismatched > 0.1 * tared:
        doubts.append(
            f"model mismatch in {mismatched} of {tared} rows: their torques "
            "are not those of a force on the needle's tip of this arm; check --robot, "
            "--payload and the factor of --tau, and what else touched the arm"
        )
    return doubts


def _describe_axial_force(replay: SensorReplay) -> str:
    """Return the range of the axial force with its deviation."""
    for status, note in ((Status.OK, ""), (Status.NOT_TARED, ", not tared")):
        chosen = replay.rows[replay.rows["force_status"] == STATUS_CODES[status]]
        if len(chosen):
            return (
                f"{chosen['axial_N'].min():.3f} to {chosen['axial_N'].max():.3f} N, "
                f"standard deviation {chosen['axial_std_N'].mean():.3f} N (mean){note}"
            )
    return "none: no sample was valid after the filters had settled"


def _compare_with_sensor(replay: SensorReplay) -> str:
    """Return how far the axial force is from that of the log's sensor, if it has one.

    The sensor's zero is its mean over the tare; the lag of the axial force counts as
    difference.
    """
    log = replay.log
    if "force_N" not in log:
        return ""
    if replay.window is None:
        return "not compared: no tare"
    is_tare = (log.t_s >= replay.window.start_s) & (log.t_s <= replay.window.end_s)
    is_zero = is_tare & np.isfinite(log["force_N"])
    if not is_zero.any():
        return "not compared: it has no value during the tare"
    zero_N = float(np.mean(log["force_N"][is_zero]))
    differences_N = replay.rows["axial_N"].to_numpy() - (log["force_N"] - zero_N)
    is_ok = (replay.rows["force_status"] == STATUS_CODES[Status.OK]).to_numpy()
    compared_N = differences_N[is_ok & ~is_tare & np.isfinite(differences_N)]
    if not compared_N.size:
        return "not compared: it has no value beside a valid axial force"
    rms_N = float(np.sqrt(np.mean(compared_N**2)))
    return (
        f"{rms_N:.2g} N rms from the axial force after the tare, whose mean is its zero"
    )
