"""Forces of a log: from options to the sensor's replay, and what it says in words."""

from collections import Counter
from functools import partial

import numpy as np

from needleforce.cli.logs.columns import find_log_joints, mapping_from_options
from needleforce.cli.robot import robot_from_options, sensor_config, with_friction
from needleforce.cli.shared_options import JointColumns, RobotOptions, SensorOptions
from needleforce.cli.terminal import CHOOSE_TARE, CommandError, progress_bar
from needleforce.depth_zero import FIRST_ROW
from needleforce.recordings import Log
from needleforce.sensor_replay import (
    STATUS_CODES,
    SensorReplay,
    TareWindow,
    describe_rejections,
    replay_sensor,
)
from residual import SensorWarning, Status, TareError
from residual.bias.torque_scale import TorqueDiagnosis
from urdf import Robot
from urdf.robot import STANDARD_GRAVITY_M_S2

NO_FORCE = "none: no sample was valid after the filters had settled"


def torque_channel(sensor: SensorOptions) -> str:
    """Return the channel of the torques that the sensor takes."""
    return "tau_ext" if sensor.external_torque else "tau"


def robot_of_log(source: str, robot: RobotOptions, columns: JointColumns) -> Robot:
    """Return the robot of the options; the log may say which joints it has."""
    find_joints = partial(find_log_joints, source, mapping_from_options(columns))
    return robot_from_options(robot, columns.mapping, find_joints)


def parse_tare_window(text: str, first_s: float) -> TareWindow:
    """Return the window that ``--tare`` names.

    Args:
        text: Value of the option, START:END.
        first_s: Time of the log's first row [s].

    Raises:
        CommandError: The text names no window.
    """
    start, colon, end = text.partition(":")

    def time_of(word: str) -> float:
        return (first_s if word.strip().startswith("+") else 0.0) + float(word)

    try:
        start_s = time_of(start) if start.strip() else first_s
        window = TareWindow(start_s, time_of(end))
    except ValueError as error:
        raise CommandError(f"--tare {text}: expected START:END", CHOOSE_TARE) from error
    if not colon or not np.isfinite(window).all():
        raise CommandError(f"--tare {text}: expected START:END", CHOOSE_TARE)
    return window


def check_tare_options(sensor: SensorOptions) -> None:
    """Refuse options on the tare that are wrong, before a log is waited for."""
    if sensor.no_tare and (sensor.force_tare or sensor.tare is not None):
        option = "--tare" if sensor.tare is not None else "--force-tare"
        raise CommandError(
            f"{option} and --no-tare contradict each other, expected one of them"
        )
    if sensor.tare is not None:
        parse_tare_window(sensor.tare, 0.0)


def estimate_forces(
    log: Log, robot: Robot, sensor: SensorOptions, name: str
) -> tuple[SensorReplay, Robot]:
    """Run the sensor of the options over a log.

    Returns:
        What it estimates, and the robot with the rotors of ``--friction``.

    Raises:
        CommandError: The tare is refused; the message names the options.
    """
    robot, friction = with_friction(robot, sensor.friction)
    config = sensor_config(sensor, friction)
    window = None
    if sensor.tare is not None:
        window = parse_tare_window(sensor.tare, float(log.t_s[0]))
    try:
        with progress_bar(name) as progress:
            replay = replay_sensor(
                log,
                robot,
                config,
                is_tared=not sensor.no_tare,
                window=window,
                ignore_contact=sensor.force_tare,
                progress=progress,
            )
    except TareError as error:
        raise CommandError(
            f"{error}", f"{CHOOSE_TARE}; --force-tare keeps it"
        ) from error
    return replay, robot


def describe_forces(
    replay: SensorReplay, robot: Robot, log: Log, *, depths: str
) -> list[tuple[str, str]]:
    """Return label and text of what was used, done and estimated.

    Args:
        replay: What the sensor has estimated.
        robot: Its robot.
        log: The log.
        depths: From where depths of layers count, in words.
    """
    config = replay.config
    is_external = "tau_ext_Nm" in log
    estimated = "wrench" if config.mode == "full" else f"{config.mode} force"
    frame = config.frame if config.frame is not None else robot.tool_frame
    origin = "from the log" if "dq_rad_s" in log else "estimated"
    source = f"K = {config.slowest_gain_per_s:g} 1/s, velocity {origin}"
    lag = f"{1e3 * replay.sensor.lag_s:.1f} ms"
    if is_external:
        source = "from the robot's own external torque"
        lag = "that of the robot's own estimate"
    return [
        ("robot", _describe_robot(robot)),
        *(("model", warning) for warning in robot.warnings),
        ("sensor", f"{estimated} at {frame}, {source}"),
        ("samples", _describe_samples(replay, log)),
        ("rejected", describe_rejections(replay.rejected) or "none"),
        ("gaps", _describe_gaps(replay)),
        ("warnings", describe_warnings(replay)),
        *(("signals", doubt) for doubt in replay.doubts),
        ("tare", _describe_tare(replay)),
        ("torque", _describe_torques(replay.sensor.diagnosis, is_external=is_external)),
        ("axial force", describe_axial_force(replay) or NO_FORCE),
        ("travel", f"counts {FIRST_ROW}; {depths}"),
        ("lag", lag),
    ]


