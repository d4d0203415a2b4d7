"""`needleforce check`: what a log and its tare verify, line by line."""

from collections.abc import Iterator, Sequence
from enum import StrEnum

import msgspec
import numpy as np

from foundation.arrays import Array
from needleforce.cli.advice import describe_error
from needleforce.cli.logs.force_result import ForceResult
from needleforce.cli.logs.log_session import LogSession
from needleforce.cli.logs.replay_setup import prepare
from needleforce.cli.logs.torque_summary import (
    describe_doubt,
    describe_missing_mass,
    describe_scale,
)
from needleforce.cli.shared_options import (
    JointColumns,
    Output,
    RobotOptions,
    SensorOptions,
)
from needleforce.cli.terminal import stop_request, write_out
from needleforce.recordings.log import LogRows
from needleforce.sensor_replay import SensorReplay
from residual import TareError
from residual.bias.separation import JointSeparation, advise_motion
from residual.bias.torque_diagnosis import TorqueDiagnosis
from residual.errors import named_joints

DOUBTFUL = 1
"""Exit code where something in the log is doubtful."""


class Outcome(StrEnum):
    """What came of a check."""

    VERIFIED = "verified"
    DOUBTFUL = "doubtful"
    UNCHECKED = "not verified"
    READ = "read"


ROBOT_OUTCOMES = {"robot": Outcome.READ, "model": Outcome.UNCHECKED}
"""Outcomes of the lines on the robot, and on what is odd in its description."""


class CheckLine(msgspec.Struct):
    """One line of the table.

    Attributes:
        topic: What was checked.
        outcome: What came of it.
        text: What was found, in words.
    """

    topic: str
    outcome: Outcome
    text: str


class TorqueNumbers(msgspec.Struct):
    """Numbers of the tare, for programs.

    Attributes:
        scale: Measured torque over that of the model.
        scale_std: Its standard deviation.
        joint_scale: The same of each joint.
        joint_scale_std: Its standard deviation.
        missing_mass_kg: Mass that the model lacks at the flange.
        missing_mass_std_kg: Its standard deviation.
    """

    scale: float
    scale_std: float
    joint_scale: list[float]
    joint_scale_std: list[float]
    missing_mass_kg: float
    missing_mass_std_kg: float


class LogCheck(msgspec.Struct):
    """What a log and its tare verify.

    Attributes:
        log: Name of the log.
        lines: What was checked.
        warnings: What was wrong with the log, and with the robot's description.
        torque: Numbers of the tare; None where it was not taken.
    """

    log: str
    lines: list[CheckLine]
    warnings: list[str]
    torque: TorqueNumbers | None

    @property
    def is_doubtful(self) -> bool:
        """Whether something is."""
        return any(line.outcome is Outcome.DOUBTFUL for line in self.lines)

    def json(self) -> str:
        """Return all of it as JSON."""
        return msgspec.json.format(msgspec.json.encode(self)).decode() + "\n"

    def text(self) -> str:
        """Return the table."""
        topic_width = max(len(line.topic) for line in self.lines)
        outcome_width = max(len(line.outcome) for line in self.lines)
        return "".join(
            f"{line.topic:<{topic_width}}  {line.outcome:<{outcome_width}}  "
            f"{line.text}\n"
            for line in self.lines
        )


def run(
    source: str,
    robot_options: RobotOptions,
    sensor: SensorOptions,
    columns: JointColumns,
    *,
    as_json: bool,
) -> int:
    """Read a log up to its tare and to its end, and print what they verify.

    Args:
        source: The log as the command line names it.
        robot_options: The robot.
        sensor: How joint signals become a force, and when the tare is.
        columns: Which columns are which channels.
        as_json: Whether JSON is printed.

    Returns:
        The exit code: `DOUBTFUL` where something is.

    Raises:
        CommandError: Options contradict each other, or the log does not fit the robot.
    """
    replay, request = prepare(source, robot_options, sensor, columns)
    with stop_request() as is_stopped:
        log = LogSession(source, Output(), request, is_stopped)
        found = check_log(log, replay)
    write_out(found.json() if as_json else found.text())
    return log.exit_code or (DOUBTFUL if found.is_doubtful else 0)


def check_log(log: LogSession, replay: SensorReplay) -> LogCheck:
    """Return what a log verifies; it is read to its end, or to a tare that fails."""
    result = ForceResult(log.name, replay)
    signals = SignalRecord()
    replay.survives_refusal = True
    for chunk in log:
        signals.add(chunk)
        result.add(replay.run(chunk))
    result.count_bad_stamps(log.log.left_out)
    replay.finish(is_whole=not log.is_stopped())
    refusal = replay.refusal
    diagnosis = replay.sensor.diagnosis if refusal is None else refusal.diagnosis
    lines = [
        *_log_lines(log, replay, result),
        *signals.lines(),
        _velocity_line(replay, signals),
        *_torque_lines(replay, diagnosis, refusal),
    ]
    return LogCheck(
        log=log.name,
        lines=lines,
        warnings=[*log.warnings, *replay.robot.warnings],
        torque=None if diagnosis is None else _numbers_of(diagnosis),
    )


