"""The command `needleforce ros2`."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from needleforce.cli.application import ARMS, LOG, app
from needleforce.cli.shared_options import RobotOptions

if TYPE_CHECKING:
    from urdf import Robot


@app.command(name="ros2", group=ARMS)
def ros2_command(
    *ros_arguments: Annotated[
        str,
        Parameter(
            name="ROS",
            group=LOG,
            allow_leading_hyphen=True,
            help="Arguments of ROS, after --ros-args: parameters (-p NAME:=VALUE, "
            "--params-file FILE), other names of topics (-r OLD:=NEW).",
        ),
    ],
    robot: RobotOptions = RobotOptions(),
    plan: Annotated[
        Path | None,
        Parameter(
            metavar="FILE",
            group=LOG,
            help="Plan to follow (plan.json, or its folder): the needle on it is in "
            "/diagnostics, what happens on it in ~/events.",
        ),
    ] = None,
) -> int:
    """Run a ROS 2 node: joint_states in; wrench, tip force, layers, events out.

    It needs your own ROS 2, sourced: see docs/how-to/ros2.md. Without --urdf and
    --robot the arm is the one on the topic robot_description.

    needleforce ros2 --urdf arm.urdf --ros-args -r joint_states:=/arm/joint_states
    """
    from needleforce.cli.plan_option import load_plan
    from needleforce.cli.robot import robot_from_options, robot_from_text
    from needleforce.ros2 import require_ros

    require_ros()
    from needleforce.ros2.node import run_node

    loaded = load_plan(plan)

    def make_robot(wait_for_description: Callable[[], str]) -> "Robot":
        """Return the arm of the options, else that of the topic."""
        if robot.robot is not None or robot.urdf is not None:
            return robot_from_options(robot, None)
        return robot_from_text(wait_for_description(), "robot_description", robot)

    run_node(
        ros_arguments,
        make_robot,
        (lambda session: None) if loaded is None else loaded.follow_with,
    )
    return 0
