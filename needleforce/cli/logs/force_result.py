"""Forces of a whole log: their table, and what is counted for the summary."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.cli.logs.torque_summary import describe_torques
from needleforce.depth_zero import FIRST_ROW
from needleforce.sensor_replay import (
    ForceRows,
    SensorReplay,
    describe_rejections,
    has_status,
)
from residual import SensorConfig, SensorWarning, Status
from urdf.robot import STANDARD_GRAVITY_M_S2

NO_WARNING = "none"
"""What stands for the warnings of a log without any."""


class VectorColumns(NamedTuple):
    """An estimated vector, one per row.

    Attributes:
        name: What it is, `force` or `torque`.
        unit: Unit of its components.
        values: Components along x, y, z, shape (n, 3).
        std: Their standard deviations, shape (n, 3); None where none are known.
    """

    name: str
    unit: str
    values: Array
    std: Array | None


def vectors_of(rows: ForceRows, config: SensorConfig) -> list[VectorColumns]:
    """Return the vectors that are estimated in the sensor's mode."""
    std = None if config.mode == "axial" else rows["std"][:, :3]
    vectors = [VectorColumns("force", "N", rows["force_N"], std)]
    if config.mode == "full":
        torque_std = rows["std"][:, 3:]
        vectors.append(VectorColumns("torque", "Nm", rows["torque_Nm"], torque_std))
    return vectors


def force_table(rows: ForceRows, config: SensorConfig) -> ForceRows:
    """Return the columns in the order in which they are written; names have units."""
    table = {name: rows[name] for name in ("t_s", "travel_m", "axial_N", "axial_std_N")}
    for vector in vectors_of(rows, config):
        ending = f"in_{config.axes}_{vector.unit}"
        for axis, values in zip("xyz", vector.values.T, strict=True):
            table[f"{vector.name}_{axis}_{ending}"] = values
        if vector.std is None:
            continue
        for axis, std in zip("xyz", vector.std.T, strict=True):
            table[f"{vector.name}_std_{axis}_{ending}"] = std
    for name in (
        "axial_unsmoothed_N",
        "axial_unsmoothed_std_N",
        "model_mismatch",
        "force_warnings",
        "force_status",
    ):
        table[name] = rows[name]
    return table


@dataclass
class AxialRange:
    """Axial forces of the rows of one status.

    Attributes:
        min_N: The least force [N].
        max_N: The largest force [N].
        sum_of_std_N: Sum of the standard deviations [N].
    """

    min_N: float = np.inf
    max_N: float = -np.inf
    sum_of_std_N: float = 0.0

    def add(self, axial_N: Array, std_N: Array) -> None:
        """Take further rows, both of shape (n,)."""
        self.min_N = np.min(axial_N, initial=self.min_N)
        self.max_N = np.max(axial_N, initial=self.max_N)
        self.sum_of_std_N += float(std_N.sum())