class SignalRecord:
    """Noise and travel of the signals of the first rows.

    Attributes:
        rows: Number of rows so far.
        noise: Standard deviation of the noise of each signal, by its key, shape (n,);
            from second differences, which motion hardly changes.
        travel_rad: Travel of each joint, shape (n,).
    """

    def __init__(self) -> None:
        self.rows = 0
        self.noise: dict[str, Array] = {}
        self._steps_s: list[Array] = []
        self._lowest: Array | None = None
        self._highest: Array | None = None

    @property
    def travel_rad(self) -> Array:
        """Travel of each joint, shape (n,); of length 0 before any row."""
        if self._lowest is None or self._highest is None:
            return np.zeros(0)
        return self._highest - self._lowest

    def add(self, chunk: LogRows) -> None:
        """Take further rows."""
        min_noise_rows = 100  # Fewest rows from which noise is estimated
        max_rate_rows = 20_000  # Rows from which the rate is taken
        if self.rows < max_rate_rows:
            self._steps_s.append(chunk.dt_s)
        self.rows += len(chunk.t_s)
        q_rad = chunk.channels["q_rad"]
        q_rad = q_rad[np.isfinite(q_rad).all(axis=1)]
        if len(q_rad):
            lowest = q_rad.min(axis=0)
            highest = q_rad.max(axis=0)
            before = self._lowest
            self._lowest = lowest if before is None else np.minimum(before, lowest)
            before = self._highest
            self._highest = highest if before is None else np.maximum(before, highest)
        for key, values in chunk.channels.items():
            finite = values[np.isfinite(values).reshape(len(values), -1).all(axis=1)]
            if len(finite) >= min_noise_rows and key not in self.noise:
                differences = np.diff(finite, n=2, axis=0)
                # The variance of a second difference of white noise is six times its.
                variance = np.square(differences).mean(axis=0) / 6.0
                self.noise[key] = np.sqrt(variance)

    def lines(self) -> Iterator[CheckLine]:
        """Yield the lines on rate and noise."""
        steps_s = np.concatenate(self._steps_s) if self._steps_s else np.zeros(0)
        steps_s = steps_s[steps_s > 0.0]
        if steps_s.size:
            usual_s = float(np.median(steps_s))
            late_s = float(np.percentile(steps_s, 99.0))
            text = (
                f"{self.rows} rows at {1.0 / usual_s:.4g} Hz; time step "
                f"{1e3 * usual_s:.4g} ms, in 1 of 100 longer than {1e3 * late_s:.4g} ms"
            )
            yield CheckLine("rate", Outcome.READ, text)
        units = {"q_rad": "rad", "dq_rad_s": "rad/s", "tau_Nm": "Nm"}
        units["tau_ext_Nm"] = "Nm"
        texts = [
            f"{key.removesuffix('_' + unit.replace('/', '_'))} "
            f"{np.min(self.noise[key]):.2g} to {np.max(self.noise[key]):.2g} {unit}"
            for key, unit in units.items()
            if key in self.noise
        ]
        if texts:
            text = f"{', '.join(texts)} (standard deviation of a sample, by joint)"
            yield CheckLine("noise", Outcome.READ, text)


def _log_lines(
    log: LogSession, replay: SensorReplay, result: ForceResult
) -> Iterator[CheckLine]:
    """Yield the lines on channels, robot, clock and samples."""
    for unit in log.log.units:
        yield CheckLine(f"channel {unit.channel}", Outcome.READ, str(unit))
    for label, text in result.summary():
        if label in ROBOT_OUTCOMES:
            yield CheckLine(label, ROBOT_OUTCOMES[label], text)
        if label == "rejected":
            outcome = Outcome.DOUBTFUL if replay.rejected else Outcome.VERIFIED
            yield CheckLine(label, outcome, text)
        if label == "gaps":
            outcome = Outcome.DOUBTFUL if replay.gaps else Outcome.VERIFIED
            yield CheckLine("clock", outcome, f"gaps: {text}")
        if label == "signals":
            yield CheckLine(label, Outcome.DOUBTFUL, text)
    for warning in log.warnings:
        yield CheckLine("recording", Outcome.DOUBTFUL, warning)


def _velocity_line(replay: SensorReplay, signals: SignalRecord) -> CheckLine:
    """Return the line on velocities."""
    still_rad = 1e-3  # Joints that moved by less show nothing of their velocities
    topic = "velocities"
    if replay.velocity_fault:
        return CheckLine(topic, Outcome.DOUBTFUL, replay.velocity_fault)
    if "velocity from the log" not in replay.description:
        return CheckLine(topic, Outcome.READ, "none in the log: estimated from q")
    still = np.flatnonzero(signals.travel_rad < still_rad)
    if len(still) == len(signals.travel_rad):
        text = "from the log; the arm rests, so they were not compared with q"
        return CheckLine(topic, Outcome.UNCHECKED, text)
    text = "from the log; they are the rate of q"
    if still.size:
        text += f"; {named_joints(still)} rest, not checked"
    return CheckLine(topic, Outcome.VERIFIED, text)


