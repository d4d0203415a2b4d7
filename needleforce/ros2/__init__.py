"""A ROS 2 node beside an arm, and an arm that is heard through ROS 2.

rclpy and the messages are those of the user's ROS; files that import them say so at
their top, and only commands of ROS import these files.

Reading order: `joint_samples` (messages to samples), `reports` (estimates to named
values), `parameters`, `node`; `arm` for the other commands.
"""

from needleforce.ros2.errors import (
    MissingRosError as MissingRosError,
    Ros2Error as Ros2Error,
    Ros2ParameterError as Ros2ParameterError,
    require_ros as require_ros,
)
