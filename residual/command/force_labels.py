"""What a bag of forces says beside the numbers."""

from recordings.columns.force_codes import FORCE_STATUS
from recordings.command.log_session import LogSession
from recordings.tables.labels import Labels
from residual.sensor_config import SensorConfig
from urdf import Robot


def force_labels(log: LogSession, robot: Robot, config: SensorConfig) -> Labels:
    """Return the source's clock, the frame whose axes the forces have, and the words of a status.

    Args:
        log: The log, of which rows have been read.
        robot: The arm.
        config: Names axes and frame.
    """
    tool_frame = config.frame if config.frame is not None else robot.tool_frame
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    base_frame = robot.frame_names[1]
    return Labels(
        start_ns=log.start_ns,
        frame=base_frame if config.axes == "base" else tool_frame,
        events={"force_status": FORCE_STATUS},
    )
