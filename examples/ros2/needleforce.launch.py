"""Start the node beside an arm whose driver runs already.

ros2 launch needleforce.launch.py urdf:=arm.urdf joint_states:=/arm/joint_states
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import (
    LaunchConfiguration,
    PathJoinSubstitution,
    ThisLaunchFileDir,
)

ARGUMENTS = {
    "urdf": "Description of the arm, with its needle's tip as tool frame.",
    "tool_frame": "Link whose z axis is the direction of insertion.",
    "joint_states": "Topic of the arm's joint states.",
}


def generate_launch_description():
    given = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    settings = PathJoinSubstitution([ThisLaunchFileDir(), "parameters.yaml"])
    node = ExecuteProcess(
        cmd=[
            "needleforce",
            "ros2",
            "--urdf",
            given["urdf"],
            "--tool-frame",
            given["tool_frame"],
            "--ros-args",
            "--params-file",
            settings,
            "-r",
            ["joint_states:=", given["joint_states"]],
        ],
        output="screen",
    )
    declared = [
        DeclareLaunchArgument("urdf", description=ARGUMENTS["urdf"]),
        DeclareLaunchArgument(
            "tool_frame",
            default_value="needle_tip",
            description=ARGUMENTS["tool_frame"],
        ),
        DeclareLaunchArgument(
            "joint_states",
            default_value="joint_states",
            description=ARGUMENTS["joint_states"],
        ),
    ]
    return LaunchDescription([*declared, node])
