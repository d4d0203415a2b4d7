"""The commands on an arm: `needleforce record`, `live`, `lag`, `ros2`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from needleforce.cli.application import ARMS, LIVE_OUTPUT, LOG, app
from needleforce.cli.shared_options import (
    ArmName,
    ArmOptions,
    MovedArmName,
    RobotOptions,
    WatchOptions,
)
from needleforce.cli.terminal import limit_library_threads

if TYPE_CHECKING:
    from collections.abc import Callable

    from urdf import Robot


@app.command(name="record", group=ARMS)
def record_command(
    arm: ArmName,
    /,
    *,
    output: Annotated[
        Path,
        Parameter(
            name=("--output", "-o"),
            metavar="FILE",
            group=LIVE_OUTPUT,
            help="Recording: .csv, .npz, .parquet, or .mcap, a ROS 2 bag.",
        ),
    ],
    overwrite: Annotated[
        bool,
        Parameter(negative="", group=LIVE_OUTPUT, help="Replace a file that is there."),
    ] = False,
    options: ArmOptions = ArmOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Write an arm's joint signals into a recording as they come, until Ctrl-C.

    needleforce record fri -o insertion.mcap
    """
    limit_library_threads()
    from needleforce.cli.arms.arm_connection import record_signals

    return record_signals(arm, output, options, robot, overwrites=overwrite)


@app.command(name="live", group=ARMS)
def live_command(
    arm: ArmName,
    /,
    *,
    options: ArmOptions = ArmOptions(),
    watch: WatchOptions = WatchOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Watch an arm until Ctrl-C: forces, depth, ruptures, warnings.

    Move the needle in free air first: the tare is taken after --tare seconds. Or let
    the arm make that stroke itself: --tare-stroke MM.

    needleforce live sim:stack-glove-constant --view
    """
    limit_library_threads()
    from needleforce.cli.arms.arm_watch import watch_arm

    return watch_arm(arm, options, robot, watch)


@app.command(name="lag", group=ARMS)
def lag_command(
    arm: MovedArmName,
    /,
    *,
    yes: Annotated[
        bool, Parameter(group=LIVE_OUTPUT, help="Move the arm without asking.")
    ] = False,
    json: Annotated[bool, Parameter(group=LIVE_OUTPUT, help="Print JSON.")] = False,
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Measure the delay from command to motion, and print the largest safe gain.

    All joints move for 4 s by a chirp of 1 to 6 Hz, the tip by at most 5 mm either way:
    keep the needle in free air. A gain K is stable while K (T + h/2) < pi/2, with T the
    delay and h the cycle; the safe one keeps a phase margin of 55 degrees.

    needleforce lag sim --yes
    """
    limit_library_threads()
    from needleforce.cli.arms.arm_lag import measure_arm

    return measure_arm(arm, robot, is_confirmed=yes, as_json=json)


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
    from needleforce.cli.robot import robot_from_options, robot_from_text
    from needleforce.cli.session_parts import load_plan
    from needleforce.ros2 import require_ros

    require_ros()
    from needleforce.ros2.node import run_node

    loaded = load_plan(plan)

    def make_robot(wait_for_description: "Callable[[], str]") -> "Robot":
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