def _describe_robot(robot: Robot) -> str:
    mass_kg = robot.payload.mass_kg if robot.payload is not None else 0.0
    text = f"{robot.model.name}, {robot.nv} joints, payload {mass_kg:.3g} kg"
    gravity_m_s2 = robot.gravity_m_s2.tolist()
    if tuple(gravity_m_s2) == STANDARD_GRAVITY_M_S2:
        return text
    shown = " ".join(f"{component:.4g}" for component in gravity_m_s2)
    return f"{text}, gravity {shown} m/s^2 in base axes"


def _describe_samples(replay: SensorReplay, log: Log) -> str:
    """Return how many rows there are of each status, their rate, and uneven steps."""
    codes = replay.rows["force_status"].to_numpy()
    counts = {
        status: int(np.count_nonzero(codes == code))
        for status, code in STATUS_CODES.items()
    }
    counts[Status.REJECTED] += log.left_out
    listed = [f"{count} {status.value}" for status, count in counts.items() if count]
    span_s = log.t_s[-1] - log.t_s[0]
    text = f"{sum(counts.values())} in {span_s:.4g} s"
    steps_s = np.diff(log.t_s)
    steps_s = steps_s[steps_s > 0.0]
    if steps_s.size:
        usual_s = float(np.median(steps_s))
        late_s = float(np.percentile(steps_s, 99.0))
        text += f" at {1.0 / usual_s:.4g} Hz"
        if late_s > 1.1 * usual_s:
            text += f" (1 of 100 steps is longer than {1e3 * late_s:.4g} ms)"
    return f"{text}: {', '.join(listed)}"


def _describe_gaps(replay: SensorReplay) -> str:
    limit = f"longer than {replay.config.max_gap_s:g} s"
    gaps = int(np.count_nonzero(replay.rows["after_gap"]))
    if not gaps:
        return f"none {limit}"
    return (
        f"{gaps} {limit} (longest {replay.longest_gap_s:.6g} s): filters restart after "
        "each"
    )


def describe_warnings(replay: SensorReplay) -> str:
    """Return how many samples have which warning; ``none`` for none."""
    flags = replay.rows["force_warnings"].to_numpy()
    counts = Counter(
        {warning: int(np.count_nonzero(flags & warning)) for warning in SensorWarning}
    )
    return (
        ", ".join(f"{count} x {each}" for each, count in (+counts).most_common())
        or "none"
    )


def _describe_tare(replay: SensorReplay) -> str:
    tare = replay.tare
    if tare is None:
        return "none: forces carry the errors of the model and of the torque sensors"
    offset_Nm = float(np.abs(tare.mean[: len(tare.noise_Nm2)]).max())
    return (
        f"{replay.window} of the log, kind {tare.kind!r}, offsets up to "
        f"{offset_Nm:.2g} Nm"
    )


def _describe_torques(diagnosis: TorqueDiagnosis | None, *, is_external: bool) -> str:
    """Return scale, missing mass and unchecked joints as a tare has shown them."""
    max_listed_std_kg = 1.0  # a payload that is known less well is not listed
    if is_external:
        return "not checked: the robot estimates the external torque itself"
    if diagnosis is None:
        return "not checked: no tare, or one that ignores contact"
    parts = [describe_scale(diagnosis)]
    if diagnosis.payload_std_kg <= max_listed_std_kg:
        parts.append(
            f"missing mass {diagnosis.payload_kg + 0.0:.2f} +/- "
            f"{diagnosis.payload_std_kg:.2f} kg"
        )
    return "; ".join(filter(None, (*parts, diagnosis.describe_unchecked())))


def describe_scale(diagnosis: TorqueDiagnosis) -> str:
    """Return torque over that of the model, with its deviation."""
    return (
        f"{diagnosis.scale:.3g} +/- {diagnosis.scale_std:.2g} times what gravity asks "
        "for"
    )


def find_doubts(replay: SensorReplay) -> list[str]:
    """Return what the tare, and the rows after it, show to be wrong with torques."""
    doubts: list[str] = []
    diagnosis = replay.sensor.diagnosis
    if diagnosis is not None:
        # Several joints that deviate may have a common cause.
        if diagnosis.scale_deviates or len(diagnosis.deviating_joints) == 1:
            doubts.append(
                f"torque: {diagnosis.describe()}: units, the sensors' scale, or masses "
                "of the model, are off; the force's deviation has that in it"
            )
    codes = replay.rows["force_status"].to_numpy()
    tared = int(np.count_nonzero(codes == STATUS_CODES[Status.OK]))
    flags = replay.rows["force_warnings"].to_numpy()
    mismatched = int(np.count_nonzero(flags & SensorWarning.MODEL_MISMATCH))
    # A knock mismatches for a moment; a wrong arm or payload does most of the time.
    if mismatched > 0.1 * tared:
        doubts.append(
            f"model mismatch in {mismatched} of {tared} rows: their torques "
            "are not those of a force on the needle's tip of this arm; check --robot, "
            "--payload and the factor of --tau, and what else touched the arm"
        )
    return doubts


def describe_axial_force(replay: SensorReplay) -> str:
    """Return the range of the axial force with its deviation; empty without any."""
    rows = replay.rows
    for status, note in ((Status.OK, ""), (Status.NOT_TARED, ", not tared")):
        chosen = rows[rows["force_status"] == STATUS_CODES[status]]
        if len(chosen):
            return (
                f"{chosen['axial_N'].min():.3f} to {chosen['axial_N'].max():.3f} N, "
                f"standard deviation {chosen['axial_std_N'].mean():.3f} N (mean){note}"
            )
    return ""