def _torque_lines(
    replay: SensorReplay,
    diagnosis: TorqueDiagnosis | None,
    refusal: TareError | None,
) -> Iterator[CheckLine]:
    """Yield the lines on tare, signs and order, scale, payload."""
    if refusal is not None:
        text = describe_error(refusal)
        yield CheckLine("tare", Outcome.DOUBTFUL, text)
    elif replay.tare is None or replay.tare.tare is None:
        yield CheckLine("tare", Outcome.UNCHECKED, "none was taken")
    else:
        text = f"{replay.tare} of the log: no contact is seen"
        yield CheckLine("tare", Outcome.VERIFIED, text)
        yield from _separation_lines(replay.sensor.tare_separation)
    topics = ("order and signs", "scale", "payload")
    if diagnosis is None:
        reason = "no tare that checks the torques"
        if replay.is_external:
            reason = "the robot estimates the external torque itself"
        for topic in topics:
            yield CheckLine(topic, Outcome.UNCHECKED, reason)
        return
    is_taken = refusal is None
    if is_taken and (doubt := describe_doubt(diagnosis)):
        yield CheckLine("torque", Outcome.DOUBTFUL, doubt)
    yield _sign_line(diagnosis, is_taken=is_taken)
    yield _scale_line(diagnosis, is_taken=is_taken)
    yield _payload_line(diagnosis, is_taken=is_taken)


def _scale_line(diagnosis: TorqueDiagnosis, *, is_taken: bool) -> CheckLine:
    """Return the line on the factor of all torques."""
    outcome = Outcome.VERIFIED if is_taken else Outcome.UNCHECKED
    text = f"tau is {describe_scale(diagnosis)}"
    if is_taken:
        doubt_percent = 100.0 * diagnosis.scale_doubt
        text += (
            "; the standard deviation of a force has "
            f"{doubt_percent:.2g} % of the force for it"
        )
    if not diagnosis.is_scale_known:
        outcome = Outcome.UNCHECKED
    elif diagnosis.scale_deviates:
        outcome = Outcome.DOUBTFUL
    return CheckLine("scale", outcome, text)


def _separation_lines(
    separations: Sequence[JointSeparation],
) -> Iterator[CheckLine]:
    """Yield what the tare told of hysteresis and friction; of a plain offset none."""
    if not separations:
        return
    advice = advise_motion(separations)
    if advice:
        yield CheckLine("hysteresis", Outcome.UNCHECKED, advice)
        return
    worst = max(separations, key=lambda item: item.hysteresis_std_Nm)
    text = (
        "told from friction at every joint; the least certain is "
        f"{worst.joint}, to {worst.hysteresis_std_Nm:.2g} Nm"
    )
    yield CheckLine("hysteresis", Outcome.VERIFIED, text)


def _sign_line(diagnosis: TorqueDiagnosis, *, is_taken: bool) -> CheckLine:
    """Return the line on order and signs of the joints."""
    topic = "order and signs"
    unchecked = diagnosis.unchecked_joints
    checked = [k for k in range(len(diagnosis.joint_scale)) if k not in unchecked]
    opposed = [joint for joint in checked if diagnosis.joint_scale[joint] < 0.0]
    following = [joint for joint in checked if joint not in opposed]
    texts: list[str] = []
    if opposed:
        texts.append(f"{named_joints(opposed)}: torque opposes gravity")
    if following:
        texts.append(f"{named_joints(following)}: torque follows gravity")
    if unchecked:
        texts.append(diagnosis.describe_unchecked())
    outcome = Outcome.VERIFIED if is_taken and checked else Outcome.UNCHECKED
    if opposed:
        outcome = Outcome.DOUBTFUL
    return CheckLine(topic, outcome, "; ".join(texts))


def _payload_line(diagnosis: TorqueDiagnosis, *, is_taken: bool) -> CheckLine:
    """Return the line on the payload.

    Where a tare was refused for another cause, the mass that would explain the torques
    is none that is missing.
    """
    if not is_taken:
        reason = "the tare was refused; what it names must be right first"
        return CheckLine("payload", Outcome.UNCHECKED, reason)
    text = describe_missing_mass(diagnosis)
    if not text:
        reason = "the motion does not show the mass at the flange"
        return CheckLine("payload", Outcome.UNCHECKED, reason)
    is_missing = abs(diagnosis.payload_kg) > 3.0 * diagnosis.payload_std_kg
    outcome = Outcome.DOUBTFUL if is_missing else Outcome.VERIFIED
    return CheckLine("payload", outcome, text)


def _numbers_of(diagnosis: TorqueDiagnosis) -> TorqueNumbers:
    """Return the numbers of a tare."""
    return TorqueNumbers(
        scale=diagnosis.scale,
        scale_std=diagnosis.scale_std,
        joint_scale=diagnosis.joint_scale.tolist(),
        joint_scale_std=diagnosis.joint_scale_std.tolist(),
        missing_mass_kg=diagnosis.payload_kg,
        missing_mass_std_kg=diagnosis.payload_std_kg,
    )
