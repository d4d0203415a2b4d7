"""Start the node beside an arm whose driver runs already.

ros2 launch needleforce needleforce.launch.py joint_states:=/arm/joint_states
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "urdf": ("", "Description of the arm; empty for the topic robot_description."),
    "tool_frame": ("needle_tip", "Link whose z axis is the direction of insertion."),
    "robot_description": ("robot_description", "Topic of the arm's description."),
    "joint_states": ("joint_states", "Topic of the arm's joint states."),
    "parameters": ("", "File of the node's parameters; empty for the defaults."),
}


def generate_launch_description():
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start_node)])


def start_node(context):
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    arm = ["--tool-frame", given["tool_frame"]]
    if given["urdf"]:
        arm += ["--urdf", given["urdf"]]
    node = Node(
        package="needleforce",
        executable="node",
        name="needleforce",
        output="screen",
        arguments=arm,
        parameters=[given["parameters"]] if given["parameters"] else [],
        remappings=[
            (topic, given[topic]) for topic in ("robot_description", "joint_states")
        ],
    )
    return [node]
