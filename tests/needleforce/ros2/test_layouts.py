"""Layouts, launch file and ROS package, against the node and the bags."""

import json
import runpy
import sys
import tomllib
from configparser import ConfigParser
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple
from unittest.mock import MagicMock
from xml.etree import ElementTree

import pytest

from needleforce import InsertionSession
from needleforce.cli import main, run_ros2_node
from needleforce.ros2 import node as node_file
from needleforce.ros2.parameters import PARAMETERS, settings_from_values
from needleforce.ros2.ros_modules import RosModules
from tests.insertion_run import cut, short_run

FOLDER = Path(__file__).parents[3] / "examples" / "ros2"
OF_ROS = {"/rosout": "Log", "/robot_description": "String", "/tf": "TFMessage"}
"""Topics that ROS 2 itself and the arm's own robot_state_publisher have."""


@pytest.fixture(scope="module")
def published():
    """Topics of the node, with the names of their types."""
    ros = RosModules(*(MagicMock() for _ in RosModules._fields))
    types = {
        id(ros.geometry.WrenchStamped): "WrenchStamped",
        id(ros.diagnostic.DiagnosticArray): "DiagnosticArray",
        id(ros.standard.Float64): "Float64",
        id(ros.transforms.TFMessage): "TFMessage",
    }
    ros_node = MagicMock()
    robot = short_run().robot
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(node_file, "warm_up", lambda robot, config: None)
        patch.setattr(node_file, "InsertionSession", MagicMock(spec=InsertionSession))
        node_file.NeedleNode(ros, ros_node, robot, settings_from_values({}))
    calls = [call.args for call in ros_node.create_publisher.call_args_list]
    return {
        topic.replace("~", "/needleforce"): types[id(kind)] for kind, topic, _ in calls
    } | OF_ROS


def layout_topics(layout):
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


def read_yaml(name):
    """What a file of the examples holds."""
    yaml = pytest.importorskip("ruamel.yaml")
    return yaml.YAML(typ="safe").load(FOLDER / name)


def panels_of(place):
    """Names of the panels in the tree of a layout."""
    if isinstance(place, str):
        return {place}
    return panels_of(place["first"]) | panels_of(place["second"])


@pytest.mark.parametrize("name", ["foxglove.json", "foxglove_bag.json"])
def test_a_layout_shows_each_of_its_panels_once(name):
    layout = json.loads((FOLDER / name).read_bytes())

    assert panels_of(layout["layout"]) == set(layout["configById"])


def test_foxglove_shows_topics_of_the_node(published):
    topics = layout_topics(json.loads((FOLDER / "foxglove.json").read_bytes()))
    needed = {
        "RosOut": "Log",
        "DiagnosticSummary": "DiagnosticArray",
        "3D": "String",
        # The tool's z axis is the direction of insertion: tissue pushes against it.
        "wrench.force.z.@negative": "WrenchStamped",
    }

    assert {topic: published.get(topic) for topic in topics} == {
        topic: needed[use] for topic, use in topics.items()
    }
    assert {"/needleforce/wrench", "/needleforce/tip_force"} <= set(topics)


@pytest.mark.slow
def test_foxglove_shows_topics_of_the_bags(tmp_path, monkeypatch):
    reader = pytest.importorskip("mcap.reader")
    monkeypatch.setattr("needleforce.cli.logs.simulated_log.simulate", _begin_run)
    monkeypatch.chdir(tmp_path)
    for command in (
        "simulate gel-25-constant -o insertion.mcap",
        "force insertion.mcap --no-tare -o forces.mcap",
        "identify forces.mcap --ignore-status -o layers.mcap",
    ):
        assert main(command.split()) == 0
    written = {}
    for path in tmp_path.glob("*.mcap"):
        with path.open("rb") as stream:
            summary = reader.make_reader(stream).get_summary()
        for channel in summary.channels.values():
            kind = summary.schemas[channel.schema_id].name
            written[channel.topic] = kind.rsplit("/", 1)[-1]
    needed = {"RosOut": "Log", "3D": "String", "data": "Float64"}
    topics = layout_topics(json.loads((FOLDER / "foxglove_bag.json").read_bytes()))

    assert {topic: written.get(topic) for topic in topics} == {
        topic: needed[use] for topic, use in topics.items()
    }
    assert "/tf" in written


def _begin_run(chosen, *, plant, seed):
    """Two seconds of an insertion."""
    run = short_run()
    rows = slice(2000)
    return replace(run, signals=cut(run.signals, rows), truth=cut(run.truth, rows))


