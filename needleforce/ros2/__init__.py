"""A ROS 2 node beside an arm, and an arm that is heard through ROS 2.

rclpy and the messages are those of the user's ROS; they are imported when a node is
made. All that needs no ROS stands in files of its own and is tested without.

Reading order: `errors`, `parameters` (what a user sets), `joint_samples` (messages to
samples), `message_loss`, `named_report`, `reports` (estimates to named values),
`ros_modules` (the only import of ROS), `messages`, `warming`, `node`; `arm` for the
other commands.
"""

from needleforce.ros2.errors import (
    MissingRosError as MissingRosError,
    Ros2Error as Ros2Error,
    Ros2ParameterError as Ros2ParameterError,
)