class ForceResult:
    """The forces of a whole log, of bounded size however long the log.

    Args:
        log: Name of the log.
        replay: The sensor that was run over it.

    Attributes:
        log: Name of the log.
        replay: The sensor that was run over it.
        rows: Rows for a figure.
        counts: How many rows have which status.
        warnings: How many rows have which warning.
    """

    def __init__(self, log: str, replay: SensorReplay) -> None:
        self.log = log
        self.replay = replay
        self.rows: ForceRows = {}
        self.counts: Counter[Status] = Counter()
        self.warnings: Counter[SensorWarning] = Counter()
        self._rate_hz = np.nan
        self._axial = {status: AxialRange() for status in Status}

    def add(self, rows: ForceRows) -> None:
        """Count further rows."""
        if not self.counts:
            steps_s = np.diff(rows["t_s"])
            if (steps_s > 0.0).any():
                self._rate_hz = 1.0 / float(np.median(steps_s[steps_s > 0.0]))
        for warning in SensorWarning:
            is_warned = rows["force_warnings"] & warning
            self.warnings[warning] += int(np.count_nonzero(is_warned))
        for status, axial in self._axial.items():
            chosen = has_status(rows, status)
            axial.add(rows["axial_N"][chosen], rows["axial_std_N"][chosen])
            self.counts[status] += int(np.count_nonzero(chosen))

    def count_bad_stamps(self, count: int) -> None:
        """Count rows that were left out because of their time stamp, at the end."""
        if count:
            self.counts[Status.REJECTED] += count
            self.replay.rejected["bad time stamp"] += count

    def answer(self) -> str:
        """Return the range of the axial force, with its standard deviation."""
        status = Status.OK if self.counts[Status.OK] else Status.NOT_TARED
        if not self.counts[status]:
            return "No force: no sample was valid after the filters had settled."
        axial = self._axial[status]
        std_N = axial.sum_of_std_N / self.counts[status]
        text = (
            f"Force along the needle: {axial.min_N:.2f} to {axial.max_N:.2f} N, with a "
            f"standard deviation of {std_N:.2f} N."
        )
        if status is Status.OK:
            return text
        return f"{text} Not tared: it carries the errors of model and torque sensors."

    def summary(
        self, depths: str = "identify and report count below first contact"
    ) -> Iterator[tuple[str, str]]:
        """Yield label and text of every line: what was used, done and estimated.

        Args:
            depths: From where depths of layers count, in words.
        """
        replay = self.replay
        yield "robot", self._describe_robot()
        for warning in replay.robot.warnings:
            yield "model", warning
        yield "sensor", replay.description
        yield "samples", self._describe_samples()
        yield "rejected", self._describe_rejections()
        if replay.sensor.corrections:
            yield "corrected", replay.sensor.corrections
        yield "gaps", self._describe_gaps()
        yield "warnings", self.describe_warnings()
        if replay.velocity_fault:
            yield "velocity", f"{replay.velocity_fault}; --dq none estimates it from q"
        if replay.question:
            yield "signals", replay.question
        yield "tare", self._describe_tare()
        diagnosis = replay.sensor.diagnosis
        yield "torque", describe_torques(diagnosis, is_external=replay.is_external)
        yield "axial force", self._describe_axial_force()
        yield "travel", f"counts {FIRST_ROW}; {depths}"
        if replay.is_external:
            yield "lag", "that of the robot's own estimate"
        else:
            yield "lag", f"{1e3 * replay.sensor.lag_s:.1f} ms"

    def _describe_robot(self) -> str:
        robot = self.replay.robot
        mass_kg = robot.payload.mass_kg if robot.payload is not None else 0.0
        text = f"{robot.model.name}, {robot.nv} joints, payload {mass_kg:.3g} kg"
        gravity_m_s2 = robot.gravity_m_s2.tolist()
        if tuple(gravity_m_s2) == STANDARD_GRAVITY_M_S2:
            return text
        shown = " ".join(f"{component:.4g}" for component in gravity_m_s2)
        return f"{text}, gravity {shown} m/s^2 in base axes"

    def _describe_samples(self) -> str:
        counts = [
            f"{self.counts[status]} {status.value}"
            for status in Status
            if self.counts[status]
        ]
        span = f"{self.counts.total()} in {self.replay.duration_s:.4g} s"
        return f"{span} at {self._rate_hz:.4g} Hz: {', '.join(counts)}"

    def _describe_rejections(self) -> str:
        rejected = self.replay.rejected
        text = describe_rejections(rejected) or "none"
        if any(reason.startswith("dq ") for reason in rejected):
            text += "; --dq none leaves velocities out and estimates them from q"
        return text

    def _describe_gaps(self) -> str:
        replay = self.replay
        limit = f"longer than {replay.config.max_gap_s:g} s"
        if not replay.gaps:
            return f"none {limit}"
        text = (
            f"{replay.gaps} {limit} (longest {replay.longest_gap_s:.6g} s): "
            "filters restart after each"
        )
        if 2 * self.counts[Status.INITIALIZING] > self.counts.total():
            text += (
                "; too few samples, or the unit of time is wrong: --time COLUMN:UNIT"
            )
        return text

    def describe_warnings(self) -> str:
        """Return how many samples have which warning; `NO_WARNING` for none."""
        texts = [
            f"{count} x {str(warning.name).lower().replace('_', ' ')}"
            for warning, count in self.warnings.most_common()
            if count
        ]
        return ", ".join(texts) or NO_WARNING

    def _describe_tare(self) -> str:
        window = self.replay.tare
        if window is None or window.tare is None:
            return (
                "none: forces carry the errors of the model and of the torque sensors"
            )
        tare = window.tare
        offset_Nm = float(np.abs(tare.mean[: len(tare.noise_Nm2)]).max())
        return (
            f"{window} of the log{window.note}, kind {tare.kind!r}, offsets up to "
            f"{offset_Nm:.2g} Nm"
        )

    def _describe_axial_force(self) -> str:
        status = Status.OK if self.counts[Status.OK] else Status.NOT_TARED
        if not self.counts[status]:
            return "none: no sample was valid after the filters had settled"
        axial = self._axial[status]
        std_N = axial.sum_of_std_N / self.counts[status]
        note = "" if status is Status.OK else ", not tared"
        return (
            f"{axial.min_N:.3f} to {axial.max_N:.3f} N, "
            f"standard deviation {std_N:.3f} N (mean){note}"
        )
