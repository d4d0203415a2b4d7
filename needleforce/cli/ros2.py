"""The command `needleforce ros2`."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from needleforce.cli.application import ARMS, LOG, app
from needleforce.cli.shared_options import RobotOptions


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

    It needs your own ROS 2, sourced: see docs/how-to/ros2.md.

    needleforce ros2 --urdf arm.urdf --ros-args -r joint_states:=/arm/joint_states
    """
    from needleforce.cli.plan_file import load_plan
    from needleforce.cli.robot import robot_from_options
    from needleforce.cli.terminal import say
    from needleforce.ros2.node import run_node

    loaded = load_plan(plan)
    run_node(
        ros_arguments,
        lambda: robot_from_options(robot, None),
        say,
        (lambda session: None) if loaded is None else loaded.follow_with,
    )
    return 0
