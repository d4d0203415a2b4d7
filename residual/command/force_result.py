"""What the command found out, for the summary, pictures and reports."""

from dataclasses import dataclass

from residual.command.force_rows import ForceRows
from residual.command.force_statistics import ForceStatistics
from residual.command.replay import Replay
from residual.sensor_config import SensorConfig
from urdf import Robot


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceResult:
    """The outcome of a whole log, of bounded size however long the log.

    Attributes:
        log: What the log is called.
        robot: The arm with its payload.
        config: Settings of the sensor.
        is_external: Whether the robot's own external torque was used.
        has_velocity: Whether the log had joint velocities.
        replay: The sensor after the log: tare, lag, skipped rows, gaps.
        statistics: Numbers about all rows.
        overview: So many rows as a picture needs; all rows of a short log, of a long one those in
            which a force is least or largest for a while.
    """

    log: str
    robot: Robot
    config: SensorConfig
    is_external: bool
    has_velocity: bool
    replay: Replay
    statistics: ForceStatistics
    overview: ForceRows

    @property
    def sensor_line(self) -> str:
        """What was estimated from what, in one line."""
        config = self.config
        frame = config.frame if config.frame is not None else self.robot.tool_frame
        where = f"{config.mode} force at {frame}" if config.mode != "full" else f"wrench at {frame}"
        if self.is_external:
            return f"{where}, from the robot's own external torque"
        velocity = "velocity from the log" if self.has_velocity else "velocity estimated"
        return f"{where}, K = {config.gain_per_s:g} 1/s, {velocity}"
