"""What the layouts of examples/ros2 show."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[3] / "examples" / "ros2"
RVIZ_TYPES = {
    "RosOut": "Log",
    "DiagnosticSummary": "DiagnosticArray",
    "3D": "String",
    # The tool's z axis is the direction of insertion: tissue pushes against it.
    "wrench.force.z.@negative": "WrenchStamped",
    "Wrench": "WrenchStamped",
    "RobotModel": "String",
    "data": "Float64",
}
"""Type of message that a panel or a display needs."""


def foxglove_topics(layout):
    """Topics of a layout of Foxglove, with what each panel needs of it."""
    topics = {}
    for panel, config in layout["configById"].items():
        kind = panel.split("!")[0]
        if "topicToRender" in config:
            topics[config["topicToRender"]] = kind
        for path in config.get("paths", ()):
            topics[path["value"].split(".")[0]] = path["value"].split(".", 1)[1]
        for layer in config.get("layers", {}).values():
            topics[layer["topic"]] = kind
    return topics


def rviz_topics(layout):
    """Topics of a layout of RViz, with the display of each."""
    topics = {}
    for display in layout["Visualization Manager"]["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic is not None:
            topics[topic["Value"]] = display["Class"].split("/")[1]
            # A description is published once: who subscribes later gets it as kept.
            is_kept = topic.get("Durability Policy") == "Transient Local"
            assert is_kept or topic["Value"] != "/robot_description"
    return topics


def read_yaml(name):
    """What a file of the examples holds."""
    yaml = pytest.importorskip("ruamel.yaml")
    return yaml.YAML(typ="safe").load(FOLDER / name)