def test_rviz_shows_topics_of_the_node(published):
    displays = read_yaml("needleforce.rviz")["Visualization Manager"]["Displays"]
    shown = {}
    for display in displays:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic is not None:
            shown[topic["Value"]] = display["Class"].split("/")[1]
            if topic["Value"] == "/robot_description":
                # It is published once: who subscribes later gets it as kept.
                assert topic["Durability Policy"] == "Transient Local"
    needed = {"Wrench": "WrenchStamped", "RobotModel": "String"}

    assert {topic: published.get(topic) for topic in shown} == {
        topic: needed[use] for topic, use in shown.items()
    }
    assert {"/needleforce/wrench", "/needleforce/tip_force"} <= set(shown)


def test_the_parameters_of_the_launch_file_are_the_defaults_of_the_node():
    given = read_yaml("parameters.yaml")["needleforce"]["ros__parameters"]

    assert given == {parameter.name: parameter.default for parameter in PARAMETERS}


class LaunchAction(dict):
    """An action of a launch file, with its arguments."""

    def __init__(self, *names, **arguments):
        super().__init__(arguments, names=names)


class GivenArgument(NamedTuple):
    """A substitution for an argument of `ros2 launch`."""

    name: str

    def perform(self, context):
        return context[self.name]


@pytest.fixture
def launched(monkeypatch):
    """What the launch file starts with arguments; the launch of ROS 2 is a fake."""
    modules = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": LaunchAction,
            "OpaqueFunction": LaunchAction,
        },
        "launch.substitutions": {"LaunchConfiguration": GivenArgument},
        "launch_ros.actions": {"Node": LaunchAction},
    }
    for name, contents in modules.items():
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(**contents))

    def launch(**given):
        file = runpy.run_path(str(FOLDER / "needleforce.launch.py"))
        *declared, starting = file["generate_launch_description"]()
        context = {each["names"][0]: each["default_value"] for each in declared}
        assert given.keys() <= context.keys()
        [node] = starting["function"](context | given)
        return node

    return launch


def test_the_launch_file_starts_the_node_of_the_package(launched):
    node = launched(joint_states="/arm/joint_states")

    assert (node["package"], node["executable"]) == ("needleforce", "node")
    assert node["arguments"] == ["--tool-frame", "needle_tip"]
    assert node["parameters"] == []
    assert ("joint_states", "/arm/joint_states") in node["remappings"]


def test_the_launch_file_takes_a_description_and_parameters(launched):
    node = launched(urdf="arm.urdf", tool_frame="tip", parameters="mine.yaml")

    assert node["arguments"] == ["--tool-frame", "tip", "--urdf", "arm.urdf"]
    assert node["parameters"] == ["mine.yaml"]


def test_the_ros_package_has_what_ros_looks_for(monkeypatch):
    setup = {}
    fake = SimpleNamespace(setup=lambda **arguments: setup.update(arguments))
    monkeypatch.setitem(sys.modules, "setuptools", fake)
    runpy.run_path(str(FOLDER / "setup.py"))
    package = ElementTree.parse(FOLDER / "package.xml").getroot()
    scripts = ConfigParser(interpolation=None)
    scripts.read(FOLDER / "setup.cfg")
    installed = dict(setup["data_files"])
    [(executable, where)] = [
        script.split(" = ") for script in setup["entry_points"]["console_scripts"]
    ]
    module, function = where.split(":")

    assert package.findtext("name") == "needleforce"
    assert package.findtext("export/build_type") == "ament_python"
    assert package.findtext("version") == setup["version"] == metadata_version()
    # ros2 run finds a package by its marker, and executables in lib/PACKAGE.
    marker = "share/ament_index/resource_index/packages"
    assert installed[marker] == ["resource/needleforce"]
    assert "package.xml" in installed["share/needleforce"]
    assert scripts["install"]["install_scripts"] == "$base/lib/needleforce"
    assert executable == "node"
    assert callable(getattr(import_module(module), function))
    for files in installed.values():
        assert all((FOLDER / file).is_file() for file in files)


def metadata_version():
    """Version of the Python package."""
    project = tomllib.loads((FOLDER.parents[1] / "pyproject.toml").read_text())
    return project["project"]["version"]


def test_the_executable_of_the_package_is_the_command(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["node", "--help"])

    assert run_ros2_node() == 0
    assert "joint_states in" in capsys.readouterr().out
